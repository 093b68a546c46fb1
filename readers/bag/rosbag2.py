"""ROS 2 bags: folders with metadata.yaml and one or several parts."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path, PurePath
from tempfile import TemporaryDirectory
from typing import Any

from vlmm_log.readers.bag.containers import Message, Topic, is_part
from vlmm_log.readers.bag.parts import Part, expanded, opener
from vlmm_log.readers.bag.runs import Run, merged, ranked
from vlmm_log.scratch import scratch
from vlmm_log.types import InputError, Int64, Skipped


def open_rosbag2(path: Path) -> JoinedBag:
    """A folder, or one file that may be compressed, as one recording. Raises InputError."""
    told, losses = _metadata(path) if path.is_dir() else ({}, [])
    files = [path] if path.is_file() else _files(path, told, losses)
    if not files:
        missing = ", ".join(loss.what for loss in losses[:5] if loss.what != "metadata.yaml") or ".db3 or .mcap files"
        raise InputError(f"{path}: no part of the bag is there; copy {missing} beside its metadata.yaml")
    folder = scratch()
    parts: list[Part] = []
    refused: list[InputError] = []
    for file in files:
        try:
            plain, lost = expanded(file, folder)
            parts.append(opener(plain)(plain))
            losses += lost
        except InputError as e:
            refused.append(e)
            losses.append(Skipped(0, file.name, "part of the bag cannot be opened"))
    if not parts:
        folder.cleanup()
        raise refused[0]
    losses += _uncounted(told, parts)
    kinds = sorted({re.sub(r"^MCAP.*", "ROS 2 bag (mcap)", part.kind) for part in parts})
    return JoinedBag(path, ", ".join(kinds), tuple(parts), tuple(losses), folder)


def _metadata(path: Path) -> tuple[Mapping[str, Any], list[Skipped]]:
    """What metadata.yaml says; nothing, and why, where it cannot be used."""
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    file = path / "metadata.yaml"
    if not file.is_file():
        return {}, [Skipped(0, file.name, "metadata.yaml is missing; parts were taken in the order of names")]
    with suppress(OSError, ValueError, YAMLError, LookupError, TypeError, AttributeError, RecursionError):
        text = file.read_text("utf-8")
        merges = "<<" in text  # few keys, merged again and again, make any number
        told = {} if merges else YAML(typ="safe").load(text)["rosbag2_bagfile_information"]
        names = told["relative_file_paths"]
        if names and isinstance(names, list) and all(isinstance(name, str) for name in names):
            return told, []
    return {}, [Skipped(0, file.name, "metadata.yaml cannot be used; parts were taken in the order of names")]


def _files(path: Path, told: Mapping[str, Any], losses: list[Skipped]) -> list[Path]:
    """The parts that are there, in order."""
    there = {p.name: p for p in path.iterdir() if p.is_file()}
    present = sorted(filter(is_part, there.values()), key=_natural)
    if not told:
        _check_one(path, present)
        return present
    files = []
    for name in (PurePath(entry).name for entry in told["relative_file_paths"]):
        spellings = (name, name.removesuffix(".zstd"), f"{name}.zstd")  # someone may have compressed or expanded it
        found = next((there[n] for n in spellings if n in there), None)
        if found is None:
            losses.append(Skipped(0, name, "part named in metadata.yaml is missing"))
        else:
            files.append(found)
    losses += [Skipped(0, p.name, "part is not named in metadata.yaml") for p in present if p not in files]
    return files


def _check_one(path: Path, present: Sequence[Path]) -> None:
    """Without metadata.yaml, only files NAME_0, NAME_1, ... are taken for parts of one recording."""
    stems = {re.sub(r"_\d+$", "", p.name.removesuffix(".zstd").rsplit(".", 1)[0]) for p in present}
    if len(stems) > 1:
        names = ", ".join(p.name for p in present[:5])
        raise InputError(f"{path}: holds several recordings and no metadata.yaml; take one of them: {names}")


def _natural(path: Path) -> list[tuple[int, str]]:
    """Order of names in which part 10 comes after part 9."""
    return [(int(word), "") if word.isdigit() else (-1, word) for word in re.split(r"(\d+)", path.name)]


def _uncounted(told: Mapping[str, Any], parts: Sequence[Part]) -> list[Skipped]:
    """How many messages metadata.yaml counts beyond what the parts hold."""
    counts = [topic.count for part in parts for topic in part.topics]
    expected = told.get("message_count")
    if not isinstance(expected, int) or any(n is None for n in counts):
        return []
    missing = expected - sum(n or 0 for n in counts)
    return [Skipped(0, f"{missing} messages", "counted in metadata.yaml, but in no part")] if missing > 0 else []


@dataclass(eq=False)
class JoinedBag:
    """See containers.Container."""

    path: Path
    kind: str
    parts: tuple[Part, ...]
    own_losses: tuple[Skipped, ...]
    scratch: TemporaryDirectory[str]  # for parts that were compressed
    _ranks: dict[str, tuple[Int64, list[Int64]]] = field(default_factory=dict)

    @property
    def topics(self) -> tuple[Topic, ...]:
        """See containers.Container."""
        counts: dict[Topic, int | None] = {}
        for topic in (t for part in self.parts for t in part.topics):
            key = replace(topic, count=None)
            before = counts.get(key, 0)
            counts[key] = None if before is None or topic.count is None else before + topic.count
        found = (replace(topic, count=n) for topic, n in counts.items())
        return tuple(sorted(found, key=lambda t: (t.name, t.type, t.encoding)))

    @property
    def start_ns(self) -> int:
        """See containers.Container."""
        return min((p.start_ns for p in self.parts if p.stop_ns), default=0)

    @property
    def stop_ns(self) -> int:
        """See containers.Container."""
        return max(p.stop_ns for p in self.parts)

    @property
    def losses(self) -> tuple[Skipped, ...]:
        """See containers.Container."""
        return (*self.own_losses, *(loss for part in self.parts for loss in part.losses))

    def messages(self, topics: Collection[str], start_ns: int, stop_ns: int) -> Iterator[Message | Skipped]:
        """See containers.Container."""
        joined = {replace(t, count=None): t for t in self.topics}
        runs = []
        for k, part in enumerate(self.parts):
            if part.stop_ns > start_ns and part.start_ns < stop_ns:
                items = partial(self._part, k, frozenset(topics), start_ns, stop_ns, joined)
                runs.append(Run(part.start_ns, k, items))
        return merged(runs)

    def _part(
        self, k: int, topics: frozenset[str], start_ns: int, stop_ns: int, joined: Mapping[Topic, Topic]
    ) -> Iterator[Message | Skipped]:
        for item in self.parts[k].messages(topics, start_ns, stop_ns):
            match item:
                case Message():
                    ordinal = int(self._ranked(item.topic.name)[1][k][item.ordinal])
                    yield replace(item, topic=joined[replace(item.topic, count=None)], ordinal=ordinal)
                case Skipped():
                    yield item

    def _ranked(self, name: str) -> tuple[Int64, list[Int64]]:
        if name not in self._ranks:
            self._ranks[name] = ranked([part.all_times(name) for part in self.parts])
        return self._ranks[name]

    def log_times(self, topic: str) -> Int64 | None:
        """See containers.Container."""
        if any(part.log_times(topic) is None for part in self.parts):
            return None
        return self._ranked(topic)[0].copy()

    def close(self) -> None:
        """See containers.Container."""
        for part in self.parts:
            part.close()
        self.scratch.cleanup()
