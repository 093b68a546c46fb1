"""How good is it: truth, metrics, variants, baselines, calibration, and the report of all of them."""
