"""Map files: JSON and Parquet, both without loss, and PLY to look at."""

from __future__ import annotations

from pathlib import Path

from vlmm_log.maps.saved import SavedMap, checked
from vlmm_log.outputs import replacing
from vlmm_log.types import InputError

__all__ = ["MAP_SUFFIXES", "SavedMap", "load_map", "save_map"]

MAP_SUFFIXES = (".json", ".parquet", ".ply")


def save_map(path: Path, saved: SavedMap, *, force: bool) -> None:
    """Write a map as ``path``'s suffix says: .json, .parquet or .ply. The same map gives the same bytes.

    Raises InputError where the suffix is another one, the file exists (without ``force``), the disk refuses, or the
    map holds what none may: a figure that is not finite, say.
    """
    match path.suffix.lower():
        case ".json":
            from vlmm_log.maps.json import write
        case ".parquet":
            from vlmm_log.maps.parquet import write
        case ".ply":
            from vlmm_log.maps.ply import write
        case _:
            raise InputError(f"{path}: a map is written as .json, .parquet or .ply; name it so")
    checked(saved, path)
    try:
        with replacing(path, force=force) as (partial,):
            write(partial, saved)
    except UnicodeEncodeError as e:
        raise InputError(f"{path}: a name in the map is no Unicode text: {e.object[:60]!r}") from e


def load_map(path: Path) -> SavedMap:
    """A map from .json or .parquet, as it was saved. Raises InputError with path and field."""
    match path.suffix.lower():
        case ".json":
            from vlmm_log.maps.json import read
        case ".parquet":
            from vlmm_log.maps.parquet import read
        case ".ply":
            raise InputError(f"{path}: a PLY is only to look at; give the map's .json or .parquet")
        case _:
            raise InputError(f"{path}: a map is a .json or .parquet file")
    return checked(read(path), path)
