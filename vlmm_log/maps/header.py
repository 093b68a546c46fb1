"""What every map file says of itself and of the run: the same JSON object in each format."""

from __future__ import annotations

from vlmm_log.maps.fields import Field
from vlmm_log.maps.saved import FORMAT, VERSION, SavedMap
from vlmm_log.types import Float64, Run, RunEnd

NAMES = ("format", "version", "run", "end", "origin_ns", "T_world_cam")
Header = tuple[Run, RunEnd, int, Float64 | None]


def header(saved: SavedMap) -> dict[str, object]:
    """All of a map file but elements and background."""
    run, end = saved.run, saved.end
    return {
        "format": FORMAT,
        "version": VERSION,
        "run": {
            "source": run.source,
            "reader": run.reader,
            "settings": run.settings,
            "versions": dict(sorted(run.versions.items())),
            "has_poses": run.has_poses,
            "world_up": run.world_up,
            "notes": list(run.notes),
        },
        "end": {
            "complete": end.complete,
            "input_hash": end.input_hash,
            "frames": int(end.frames),
            "pairs": int(end.pairs),
        },
        "origin_ns": int(saved.origin_ns),
        "T_world_cam": None if saved.T_world_cam is None else saved.T_world_cam.astype(float).tolist(),
    }


def check_version(top: Field) -> None:
    """Raise InputError where the document is no map, or one of a version unknown here."""
    if not isinstance(top.value, dict) or top.value.get("format") != FORMAT:
        raise top.wrong("is not a map of vlmm-log")
    version = top.member("version").integer()
    if version != VERSION:
        raise top.wrong(
            f"is version {version} of the map format, this vlmm-log reads version {VERSION}; install another"
        )


def read_header(top: Field) -> Header:
    """Run, its end, origin and last pose."""
    pose = top.member("T_world_cam")
    T = None if pose.value is None else pose.floats(4)
    return _run(top.member("run")), _end(top.member("end")), top.member("origin_ns").integer(), T


def _run(field: Field) -> Run:
    names = ("source", "reader", "settings", "versions", "has_poses", "world_up", "notes")
    source, reader, settings, versions, has_poses, world_up, notes = field.members(names)
    return Run(
        source.text(),
        reader.text(),
        settings.text(),
        {name: versions.member(name).text() for name in versions.names()},
        has_poses.truth(),
        world_up.text(),
        tuple(note.text() for note in notes.items()),
    )


def _end(field: Field) -> RunEnd:
    complete, input_hash, frames, pairs = field.members(("complete", "input_hash", "frames", "pairs"))
    return RunEnd(complete.truth(), input_hash.text(), frames.integer(), pairs.integer())
