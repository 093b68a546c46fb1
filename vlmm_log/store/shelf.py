"""One file of somebody's site in a folder of ours: fetched if it is not there, and the right one or refused."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from vlmm_log.protocols import Progress
from vlmm_log.store.download import Patience, Tell, download
from vlmm_log.store.hashes import checked_sha256, recorded
from vlmm_log.store.offers import Offer
from vlmm_log.types import InputError

LARGEST = 8 << 30  # bytes, of a file whose size is not known
SLACK = 1.25  # a file may have so many times the bytes that were reported


@dataclass(frozen=True)
class Expected:
    """What the file's hash is to be, and who says so."""

    sha256: str  # "": whatever comes
    source: str


def expected(offer: Offer, folder: Path, given: str) -> Expected:
    """By the caller, else by the list, else by the first download. Raises InputError for what is no hash."""
    if given:
        return Expected(checked_sha256(given), "--sha256")
    if offer.sha256:
        return Expected(offer.sha256, "the list")
    return Expected(recorded(folder / offer.file), "the first download")


def fetched(
    offer: Offer, folder: Path, known: Expected, progress: Progress, tell: Tell, patience: Patience | None = None
) -> Path:
    """The file of an offer in ``folder``: the one that lies there, else a new one. Raises InputError."""
    import pooch

    file = folder / offer.file
    pooch.get_logger().setLevel("WARNING")  # it would tell what is told here
    shelf = pooch.create(folder, "", registry={}, allow_updates=False)  # what lies there is not replaced
    shelf.registry[offer.file] = known.sha256 or None  # None: any is right
    shelf.urls[offer.file] = offer.url
    there = file.exists()

    def come(url: str, out: str, _: object) -> None:
        most = int(offer.size * SLACK) or LARGEST
        partial = file.with_name(file.name + ".partial")
        download(url, Path(out), partial, most=most, progress=progress, tell=tell, patience=patience or Patience())

    try:
        return Path(shelf.fetch(offer.file, downloader=come))
    except ValueError as e:  # of pooch, for a hash
        what = f"{file}: lies there" if there else f"{offer.url}: came"
        remedy = "remove it, or" if there else "nothing was kept; if the new content is right,"
        raise InputError(
            f"{what} with another SHA-256 than {known.source} says; {remedy} give its own with --sha256"
        ) from e


def elsewhere(offer: Offer, url: str) -> Offer:
    """The same file from another place."""
    return replace(offer, url=url) if url else offer
