"""``diff`` of two batches: log by log, by name."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from vlmm_log.batches.manifest import read_manifest
from vlmm_log.batches.tasks import Outcome, State
from vlmm_log.compare import EVERYTHING, EXACT, diff
from vlmm_log.comparison.tolerance import Choice, Tolerance
from vlmm_log.comparison.words import readable, summary
from vlmm_log.protocols import Progress
from vlmm_log.types import InputError

FILES = ("run.rrd", "run.mcap", "map.json")  # the first that both have is compared
SAME, DIFFERENT, UNKNOWN = "same", "different", "cannot be compared"
TOLD = ("settings:", "input:", "first divergence:", "class flipped:")


@dataclass(frozen=True)
class LogDifference:
    """What differs in one log."""

    name: str
    verdict: str  # same, different, only in A, only in B, failed in both, done in neither, cannot be compared
    told: str = ""  # one line
    files: tuple[str, str] | None = None  # that were compared: `diff` of them tells more


@dataclass(frozen=True)
class BatchDifference:
    """What differs between two batches, a log each; A's order, then what only B has."""

    a: str
    b: str
    logs: tuple[LogDifference, ...]

    @property
    def same(self) -> bool:
        """Whether each log is, or failed in both."""
        return all(log.verdict in (SAME, "failed in both") for log in self.logs)

    def report(self) -> dict[str, object]:
        """For scripts."""
        logs = [
            {"name": x.name, "verdict": x.verdict, "told": x.told or None, "files": x.files and list(x.files)}
            for x in self.logs
        ]
        return {
            "format": "vlmm-log batch diff",
            "version": 1,
            "a": self.a,
            "b": self.b,
            "same": self.same,
            "logs": logs,
        }


def diff_batches(
    a: str | Path,
    b: str | Path,
    *,
    tolerance: Tolerance = EXACT,
    choice: Choice = EVERYTHING,
    progress: Progress | None = None,
) -> BatchDifference:
    """Compare the logs of two folders that ``batch`` wrote, those of one name with each other.

    Logs that share a name within a batch are paired in their order. Raises InputError where a manifest cannot be read
    or no log could be compared.
    """
    folders = Path(a), Path(b)
    by_name = [_by_name(read_manifest(folder)) for folder in folders]
    keys = list(dict.fromkeys([*by_name[0], *by_name[1]]))
    found = []
    for k, key in enumerate(keys, 1):
        found.append(_log(key[0], folders, [tasks.get(key) for tasks in by_name], tolerance, choice))
        if progress is not None:
            progress(k, len(keys))
    if not any(log.verdict in (SAME, DIFFERENT) for log in found):
        why = next((log.told for log in found if log.verdict == UNKNOWN), "they share no log that is done in both")
        raise InputError(f"{folders[0]} and {folders[1]}: cannot be compared: {why}")
    return BatchDifference(readable(folders[0]), readable(folders[1]), tuple(found))


def _by_name(outcomes: Sequence[Outcome]) -> dict[tuple[str, int], Outcome]:
    seen: Counter[str] = Counter()
    named = {}
    for outcome in outcomes:
        named[outcome.name, seen[outcome.name]] = outcome
        seen[outcome.name] += 1
    return named


def _log(
    name: str, folders: tuple[Path, Path], pair: Sequence[Outcome | None], tolerance: Tolerance, choice: Choice
) -> LogDifference:
    done = [o is not None and o.state == State.DONE for o in pair]
    if not all(done):
        failed = all(o is not None and o.state == State.FAILED for o in pair)
        neither = "failed in both" if failed else "done in neither"
        verdict = "only in A" if done[0] else "only in B" if done[1] else neither
        return LogDifference(name, verdict, "; ".join(_undone(pair)))
    a, b = (folder / o.folder for folder, o in zip(folders, pair, strict=True) if o is not None)
    shared = next((file for file in FILES if (a / file).is_file() and (b / file).is_file()), None)
    if shared is None:
        return LogDifference(name, UNKNOWN, f"{a} and {b} hold no file of one kind")
    try:
        d = diff(a / shared, b / shared, tolerance=tolerance, choice=choice)
    except InputError as e:
        return LogDifference(name, UNKNOWN, str(e))
    told = "; ".join(line for line in summary(d) if line.startswith(TOLD)) or "; ".join(summary(d)[1:])
    return LogDifference(name, SAME if d.same else DIFFERENT, "" if d.same else told, (d.a, d.b))


def _undone(pair: Sequence[Outcome | None]) -> Iterator[str]:
    for side, outcome in zip("AB", pair, strict=True):
        if outcome is not None and outcome.state != State.DONE:
            yield f"{side}: {outcome.state}{': ' if outcome.error else ''}{outcome.error}"
