"""The commands on README and pages, carried out in their order, on small logs that stand in for the reader's own."""

import shlex
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner
from small_room import write_masks, write_small_room
from test_docs import PAGES, lines

import vlmm_log
from tum_folder import write_tum_folder
from vlmm_log.cli import cli
from vlmm_log.types import InputError

NEEDED = {  # by a page's commands before they make it themselves
    "README.md": ["walking.bag", "after.rrd"],
    "docs/batch.md": ["logs", "maps_before", "maps_after"],
    "docs/diff.md": ["walking", "reference_log", "reference.rrd"],
    "docs/evaluate.md": ["room", "mine", "masks"],
    "docs/index.md": [],
    "docs/logs.md": ["walking.bag", "rgbd_dataset_freiburg1_xyz"],
    "docs/process.md": ["rgbd_dataset_freiburg3_walking_xyz"],
    "docs/query.md": ["walking.rrd", "map.json"],
    "docs/tutorial.md": ["room"],
}
ELSEWHERE = {  # beginning of a command -> where it is carried out
    "vlmm-log view": "test_view.py",
    "vlmm-log datasets get": "test_datasets.py",
    "vlmm-log simulate": "test_simulate.py",
    "vlmm-log eval walking --truth person": "test_eval_cli.py",
}


def commands(name):
    return [line for line in lines(PAGES[name]) if line.startswith("vlmm-log ")]


def expanded(word):
    """As a shell does."""
    return sorted(map(str, Path().glob(word))) if word.endswith("/*") else [word]


@pytest.fixture(scope="module")
def stand_ins(tmp_path_factory):
    """A folder with all that any page needs."""
    folder = tmp_path_factory.mktemp("stand_ins")
    room = folder / "room"
    write_small_room(room, 12)
    for name in ("walking", "reference_log", "mine", "rgbd_dataset_freiburg1_xyz", "logs/a", "logs/b"):
        shutil.copytree(room, folder / name)
        shutil.copytree(room / "truth/instances", folder / name / "masks")
    write_tum_folder(folder / "rgbd_dataset_freiburg3_walking_xyz", size=(96, 72), frames=70)
    instances = {
        int(p.stem): cv2.imread(str(p), cv2.IMREAD_UNCHANGED) for p in (room / "truth/instances").glob("*.png")
    }
    write_masks(folder / "masks", {k: np.where(ids == ids.max(), 255, 0) for k, ids in instances.items()})
    vlmm_log.convert(room, folder / "walking.bag")
    settings = vlmm_log.Settings.load(sets=[f"objects.segmenter=masks:{room}/truth/instances"])
    vlmm_log.process(room, rrd=folder / "walking.rrd", map=folder / "map.json", settings=settings)
    for name in ("after.rrd", "reference.rrd"):
        shutil.copyfile(folder / "walking.rrd", folder / name)
    for name in ("maps_before", "maps_after"):
        vlmm_log.batch([room], folder / name, workers=1)
    return folder


def test_every_page_with_commands_is_carried_out():
    assert {name for name in PAGES if commands(name)} == set(NEEDED)


@pytest.mark.parametrize("name", NEEDED)
def test_the_commands_of_a_page(stand_ins, tmp_path, monkeypatch, name):
    for needed in NEEDED[name]:
        source = stand_ins / needed
        shutil.copytree(source, tmp_path / needed) if source.is_dir() else shutil.copyfile(source, tmp_path / needed)
    monkeypatch.chdir(tmp_path)
    for line in commands(name):
        if line.startswith(tuple(ELSEWHERE)):
            continue
        words = [word for given in shlex.split(line, comments=True)[1:] for word in expanded(given)]
        done = CliRunner().invoke(cli, words)
        if isinstance(done.exception, InputError):
            assert f"vlmm-log: {done.exception}" in PAGES[name].splitlines(), line
        else:
            assert done.exit_code in (0, 1), (line, done.stderr, done.exception)  # 1: the answer is no
