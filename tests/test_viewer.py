"""The recording in the real viewer: every view shows, none complains."""

from pathlib import Path

import cv2
import pytest

import render_room
import vlmm_log

DRIVERS = [p for d in ("/usr/share/vulkan/icd.d", "/etc/vulkan/icd.d") for p in Path(d).glob("*.json")]


@pytest.mark.skipif(not DRIVERS, reason="no Vulkan driver: install mesa-vulkan-drivers to see recordings headless")
@pytest.mark.parametrize("poses", [True, False])
def test_the_viewer_shows_the_recording_without_complaint(tmp_path, poses):
    from viewer_picture import take_picture

    render_room.write_tum(tmp_path / "room", 5)
    if not poses:
        (tmp_path / "room/groundtruth.txt").unlink()
    vlmm_log.process(tmp_path / "room", rrd=tmp_path / "room.rrd")
    assert take_picture(tmp_path / "room.rrd", tmp_path / "room.png", 1) == []
    picture = cv2.imread(str(tmp_path / "room.png"))
    assert picture.shape[:2] == (800, 1280)
    assert len({tuple(c) for c in picture[::8, ::8].reshape(-1, 3).tolist()}) > 500  # images, not an empty window


@pytest.mark.skipif(not DRIVERS, reason="no Vulkan driver: install mesa-vulkan-drivers to see recordings headless")
def test_the_viewer_shows_two_runs_beside_each_other_without_complaint(tmp_path):
    from viewer_picture import take_picture

    render_room.write_tum(tmp_path / "room", 5)
    for profile in ("default", "paper"):
        settings = vlmm_log.Settings.load(profile, sets=[f"objects.segmenter=masks:{tmp_path / 'room/masks'}"])
        vlmm_log.process(tmp_path / "room", rrd=tmp_path / f"{profile}.rrd", settings=settings)
    vlmm_log.diff(tmp_path / "default.rrd", tmp_path / "paper.rrd", rrd=tmp_path / "merged.rrd")
    assert take_picture(tmp_path / "merged.rrd", tmp_path / "merged.png", 1) == []
    picture = cv2.imread(str(tmp_path / "merged.png"))
    assert len({tuple(c) for c in picture[::8, ::8].reshape(-1, 3).tolist()}) > 500
