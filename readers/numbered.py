"""Image files that their names number or time: which belong together, and when they were taken."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path, PurePosixPath

import numpy as np

from vlmm_log.readers.folder import Row
from vlmm_log.readers.stamps import LATEST_NS, seconds_to_ns
from vlmm_log.types import InputError, Skipped

COLOURS = (".png", ".jpg", ".jpeg")
DEPTHS = (".png", ".pgm", ".tif", ".tiff")
TIME_LISTS = ("associations.txt", "times.txt", "timestamps.txt")
TIME_FORMS = "write a time in seconds a row, or 'time file time file'"
LAST_NUMBER = 10**11  # its nominal stamp fits 64 bits
RATE_HZ = 30  # of frames that nothing times
NOMINAL = f"stamps are nominal, {RATE_HZ} per second: speeds in m/s mean nothing"


@dataclass(frozen=True)
class Stamped:
    """Files whose names are times."""

    rows: tuple[Row, ...]  # ascending
    unit: str  # of the names: "s", "ms", "us", "ns"


@dataclass(frozen=True)
class Counted:
    """Files whose names are numbers."""

    files: Mapping[int, str]  # number -> file below the log's folder, ascending


@dataclass(frozen=True)
class Timed:
    """The images of a log in time order, and the times that poses are matched by."""

    rgb: Sequence[Row]
    depth: Sequence[Row]
    taken: Mapping[int, int]  # stamp ns by frame number; by place in ``rgb`` where names are times
    numbers: Sequence[int]  # of the colour images, ascending; keys of ``taken``
    clock: str  # "name": stamps are names, "list": a file lists them, "none": they are nominal
    note: str


def nominal_ns(number: int) -> int:
    """When a frame that nothing times is said to be taken."""
    return round(number * 1_000_000_000 / RATE_HZ)


def named_in(path: Path, folder: str, suffixes: Sequence[str], left_out: list[Skipped]) -> Stamped | Counted:
    """The files of a folder by what their names say; others are told in left_out. Raises InputError where none is left.

    A name is a time where it ends in a decimal fraction (seconds), or where every name is an integer of 13 digits or
    more: in the unit (ns, us, ms) by which frames lie 2 ms to 2 s apart. Else its last digits are a number.
    """
    found: dict[str, str] = {}
    for file in sorted(p.name for p in (path / folder).iterdir() if p.is_file()):
        text = _last_number(Path(file).stem) if Path(file).suffix.lower() in suffixes else None
        if text is None:
            left_out.append(Skipped(0, f"{folder}/{file}", f"not a numbered {', '.join(suffixes)}"))
        else:
            found[f"{folder}/{file}"] = text
    if not found:
        raise InputError(f"{path / folder}: holds no numbered {', '.join(suffixes)}; write its files so")
    if any("." in text for text in found.values()):
        others = [file for file, text in found.items() if "." not in text]
        left_out += [Skipped(0, file, "name is no time in seconds, as others beside it are") for file in others]
        return Stamped(_seconds({file: text for file, text in found.items() if "." in text}, path), "s")
    numbers = {file: int(text) for file, text in found.items()}
    if all(len(text) >= 13 and text[0] != "0" for text in found.values()):
        unit, ns = _unit(sorted(numbers.values()), path / folder)
        return Stamped(_ascending({file: n * ns for file, n in numbers.items()}, path), unit)
    return counted(numbers, path)


def counted(numbers: Mapping[str, int], path: Path) -> Counted:
    """Files by number. Raises InputError where two have the same one."""
    files: dict[int, str] = {}
    for file, number in sorted(numbers.items(), key=lambda item: item[1]):
        if number > LAST_NUMBER:
            raise InputError(f"{path}: {file} has too large a number; name images from 0 on, or by seconds")
        if files.setdefault(number, file) != file:
            raise InputError(f"{path}: {files[number]} and {file} have one number; keep one")
    return Counted(files)


def timed(path: Path, rgb: Stamped | Counted, depth: Stamped | Counted, left_out: list[Skipped]) -> Timed:
    """When the images were taken: by their names, by a list beside them, or nominally. Raises InputError."""
    lists = [path / name for name in TIME_LISTS if (path / name).is_file()]
    match rgb, depth:
        case Stamped(), Stamped():
            unread = "".join(f"; {p.name} is not read" for p in lists)
            if rgb.unit != depth.unit:
                raise InputError(f"{path}: colour is named by {rgb.unit}, depth by {depth.unit}; name both by seconds")
            return _by_name(rgb.rows, depth.rows, f"stamps are the images' names, in {rgb.unit}{unread}")
        case Counted(), Counted():
            if len(lists) > 1:
                raise InputError(f"{path}: both {lists[0].name} and {lists[1].name} could time the images; keep one")
            return _by_list(rgb, depth, lists[0], left_out) if lists else by_number(rgb, depth, path)
    raise InputError(
        f"{path}: images of one kind are named by time, those of the other by number; name both by seconds or by number"
    )


def by_number(rgb: Counted, depth: Counted, path: Path) -> Timed:
    """Images of one number belong together, at nominal times. Raises InputError where numbers cannot say which do."""
    _check_same(rgb, depth, path)
    taken = {n: nominal_ns(n) for n in sorted({*rgb.files, *depth.files})}
    return Timed(_rows(rgb, taken), _rows(depth, taken), taken, list(rgb.files), "none", NOMINAL)


def row_of(numbers: Sequence[int], rows: int, where: Path) -> dict[int, int]:
    """Row of each numbered image: the k-th one's of as many rows as images; else the one of its number, from 0.

    Raises InputError where it is neither.
    """
    if rows == len(numbers):
        return {number: k for k, number in enumerate(numbers)}
    if max(numbers) < rows:
        return {number: number for number in numbers}
    raise InputError(f"{where}: {rows} rows for {len(numbers)} images up to number {max(numbers)}; write one for each")


def words_of(path: Path) -> list[tuple[int, list[str]]]:
    """Line numbers and words of a text file's rows, without comments. Raises InputError where it cannot be read."""
    try:
        lines = path.read_text("utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as e:
        raise InputError(f"{path}: cannot be read: {e}") from e
    rows = [(number, line.split("#")[0].replace(",", " ").split()) for number, line in enumerate(lines, 1)]
    return [(number, words) for number, words in rows if words]


def _by_name(rgb: Sequence[Row], depth: Sequence[Row], note: str) -> Timed:
    taken = {k: row.stamp_ns for k, row in enumerate(rgb)}
    return Timed(rgb, depth, taken, list(taken), "name", note)


def _by_list(rgb: Counted, depth: Counted, where: Path, left_out: list[Skipped]) -> Timed:
    rows = words_of(where)
    widths = {len(words) for _, words in rows}
    if widths == {4}:
        return _by_associations(rgb, depth, where, [words for _, words in rows], left_out)
    if widths != {1}:
        raise InputError(f"{where}: {TIME_FORMS}")
    _check_same(rgb, depth, where.parent)
    numbers = list(rgb.files)
    try:
        stamps = [seconds_to_ns(words[0]) for _, words in rows]
    except ValueError as e:
        raise InputError(f"{where}: {e}; {TIME_FORMS}") from e
    taken = {n: stamps[k] for n, k in row_of(numbers, len(stamps), where).items()}
    if any(b <= a for a, b in pairwise(stamps)):
        raise InputError(f"{where}: times do not ascend; list them in the images' order")
    untimed = [file for n, file in depth.files.items() if n not in taken]
    left_out += [Skipped(0, file, f"{where.name} times no image of its number") for file in untimed]
    return Timed(_rows(rgb, taken), _rows(depth, taken), taken, numbers, "list", f"stamps from {where.name}")


def _by_associations(
    rgb: Counted, depth: Counted, where: Path, rows: Sequence[Sequence[str]], left_out: list[Skipped]
) -> Timed:
    """By rows 'time file time file'; where all times are whole numbers, they number the frames (ICL-NUIM)."""
    key = {str(PurePosixPath(words[k + 1])): words[k] for words in rows for k in (0, 2)}
    there = [set(names.files.values()) for names in (rgb, depth)]
    left_out += [Skipped(0, file, "listed file is missing") for file in key if file not in there[0] | there[1]]
    left_out += [Skipped(0, file, f"not in {where.name}") for file in sorted(there[0] | there[1]) if file not in key]
    listed = [{file: text for file, text in key.items() if file in files} for files in there]
    if not all(listed):
        raise InputError(f"{where}: lists no colour or no depth image of this folder; {TIME_FORMS}")
    if all(re.fullmatch("[0-9]{1,12}", text) for text in key.values()):
        first, second = (counted({file: int(text) for file, text in files.items()}, where) for files in listed)
        return by_number(first, second, where.parent)
    return _by_name(_seconds(listed[0], where), _seconds(listed[1], where), f"stamps from {where.name}")


def _rows(names: Counted, taken: Mapping[int, int]) -> list[Row]:
    return [Row(taken[n], file) for n, file in names.files.items() if n in taken]


def _check_same(rgb: Counted, depth: Counted, path: Path) -> None:
    a, b = rgb.files.keys(), depth.files.keys()
    if not a & b or (len(a) == len(b) and a != b):
        raise InputError(
            f"{path}: colour images are numbered {min(a)} to {max(a)}, depth images {min(b)} to {max(b)}, so it is not "
            "clear which belong together; name them alike"
        )


def _last_number(stem: str) -> str | None:
    found = re.search(r"(?:^|[_-])([0-9]+\.[0-9]+)$", stem) or re.search(r"([0-9]+)[^0-9]*$", stem)
    return found[1] if found and len(found[1]) < 30 else None


def _unit(values: Sequence[int], where: Path) -> tuple[str, int]:
    """The unit of integer times, and its ns: frames lie 2 ms to 2 s apart."""
    step = float(np.median(np.diff(values))) if len(values) > 1 else 0.0
    for unit, ns in (("ns", 1), ("us", 1_000), ("ms", 1_000_000)):
        if 2e6 <= step * ns < 2e9:
            return unit, ns
    raise InputError(
        f"{where}: names look like times, but {step:g} from one to the next is no frame time in ns, us or ms; "
        "name images by seconds"
    )


def _seconds(texts: Mapping[str, str], where: Path) -> tuple[Row, ...]:
    try:
        return _ascending({file: seconds_to_ns(text) for file, text in texts.items()}, where)
    except ValueError as e:
        raise InputError(f"{where}: {e}; name images by seconds or by number") from e


def _ascending(stamps: Mapping[str, int], where: Path) -> tuple[Row, ...]:
    rows = sorted((Row(stamp_ns, file) for file, stamp_ns in stamps.items()), key=lambda row: row.stamp_ns)
    for a, b in pairwise(rows):
        if a.stamp_ns == b.stamp_ns:
            raise InputError(f"{where}: {a.rest} and {b.rest} have one time; keep one")
    if rows[-1].stamp_ns > LATEST_NS:
        raise InputError(f"{where}: {rows[-1].rest}: too late a time; name images by seconds or by number")
    return tuple(rows)
