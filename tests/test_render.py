"""Pictures and videos of recordings: what must be seen in them is there, whatever container it comes from."""

import json
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

import render_room
import vlmm_log
from vlmm_log.cli import cli
from vlmm_log.drawing.panels import DEFAULT, PANELS
from vlmm_log.drawing.sheet import laid_out
from vlmm_log.drawing.video import Video, decoded_frames
from vlmm_log.elements import CLASS_COLORS, MotionClass
from vlmm_log.entries import EGO_UNRELIABLE, Entry, LogLine, Scalar
from vlmm_log.picturing import render
from vlmm_log.recording import open_recording
from vlmm_log.recording.frames import AHEAD, by_frame, pairs
from vlmm_log.sinks.legend import LEGEND, viewer_legend
from vlmm_log.sinks.views import VALIDITY_COLORS
from vlmm_log.types import InputError

FRAMES = 10  # 7 pairs
IMAGE = "world/camera/image"


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    folder = tmp_path_factory.mktemp("logs")
    render_room.write_tum(folder / "room", FRAMES)
    s = vlmm_log.Settings.load(sets=[f'objects.segmenter="masks:{folder / "room/masks"}"'])
    vlmm_log.process(folder / "room", rrd=folder / "room.rrd", mcap=folder / "room.mcap", settings=s)
    return folder


@pytest.fixture(scope="module")
def recording(room):
    return room / "room.rrd"


def seen(path, panel):
    """The pixels of one panel on a sheet of its own, RGB, as large as the images."""
    sheet = laid_out([PANELS[panel]], 4 / 3)
    (left, top), (width, height) = sheet.places[0], sheet.size
    pixels = cv2.imread(str(path))[top : top + height, left : left + width, ::-1]
    return cv2.resize(pixels, (640, 480), interpolation=cv2.INTER_AREA).astype(int)


def share_of(color, pixels):
    return float(np.mean((pixels == color).all(axis=-1)))


def inside(room, frame, names):
    """Where things are, without their borders."""
    labels = cv2.imread(str(room / f"room/masks/{frame:06d}.png"), cv2.IMREAD_UNCHANGED)
    ids = [i for i, name in render_room.NAMES.items() if name in names]
    return cv2.erode(np.isin(labels, ids).astype(np.uint8), np.ones((31, 31))) > 0


def test_what_moves_is_bright_in_d_m_and_the_walls_are_dark(room, recording, tmp_path):
    render(recording, tmp_path / "a.png", frame=4, panels=["d_m"])
    light = seen(tmp_path / "a.png", "d_m").sum(axis=-1)
    movers = inside(room, 4, {"ball", "box"})
    still = ~cv2.dilate(movers.astype(np.uint8), np.ones((81, 81))).astype(bool)
    assert movers.sum() > 1000
    assert np.median(light[movers]) > 600
    assert np.median(light[still]) < 150


def test_elements_have_the_colour_of_their_class(room, recording, tmp_path):
    render(recording, tmp_path / "a.png", frame=6, panels=["elements"])
    pixels = seen(tmp_path / "a.png", "elements")
    for names, kind in (({"ball", "box"}, MotionClass.MOVING), ({"shelf"}, MotionClass.STATIC)):
        where = inside(room, 6, names)
        others = [c for k, c in CLASS_COLORS.items() if k != kind]
        mean = pixels[where].mean(axis=0)
        own = np.abs(mean - CLASS_COLORS[kind]).sum()
        assert all(own < np.abs(mean - other).sum() for other in others), (names, mean)


def test_colours_of_the_legend_are_those_of_the_picture(recording, tmp_path):
    render(recording, tmp_path / "a.png", frame=4, panels=["validity"])
    whole = cv2.imread(str(tmp_path / "a.png"))[..., ::-1]
    strip = whole[laid_out([PANELS["validity"]], 4 / 3).places[0][1] + 951 :]
    for reason, color in VALIDITY_COLORS.items():
        assert share_of(color, strip) > 0, reason
    assert share_of(VALIDITY_COLORS[0], seen(tmp_path / "a.png", "validity")) > 0.8


def test_the_viewer_has_a_legend_of_all_classes(recording):
    assert LEGEND in open_recording(recording).entities
    pixels = viewer_legend()
    for named, color in (*VALIDITY_COLORS.items(), *CLASS_COLORS.items()):
        assert share_of(color, pixels) >= 100 / (pixels.shape[0] * pixels.shape[1]), named


def test_both_containers_give_equal_pictures_of_all_that_they_hold(room, tmp_path):
    held = [name for name in PANELS if name not in ("p_moving", "score", "truth", "outcome")]
    for suffix in ("rrd", "mcap"):
        done = render(room / f"room.{suffix}", tmp_path / f"{suffix}.png", frame=5, panels=held)
        assert (done.panels, done.told, done.frames, done.first) == (tuple(held), (), 1, 5)
    assert (tmp_path / "rrd.png").read_bytes() == (tmp_path / "mcap.png").read_bytes()


def test_a_video_shows_its_window_in_order(recording, tmp_path):
    start, stop = 2 / 30 - 0.001, 6 / 30 - 0.001
    video = tmp_path / "a.mp4"
    done = vlmm_log.render(recording, video, panels=["rgb"], start=start, stop=stop)
    assert (done.frames, done.first, done.last, done.fps) == (4, 2, 5, 30.0)
    assert [p.name for p in tmp_path.iterdir()] == ["a.mp4"]
    stills = []
    for frame in range(FRAMES - 3):
        render(recording, tmp_path / "a.png", frame=frame, panels=["rgb"], force=True)
        stills.append(cv2.imread(str(tmp_path / "a.png")).astype(int))
    shown, read = cv2.VideoCapture(str(video)), []
    while (got := shown.read())[0]:
        assert got[1].shape == stills[0].shape
        read.append(int(np.argmin([np.abs(got[1] - still).mean() for still in stills])))
    assert read == [2, 3, 4, 5]
    assert shown.get(cv2.CAP_PROP_FPS) == 30


def test_a_video_that_was_not_written_whole_is_refused(tmp_path):
    video = Video(tmp_path / "a.mp4", (64, 48), 10.0)
    for _ in range(5):
        video.add(np.zeros((48, 64, 3), np.uint8))
    video.add(np.zeros((24, 32, 3), np.uint8))  # OpenCV passes over it without a word, as over a full disk
    with pytest.raises(OSError, match="of 6 frames 5 can be read"):
        video.finish()
    assert decoded_frames(tmp_path / "a.mp4") == 5


def test_a_panel_that_is_not_held_is_told(recording, tmp_path):
    done = render(recording, tmp_path / "a.png", frame=0, panels=["truth", "rgb"])
    assert done.panels == ("rgb",)
    assert done.told[0].startswith("truth: not in this recording; it can show rgb, depth, flow, d_m")
    assert set(DEFAULT) <= set(PANELS)


def test_of_a_torn_recording_what_there_is_is_drawn(recording, tmp_path):
    data = recording.read_bytes()
    (tmp_path / "torn.rrd").write_bytes(data[: int(0.7 * len(data))])
    done = render(tmp_path / "torn.rrd", tmp_path / "a.mp4")
    assert 0 < done.frames < FRAMES - 3 or "incomplete" in " ".join(done.told)
    assert any("did not finish" in line for line in done.told)


REFUSED = {  # output and options -> what is told
    ("a.png", ("frame", 41)): "holds no pair of frame 41; the nearest: 6 (it holds 7 pairs, of frames 0 to 6)",
    ("a.png", ("frame", -1)): "the nearest: 0",
    ("a.png", ("frame", 1), ("panels", ("dm",))): "panel 'dm': no such panel; did you mean d_m?",
    ("a.png", ("frame", 1), ("panels", ("truth", "score"))): "truth, score: not in this recording; it can show rgb",
    ("a.png", ("frame", 1), ("fps", 5.0)): "fps, start and stop are of a video",
    ("a.gif", ("frame", 1)): "name a picture, a.png or a.jpg",
    ("a.avi",): "name a video, a.mp4",
    ("a.mp4", ("start", 9.0)): "no pair lies in that window; they begin from 0 to 0.200 s",
    ("a.mp4", ("fps", 0.0)): "fps = 0.0: more than 0",
    ("a.mp4", ("start", float("nan"))): "start and stop are seconds",
}


@pytest.mark.parametrize("call", REFUSED, ids=str)
def test_what_cannot_be_drawn_is_refused_and_nothing_is_left(recording, tmp_path, call):
    with pytest.raises(InputError) as e:
        render(recording, tmp_path / call[0], **dict(call[1:]))
    assert REFUSED[call] in str(e.value)
    assert not list(tmp_path.iterdir())


def test_nothing_is_replaced_unasked(recording, tmp_path):
    (tmp_path / "a.mp4").write_text("mine")
    with pytest.raises(InputError, match="exists; give --force"):
        render(recording, tmp_path / "a.mp4")
    with pytest.raises(InputError, match="not a recording"):
        render(tmp_path / "a.mp4", tmp_path / "b.mp4")
    assert (tmp_path / "a.mp4").read_text() == "mine"


def test_the_command_tells_what_it_wrote(recording, tmp_path):
    run = CliRunner().invoke
    asked = ["render", str(recording), "--frame", "3", "-o", str(tmp_path / "a.jpg"), "--panels", "rgb, d_m"]
    done = run(cli, [*asked, "--json"])
    assert done.exit_code == 0
    told = json.loads(done.stdout)
    assert (told["panels"], told["first"], told["fps"]) == (["rgb", "d_m"], 3, None)
    height, width = cv2.imread(str(tmp_path / "a.jpg")).shape[:2]
    assert (told["width"], told["height"]) == (width, height)
    assert "frame 3, 1280 x" in run(cli, [*asked, "--force"]).stdout
    for wrong in (["--frame", "3"], ["-o", "a.png"], [], ["--video", "a.mp4", "--frame", "1"]):
        assert run(cli, ["render", str(recording), *wrong]).exit_code == 2


@dataclass
class Listed:
    """A recording of entries in the order of a list."""

    listed: list
    path: Path = Path("a.rrd")
    read: int = 0

    def entries(self, entities, frames=None):
        for entry in self.listed:
            if entry.entity in entities and (frames is None or entry.index in frames):
                self.read += 1
                yield entry


def numbers(entity, indices):
    return [Entry(entity, Scalar(float(i)), i * 10, i) for i in indices]


def values(found):
    return [(i, {entity: value.value for entity, value in v.items()}) for i, v in found]


def test_rows_that_were_written_late_are_found_and_missing_ones_do_not_fill_the_memory():
    late = [3, 0, 1, 5, 2, 4, *range(6, 300)]
    listed = Listed([*numbers("a", late), *numbers("b", [k for k in range(300) if k % 7])])
    found = values(by_frame(listed, ["a", "b"], range(300)))
    assert found == [(i, {"a": float(i)} | ({"b": float(i)} if i % 7 else {})) for i in range(300)]
    sparse = Listed(numbers("a", range(5, 10_000)))
    stream = by_frame(sparse, ["a"], range(10_000))
    assert [next(stream)[1] for _ in range(5)] == [{}] * 5
    assert sparse.read <= AHEAD + 5


def test_frames_of_an_mcap_are_read_as_they_stand_in_the_file():
    rows = [e for i in range(500) for e in (*numbers("a", [i]), *numbers("b", [i]))]
    listed = Listed(rows, Path("a.mcap"))
    stream = by_frame(listed, ["a", "b"], range(2, 500, 3))
    assert values([next(stream)]) == [(2, {"a": 2.0, "b": 2.0})]
    assert listed.read == 3  # of the frames that are asked for
    assert values(stream)[-1] == (497, {"a": 497.0, "b": 497.0})


def test_figures_of_pairs_say_which_camera_motion_is_not_to_be_trusted():
    line = Entry("log", LogLine(f"{EGO_UNRELIABLE}: 3 matches", "WARN"), 20, 2)
    stats = [*numbers("stats/inlier_share", [1, 2]), *numbers("stats/median_d_m", [2])]
    found = pairs(Listed([*stats, line]))
    assert [(i, p.stamp_ns, p.ego_reliable, p.median_d_m) for i, p in found.items()][1] == (2, 20, False, 2.0)
    assert found[1].ego_reliable and np.isnan(found[1].median_d_m)
