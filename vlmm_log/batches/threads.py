"""How many threads a worker's libraries start: one, since there is a worker a core."""

LIBRARIES = ("OMP", "OPENBLAS", "MKL", "NUMBA", "NUMEXPR", "VECLIB", "RAYON")

ONE_THREAD = {f"{name}_NUM_THREADS": "1" for name in LIBRARIES} | {"OPENCV_FOR_THREADS_NUM": "1"}
"""Environment of a worker."""
