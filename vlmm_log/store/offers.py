"""What is known of files that can be fetched: a catalogue in TOML, one Offer a file."""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from vlmm_log.types import InputError

DATASETS = Path(__file__).parents[1] / "data/datasets.toml"


@dataclass(frozen=True)
class Offer:
    """A file on somebody's site."""

    name: str  # as it is asked for
    file: str  # as it is called there
    url: str
    title: str  # of the collection
    page: str  # of the collection
    licence: str
    cite: str
    folder: str = ""  # what the archive holds and is unpacked to; "": it is no archive
    size: int = 0  # bytes; 0: not known
    sha256: str = ""  # "": none is known, the first download decides
    movers: str = ""
    about: str = ""


def datasets_on_offer(path: Path = DATASETS) -> tuple[Offer, ...]:
    """The sequences of a catalogue, in its order."""
    collections = tomllib.loads(path.read_text("utf-8"))["collections"]
    return tuple(_sequence(c, s) for c in collections for s in c["sequences"])


def _sequence(collection: dict[str, Any], sequence: dict[str, Any]) -> Offer:
    folder = collection["prefix"] + sequence["name"]
    file = folder + collection["suffix"]
    return Offer(
        name=sequence["name"],
        file=file,
        url="/".join(part for part in (collection["base"], sequence.get("group"), file) if part),
        title=collection["title"],
        page=collection["page"],
        licence=collection["licence"],
        cite=collection["cite"],
        folder=folder,
        size=sequence.get("bytes", 0),
        sha256=sequence.get("sha256", ""),
        movers=sequence["movers"],
        about=sequence["about"],
    )


def named(name: str, offers: Sequence[Offer]) -> Offer:
    """The offer of a name, or of its folder's or file's. Raises InputError, which says the nearest name."""
    wanted = name.rstrip("/")
    for offer in offers:
        if wanted in (offer.name, offer.folder, offer.file):
            return offer
    near = difflib.get_close_matches(wanted.removeprefix("rgbd_dataset_"), [offer.name for offer in offers], 1, 0.5)
    raise InputError(f"{name}: is not in the list{f'; nearest is {near[0]}' if near else '; `list` says what is'}")
