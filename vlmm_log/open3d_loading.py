"""Open3D, an extra that also needs libraries of the system: loaded where it is used, or told how to get it."""

from __future__ import annotations

from typing import Any

from vlmm_log.types import InputError

LIBRARIES = "apt-get install libusb-1.0-0 libgl1 libegl1 libgomp1 libx11-6"


def load_open3d(what: str) -> Any:
    """The module. Raises InputError, which says that ``what`` needs it, where it is missing or does not load."""
    try:
        import open3d
    except ModuleNotFoundError as e:
        raise InputError(f"{what} needs Open3D: pip install 'vlmm-log[sim]' ({e})") from e
    except (ImportError, OSError) as e:  # a library that it is linked to, or opens itself
        raise InputError(f"{what} needs Open3D, which does not load ({e}); on Debian and Ubuntu: {LIBRARIES}") from e
    return open3d
