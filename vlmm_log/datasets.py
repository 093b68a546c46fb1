"""``datasets``: recorded sequences to try this on, fetched from their official sites when they are asked for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from vlmm_log.protocols import Progress
from vlmm_log.store.archives import unpack
from vlmm_log.store.download import Patience, Tell, check_url
from vlmm_log.store.hashes import record
from vlmm_log.store.offers import Offer, datasets_on_offer, named
from vlmm_log.store.shelf import elsewhere, expected, fetched
from vlmm_log.writers.staging import claim_folder, replacing_folder


@dataclass(frozen=True)
class Shelved:
    """A sequence that is on offer, and what of it lies in a folder."""

    offer: Offer
    state: str  # "here", "archive", "begun" or ""
    path: Path  # of the sequence, of its archive, of the archive's beginning
    size: int  # bytes of a beginning; else 0

    def report(self) -> dict[str, object]:
        """As plain values, for JSON."""
        return asdict(self.offer) | {"state": self.state, "path": str(self.path) if self.state else None}


@dataclass(frozen=True)
class Got:
    """What ``get_dataset`` leaves."""

    offer: Offer
    path: Path  # of the sequence
    sha256: str  # of the archive
    source: str  # who says that this is the right one
    outside: int  # members of the archive that do not belong to the sequence, left out

    def report(self) -> dict[str, object]:
        """As plain values, for JSON."""
        told = {"path": str(self.path), "sha256": self.sha256, "sha256_by": self.source, "left_out": self.outside}
        return {"name": self.offer.name, "url": self.offer.url, "licence": self.offer.licence, **told}


def datasets(to: str | Path = ".", *, offers: Sequence[Offer] | None = None) -> tuple[Shelved, ...]:
    """Sequences on offer, and what of them lies in folder ``to``. Nothing is asked of any server."""
    return tuple(_shelved(offer, Path(to)) for offer in offers or datasets_on_offer())


def _shelved(offer: Offer, to: Path) -> Shelved:
    folder, archive, begun = to / offer.folder, to / offer.file, to / f"{offer.file}.partial"
    if any((folder / name).is_file() for name in ("rgb.txt", "depth.txt")):
        return Shelved(offer, "here", folder, 0)
    if archive.is_file():
        return Shelved(offer, "archive", archive, 0)
    if begun.is_file():
        return Shelved(offer, "begun", begun, begun.stat().st_size)
    return Shelved(offer, "", folder, 0)


def dataset(name: str, *, offers: Sequence[Offer] | None = None) -> Offer:
    """What is known of a sequence: origin, licence, size. Raises InputError for a name that is not in the list."""
    return named(name, offers or datasets_on_offer())


def get_dataset(
    name: str,
    *,
    to: str | Path = ".",
    url: str = "",
    sha256: str = "",
    keep_archive: bool = False,
    force: bool = False,
    progress: Progress | None = None,
    tell: Tell | None = None,
    offers: Sequence[Offer] | None = None,
    patience: Patience | None = None,
) -> Got:
    """Fetch a sequence into folder ``to`` and unpack it: from its official site, or from ``url``.

    An archive that lies in ``to`` already is used; one that was begun is gone on with. It has to have the SHA-256 that
    is given or known; where none is, the first download's is kept in NAME.sha256 and asked of all later ones. The
    archive is removed after unpacking if it was fetched here, unless it is to be kept. An existing sequence is replaced
    only with ``force``. ``progress`` is told MB done and expected, ``tell`` what is not as expected. Mind the licence:
    ``dataset(name).licence``. Raises InputError where the file cannot be had, is not the right one, or does not unpack.
    """
    offer = elsewhere(dataset(name, offers=offers), url)
    check_url(offer.url)
    folder = Path(to)
    target, archive = folder / offer.folder, folder / offer.file
    claim_folder(target, [], force=force)
    known = expected(offer, folder, sha256)
    ours = not archive.exists()
    folder.mkdir(parents=True, exist_ok=True)
    fetched(offer, folder, known, progress or _quiet, tell or _silent, patience)
    with replacing_folder(target) as staged:
        outside = unpack(archive, staged)
    value = known.sha256 or record(archive, offer.url)  # only of what could be unpacked
    if ours and not keep_archive:
        archive.unlink()
    return Got(offer, target, value, known.source if known.sha256 else "", outside)


def _quiet(_done: int, _expected: int) -> None: ...


def _silent(_line: str) -> None: ...
