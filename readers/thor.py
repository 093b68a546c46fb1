"""Folders that examples/record_ai2thor.py writes from the events of AI2-THOR, a simulated home. Kolve et al., 2017."""

from __future__ import annotations

from pathlib import Path

from vlmm_log.protocols import Log
from vlmm_log.readers.conventions import Convention
from vlmm_log.readers.plain import Plain, open_folder
from vlmm_log.readers.thor_truth import FILE, read_truth
from vlmm_log.settings import ReadSettings


class Thor:
    """The reader."""

    name = "ai2thor"

    def recognises(self, path: Path) -> bool:
        """A plain folder with truth/objects.jsonl."""
        return (path / FILE).is_file() and Plain().recognises(path)

    def open(self, path: Path, s: ReadSettings) -> Log:
        """The log of a folder. Raises InputError as Plain does, and where the truth cannot be read."""
        log = open_folder(path, s, None, Convention(), up="+z")
        truth = read_truth(path)
        frames = len({thing.frame for thing in truth})
        log.notes.append(f"truth of {len({thing.identity for thing in truth})} objects in {frames} frames: {FILE}")
        if (path / "masks").is_dir():
            log.notes.append("true instances in masks/: give --segmenter masks:FOLDER/masks")
        return log
