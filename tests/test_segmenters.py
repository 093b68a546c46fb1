"""Segmenters: instances of a frame from depth alone, from a network's outputs, from mask files."""

import importlib.util
import os
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

import render_room
from vlmm_log.models.geometric import FLAT_NAME, Geometric, concavity
from vlmm_log.models.masks import Masks, numbered
from vlmm_log.models.segmenters import load_segmenter
from vlmm_log.models.yolo import HIDDEN, Yolo, class_names, decoded, letterboxed, segments
from vlmm_log.readers import open_log
from vlmm_log.settings import ObjectSettings, ReadSettings
from vlmm_log.types import Frame, InputError

SHARED = Path(__file__).resolve().parents[2] / "shared"
DATA = Path(os.environ.get("VLMM_LOG_DATA", SHARED / "data"))
SLICE, FRUIT = DATA / "rgbd_dataset_freiburg1_rpy_225_345", DATA / "fruit_on_table"
WEIGHTS = Path(os.environ.get("VLMM_LOG_WEIGHTS", SHARED / "weights")) / "yolov8n-seg.onnx"
needs_data = pytest.mark.skipif(not DATA.is_dir(), reason=f"no recordings at {DATA}; VLMM_LOG_DATA can name the folder")
needs_onnx = pytest.mark.skipif(
    importlib.util.find_spec("onnxruntime") is None,
    reason="onnxruntime is not installed: pip install 'vlmm-log[yolo]'",
)
NOMINAL = "525,525,319.5,239.5"


def frame_of(depth, index=0, stamp_ns=0):
    depth = np.asarray(depth, np.float32)
    return Frame(stamp_ns, index, np.zeros((*depth.shape, 3), np.uint8), depth, render_room.K)


def frames(folder, first, count, intrinsics=""):
    found = []
    for f in open_log(folder, ReadSettings(intrinsics=intrinsics)).frames(0, 10**18):
        if isinstance(f, Frame) and f.index >= first:
            found.append(f)
        if len(found) == count:
            return found
    raise AssertionError(f"{folder}: fewer than {count} frames from {first} on")


def overlaps(a, b):
    """IoU (n, m) of the labels 1 to n of one image with those of another."""
    n, m = int(a.max()) + 1, int(b.max()) + 1
    both = np.bincount((a.astype(np.int64) * m + b).ravel(), minlength=n * m).reshape(n, m).astype(float)
    return (both / np.maximum(both.sum(1)[:, None] + both.sum(0)[None] - both, 1))[1:, 1:]


def is_sound(s, frame):
    """What every segmenter owes: labels 1 to n, each with a pixel, and columns of n rows."""
    assert s.labels.shape == frame.depth.shape
    assert s.labels.dtype == np.int32
    assert set(np.unique(s.labels)) - {0} == set(range(1, len(s) + 1))
    assert s.scores.shape == s.identities.shape == (len(s),)
    known = s.identities[s.identities >= 0]
    assert np.unique(known).size == known.size


# ---- geometric


@given(st.floats(-2e-3, 2e-3), st.floats(-2e-3, 2e-3), st.floats(0.5, 2.0))
def test_a_plane_is_nowhere_concave(a, b, c):
    v, u = np.mgrid[:60, :80].astype(np.float32)
    inverse = (a * (u - 40) + b * (v - 30) + c).astype(np.float32)
    assert np.abs(concavity(inverse)[8:-8, 8:-8]).max() < 1e-5


@pytest.mark.parametrize(("slope", "pieces"), [(-0.004, 1), (0.004, 2), (0.0, 1)])
@pytest.mark.parametrize("turned", [False, True])
def test_surfaces_part_where_they_meet_in_a_valley_and_not_on_a_ridge(slope, pieces, turned):
    _, u = np.mgrid[:240, :320]
    inverse = 0.7 + slope * np.abs(u - 160.0) * (1 if slope > 0 else 0.5)
    depth = (1 / inverse).repeat(2, 0).repeat(2, 1)
    s = Geometric()(frame_of(depth.T if turned else depth))
    assert len(s) == pieces
    assert s.names == ((FLAT_NAME,) * pieces if slope >= 0 else ("",))


@pytest.mark.parametrize("far_from_wall", [0.3, 1.0])
def test_round_things_that_touch_are_one_and_not_the_wall_behind(far_from_wall):
    """Two balls of .2 m whose outlines overlap, at 1.2 m, as head and shoulders do."""
    v, u = np.mgrid[:480, :640]
    wall = np.full((480, 640), 1.2 + far_from_wall)
    heights = [0.04 - ((u - cu) ** 2 + (v - 240) ** 2) * (1.2 / 525) ** 2 for cu in (260, 380)]
    balls = [np.where(h > 0, 1.2 - np.sqrt(np.maximum(h, 0)), np.inf) for h in heights]
    s = Geometric()(frame_of(np.minimum(wall, np.minimum(*balls))))
    assert len(s) == 2
    assert s.labels[240, 260] == s.labels[240, 380] != s.labels[60, 60]


@pytest.mark.parametrize("distance", [0.7, 1.0, 2.0, 4.0])
def test_a_noisy_wall_is_one_flat_surface_near_and_far(distance):
    slanted = distance / (1 - 0.3 * (np.mgrid[:480, :640][1] - 320) / 525)
    s = Geometric()(frame_of(render_room.noisy_depth(slanted, np.random.default_rng(2))))
    assert s.names == (FLAT_NAME,)
    assert (s.labels == 1).mean() > 0.95


@pytest.mark.parametrize("time_s", [0.0, 0.4, 1.1])
def test_things_in_the_rendered_room_are_segments_of_their_own(time_s):
    view = render_room.render(render_room.pose(time_s), time_s)
    depth = render_room.noisy_depth(view.depth, np.random.default_rng(1))
    frame = frame_of(np.where(depth > 0, depth, np.nan))
    s = Geometric()(frame)
    is_sound(s, frame)
    found = overlaps(view.labels.astype(np.int32), s.labels)
    assert found[[0, 2]].max(axis=1).min() > 0.85, "ball and sliding box"
    assert len(s) <= 8
    assert not s.labels[np.isnan(frame.depth)].any()


@settings(max_examples=25)
@given(st.integers(32, 800), st.integers(32, 800), st.integers(0, 2**32 - 1))
@example(74, 32, 16777216)  # a piece of one column
def test_any_depth_image_gives_sound_segments_and_the_same_ones_again(H, W, seed):
    rng = np.random.default_rng(seed)
    coarse = rng.uniform(0.3, 8, (4, 5)).astype(np.float32)
    depth = cv2.resize(coarse, (W, H), interpolation=rng.choice([cv2.INTER_NEAREST, cv2.INTER_LINEAR]))
    depth[rng.random((H, W)) < rng.choice([0, 0.2, 0.7])] = np.nan
    frame = frame_of(depth)
    s = Geometric()(frame)
    is_sound(s, frame)
    np.testing.assert_array_equal(s.labels, Geometric()(frame).labels)


def test_without_depth_there_is_no_segment_and_a_note_says_so():
    s = Geometric()(frame_of(np.full((48, 64), np.nan)))
    assert len(s) == 0
    assert s.notes == ("geometric: no surface in the depth image",)


@needs_data
@pytest.mark.parametrize(
    ("scene", "points"),  # groups of pixels (u, v), seen by eye to lie on one surface, and on different ones
    [
        ("opening_door", {"leaf": [(116, 376), (150, 200)], "wall": [(306, 60), (560, 60)], "person": [(240, 372)]}),
        ("robot", {"base": [(418, 350), (390, 440)], "pole": [(390, 120)], "floor": [(100, 380), (300, 420)]}),
        ("two_people_walking", {"left": [(100, 200)], "right": [(350, 238)], "board": [(440, 60), (560, 300)]}),
        ("two_people_moving", {"stands": [(220, 242), (220, 400)], "sits": [(518, 322)], "wall": [(376, 156)]}),
        ("person_standing", {"person": [(342, 274), (342, 120)], "wall": [(174, 160), (50, 300)]}),
    ],
)
def test_movers_are_segments_of_their_own_in_real_scenes(scene, points):
    frame = frames(DATA / "moving_pairs" / scene, 0, 1, NOMINAL)[0]
    labels = Geometric()(frame).labels
    groups = {name: {int(labels[v, u]) for u, v in pixels} for name, pixels in points.items()}
    assert all(len(g) == 1 and 0 not in g for g in groups.values()), groups
    assert len(set.union(*groups.values())) == len(groups), groups


@needs_data
def test_rolling_fruit_on_a_real_table():
    """Blobs that stand 2 % nearer than the empty table did: most are one segment. The still scene stays as it is."""
    seen = frames(FRUIT, 0, 35)
    still = [Geometric()(f).labels for f in seen[6:17]]
    kept = [overlaps(a, b).max(axis=1) @ np.bincount(a.ravel())[1:] / (a > 0).sum() for a, b in pairwise(still)]
    assert np.mean(kept) > 0.85
    table = np.median(np.nan_to_num([f.depth for f in seen[:17]], nan=9.0), axis=0)
    good = blobs = 0
    for frame in seen[31:35]:
        nearer = (table - frame.depth > 0.02 * table) & (table < 1.6)
        opened = cv2.morphologyEx(nearer.astype(np.uint8), cv2.MORPH_OPEN, np.ones((5, 5), np.uint8))
        _, fruit, figures, _ = cv2.connectedComponentsWithStats(opened)
        best = overlaps(fruit, Geometric()(frame).labels).max(axis=1)
        best = best[(figures[1:, cv2.CC_STAT_AREA] >= 500) & (figures[1:, cv2.CC_STAT_AREA] < 2000)]
        good, blobs = good + int((best > 0.5).sum()), blobs + best.size
    assert blobs >= 15
    assert good >= 0.8 * blobs


@needs_data
def test_a_real_room_has_neither_few_nor_many_segments():
    counts = [len(Geometric()(f)) for f in frames(SLICE, 0, 100)[::11]]
    assert min(counts) >= 5
    assert max(counts) <= 40


def test_a_larger_image_is_thinned_to_the_same_segments():
    view = render_room.render(render_room.pose(0.4), 0.4)
    small = Geometric()(frame_of(view.depth)).labels
    large = Geometric()(frame_of(view.depth.repeat(2, 0).repeat(2, 1))).labels
    np.testing.assert_array_equal(large[::4, ::4], small[::2, ::2])


# ---- yolo: what its outputs mean

S = ObjectSettings(yolo_score=0.25, yolo_iou=0.5)
NAMES = ("cat", "dog", "cup")
P = 4


def scene(rng, H, W, shape=(320, 416), things=3):
    """Upright ellipses apart from each other: the truth (H, W), and outputs of both layouts that say so."""
    image, box = letterboxed(np.zeros((H, W, 3), np.uint8), shape)
    h, w = image.shape[:2]
    v, u = np.mgrid[:H, :W] + 0.5
    y, x = np.mgrid[: h // 4, : w // 4] * 4 + 2.0  # centres of the prototypes' cells, px of the input
    truth = np.zeros((H, W), np.int32)
    prototypes, boxes = np.zeros((P, h // 4, w // 4), np.float32), []
    for k in range(things):
        centre = np.array([(k + 0.5) / things * W, rng.uniform(0.35, 0.65) * H])
        radii = np.array([rng.uniform(0.3, 0.45) * W / things, rng.uniform(0.2, 0.34) * H])
        inside = np.hypot((u - centre[0]) / radii[0], (v - centre[1]) / radii[1]) < 1
        truth[inside] = k + 1
        c, r = centre * box.scale + box.offset, radii * box.scale
        prototypes[k] = 10 * (1 - np.hypot((x - c[0]) / r[0], (y - c[1]) / r[1]))
        boxes.append([*(c - r), *(c + r)])
    prototypes[3] = 5  # a mask that fills its box
    return truth, np.array(boxes, np.float32), prototypes, box


def dense(boxes, classes, scores, coefficients, n=200):
    rows = np.zeros((n, 4 + len(NAMES) + P), np.float32)
    for i, (b, c, s, k) in enumerate(zip(boxes, classes, scores, coefficients, strict=True)):
        rows[7 * i] = [*(b[:2] + b[2:]) / 2, *(b[2:] - b[:2]), *np.eye(3)[c] * s, *k]
        rows[7 * i + 3] = [*(b[:2] + b[2:]) / 2 + 1, *(b[2:] - b[:2]), *np.eye(3)[c] * (s - 0.1), *k]  # suppressed
    return rows.T[None]


def end_to_end(boxes, classes, scores, coefficients, n=50):
    rows = np.zeros((n, 6 + P), np.float32)
    for i, (b, c, s, k) in enumerate(zip(boxes, classes, scores, coefficients, strict=True)):
        rows[i] = [*b, s, c, *k]
    return rows[None]


@pytest.mark.parametrize("layout", [dense, end_to_end])
@settings(max_examples=25)
@given(
    st.integers(120, 900),
    st.integers(120, 900),
    st.sampled_from([(320, 416), (640, 640), (256, 512), ("h", "w")]),
    st.integers(0, 2**32 - 1),
)
def test_known_masks_come_back_through_the_letterbox(layout, H, W, shape, seed):
    truth, boxes, prototypes, box = scene(np.random.default_rng(seed), H, W, shape)
    scores = [0.5, 0.9, 0.7]
    rows = layout(boxes, [2, 0, 1], scores, np.eye(P)[:3])
    found, read = decoded([prototypes[None], rows], 3, S)
    s = segments(found, read, box, NAMES, (H, W))
    assert s.names == ("cat", "dog", "cup")
    np.testing.assert_allclose(s.scores, [0.9, 0.7, 0.5], atol=1e-6)
    assert not s.notes
    best = overlaps(truth, s.labels)
    for thing, row in ((2, 0), (3, 1), (1, 2)):
        radii = np.diff(boxes[thing - 1].reshape(2, 2), axis=0) / 2 / box.scale
        allowed = 2 * (1 + 1 / min(box.scale)) / radii.min()  # a rim of one pixel of the image, one of the input
        assert best[thing - 1, row] > 1 - allowed


def test_letterbox_keeps_the_aspect_and_pads_evenly():
    rgb = np.full((480, 640, 3), 200, np.uint8)
    for shape, offset, scale in (((640, 640), (0, 80), 1.0), ((480, 640), (0, 0), 1.0), ((240, 640), (160, 0), 0.5)):
        image, box = letterboxed(rgb, shape)
        assert image.shape == (*shape, 3)
        assert (box.offset, box.scale, box.size) == (offset, (scale, scale), shape[::-1])
        assert (image == 200).all(2).sum() == 480 * 640 * scale**2
        assert (image[0, 0] == (200 if offset == (0, 0) else 114)).all()
    assert letterboxed(rgb.swapaxes(0, 1), ("h", "w"))[0].shape == (640, 480, 3)
    assert letterboxed(np.zeros((100, 900, 3), np.uint8), (None, None))[0].shape == (96, 640, 3)


@pytest.mark.parametrize("layout", [dense, end_to_end])
def test_the_better_score_has_the_pixel_and_what_is_hidden_is_told(layout):
    _, boxes, prototypes, box = scene(np.random.default_rng(0), 320, 416)
    half = boxes[0].copy()
    half[2] = (half[0] + half[2]) / 2
    rows = layout([boxes[0], boxes[0], half], [1, 0, 2], [0.9, 0.8, 0.95], [np.eye(P)[3]] * 3)
    found, read = decoded([rows, prototypes[None]], 3, S)
    assert found.classes.tolist() == [2, 1, 0], "boxes of other classes do not suppress"
    s = segments(found, read, box, NAMES, (320, 416))
    assert s.names == ("cup", "dog")
    assert s.notes == (HIDDEN,)
    left, right = ((s.labels == k).sum() for k in (1, 2))
    assert abs(int(left) - int(right)) < 0.1 * left


@pytest.mark.parametrize("layout", [dense, end_to_end])
def test_what_scores_less_or_lies_outside_is_no_instance(layout):
    _, boxes, prototypes, box = scene(np.random.default_rng(0), 320, 416)
    rows = layout([boxes[0], boxes[1] + 1000], [1, 0], [0.2, 0.8], np.eye(P)[:2])
    found, read = decoded([rows, prototypes[None]], 3, S)
    assert found.scores.size == 1
    s = segments(found, read, box, NAMES, (320, 416))
    assert len(s) == 0
    assert s.notes == (HIDDEN,)


@pytest.mark.parametrize(
    ("shapes", "told"),
    [
        ([(1, 11, 200)], "outputs are 1x11x200"),
        ([(1, 4, 8, 8)], "outputs are"),
        ([(1, 11, 200), (1, 4, 8, 8), (1, 2)], "outputs are"),
        ([(1, 12, 200), (1, 4, 8, 8)], "do not fit 3 class names"),
        ([(2, 11, 200), (2, 4, 8, 8)], "outputs are"),
    ],
)
def test_outputs_of_other_networks_are_told(shapes, told):
    with pytest.raises(ValueError, match=told):
        decoded([np.zeros(s, np.float32) for s in shapes], 3, S)


def test_class_names_are_read_and_never_guessed(tmp_path):
    path = Path("n.onnx")
    assert class_names("{1: 'dog', 0: 'cat'}", path, S) == ("cat", "dog")
    assert class_names("['cat', 'dog']", path, S) == ("cat", "dog")
    for text in ("", "{1: 'dog'}", "__import__('os').getcwd()", "cat, dog", "3", "(" * 5000):
        with pytest.raises(InputError, match=r"n.onnx: no class names .* objects.yolo_names"):
            class_names(text, path, S)
    (tmp_path / "names.txt").write_text("mug\n\n door leaf \n")
    assert class_names("{0: 'x'}", path, ObjectSettings(yolo_names=str(tmp_path / "names.txt"))) == ("mug", "door leaf")
    with pytest.raises(InputError, match="cannot read the class names"):
        class_names("", path, ObjectSettings(yolo_names=str(tmp_path / "absent.txt")))


# ---- yolo: files. A network is a handful of protocol buffer fields: outputs that are constants.


def field(number, value):
    if isinstance(value, int):
        return varint(number << 3) + varint(value)
    value = value.encode() if isinstance(value, str) else value
    return varint(number << 3 | 2) + varint(len(value)) + value


def varint(n):
    return bytes([n & 127 | 128]) + varint(n >> 7) if n > 127 else bytes([n])


def value_info(name, shape):
    dims = b"".join(field(1, field(1, n) if isinstance(n, int) else field(2, n)) for n in shape)
    return field(1, name) + field(2, field(1, field(1, 1) + field(2, dims)))


def onnx_file(path, shape, outputs, metadata):
    graph = field(2, "constants") + field(11, value_info("images", shape))
    for k, value in enumerate(outputs):
        tensor = b"".join(field(1, n) for n in value.shape) + field(2, 1) + field(8, f"c{k}")
        graph += field(5, tensor + field(9, value.astype("<f4").tobytes()))
        graph += field(1, field(1, f"c{k}") + field(2, f"output{k}") + field(4, "Identity"))
        graph += field(12, value_info(f"output{k}", value.shape))
    entries = b"".join(field(14, field(1, k) + field(2, v)) for k, v in metadata.items())
    path.write_bytes(field(1, 8) + field(8, field(1, "") + field(2, 17)) + field(7, graph) + entries)
    return path


@needs_onnx
@pytest.mark.parametrize("layout", [dense, end_to_end])
def test_a_network_file_from_end_to_end(tmp_path, layout):
    truth, boxes, prototypes, _ = scene(np.random.default_rng(4), 240, 320, (320, 416))
    rows = layout(boxes, [2, 0, 1], [0.5, 0.9, 0.7], np.eye(P)[:3])
    path = onnx_file(tmp_path / "n.onnx", (1, 3, 320, 416), [rows, prototypes[None]], {"names": str(list(NAMES))})
    segmenter, versions = load_segmenter(ObjectSettings(segmenter=f"yolo:{path}"))
    assert versions["segmenter weights"].startswith("n.onnx sha256:")
    assert versions["onnxruntime"]
    frame = frame_of(np.ones((240, 320)))
    s = segmenter(frame)
    is_sound(s, frame)
    assert s.names == ("cat", "dog", "cup")
    assert overlaps(truth, s.labels).max(axis=1).min() > 0.9


@needs_onnx
@pytest.mark.parametrize(
    ("metadata", "shapes", "shape", "told"),
    [
        ({}, [(1, 11, 200), (1, 4, 8, 8)], (1, 3, 32, 32), "no class names"),
        ({"names": "['a']"}, [(1, 11, 200), (1, 4, 8, 8)], (1, 3, 32, 32), "do not fit 1 class names"),
        ({"names": "['a', 'b', 'c']"}, [(1, 7, 200)], (1, 3, 32, 32), "no YOLO segmenter (its outputs are 1x7x200)"),
        ({"names": "['a', 'b', 'c']"}, [(1, 1000)], (1, 784), "no YOLO segmenter (its input"),
    ],
)
def test_a_network_that_is_no_segmenter_is_told_in_one_line(tmp_path, metadata, shapes, shape, told):
    path = onnx_file(tmp_path / "n.onnx", shape, [np.zeros(s) for s in shapes], metadata)
    with pytest.raises(InputError) as e:
        Yolo(path, S)
    assert str(e.value).startswith(str(path))
    assert told in str(e.value)
    assert "\n" not in str(e.value)


@needs_onnx
@pytest.mark.parametrize("content", [b"", b"not a network\n" * 9, bytes(range(256)), None])
def test_a_file_that_is_no_network_is_told(tmp_path, content, capfd):
    path = onnx_file(tmp_path / "n.onnx", (1, 3, 32, 32), [np.zeros((1, 11, 200))], {})
    path.write_bytes(path.read_bytes()[:3000] if content is None else content)
    with pytest.raises(InputError, match="not an ONNX network"):
        load_segmenter(ObjectSettings(segmenter=f"yolo:{path}"))
    assert capfd.readouterr() == ("", "")


def test_without_onnxruntime_the_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "onnxruntime", None)
    (tmp_path / "n.onnx").write_bytes(b"")
    with pytest.raises(InputError, match=r"pip install 'vlmm-log\[yolo\]'"):
        load_segmenter(ObjectSettings(segmenter=f"yolo:{tmp_path / 'n.onnx'}"))


@needs_onnx
@needs_data
@pytest.mark.skipif(not WEIGHTS.is_file(), reason=f"no weights at {WEIGHTS}; VLMM_LOG_WEIGHTS can name the folder")
def test_trained_weights_find_the_seated_person_and_the_screens():
    yolo, _ = load_segmenter(ObjectSettings(segmenter=f"yolo:{WEIGHTS}"))
    seen = [f for k in (0, 10, 80, 95) for f in frames(SLICE, k, 6)[5:]]
    screens = 0
    for frame in seen:
        s = yolo(frame)
        is_sound(s, frame)
        np.testing.assert_array_equal(s.labels, yolo(frame).labels)
        screens += "tv" in s.names or "laptop" in s.names
        if frame.index == 85:  # the camera looks at the desk
            continue
        assert s.names.count("person") == 1
        person = s.labels == s.names.index("person") + 1
        depth = frame.depth[person & ~np.isnan(frame.depth)]
        assert 4000 < person.sum() < 20000
        assert 1.5 < np.median(depth) < 3
        assert (np.abs(depth - np.median(depth)) < 0.3).mean() > 0.8, "one body, not the wall behind"
    assert screens >= 3


# ---- masks


def mask_folder(folder, files, labels=None, table="labels.txt"):
    folder.mkdir()
    for name, image in files.items():
        if isinstance(image, bytes):
            (folder / name).write_bytes(image)
        else:
            assert cv2.imwrite(str(folder / name), image)
    if labels is not None:
        (folder / table).write_text(labels)
    return folder


@given(st.integers(0, 2**32 - 1), st.sampled_from([np.uint8, np.uint16]), st.integers(0, 300))
def test_identities_become_labels_in_ascending_order(seed, kind, many):
    rng = np.random.default_rng(seed)
    some = rng.choice(np.iinfo(kind).max + 1, min(many, 200) + 1, replace=False).astype(kind)
    image = rng.choice(some, (40, 50))
    labels, ids = numbered(image)
    assert ids.tolist() == sorted(set(image.ravel().tolist()) - {0})
    np.testing.assert_array_equal(np.concatenate([[0], ids])[labels], image)


MASK = np.zeros((48, 64), np.uint16)
MASK[4:20, 5:30], MASK[30:40, 40:60] = 65535, 7


@pytest.mark.parametrize(
    ("name", "index", "stamp_ns", "found"),
    [
        ("000012.png", 12, 0, True),
        ("12.png", 12, 0, True),
        ("000012.png", 11, 12, False),
        ("1305031237.029714.png", 3, 1305031237_029714000 + 19_000_000, True),
        ("1305031237.029714.png", 3, 1305031237_029714000 - 20_000_000, True),
        ("1305031237.029714.png", 3, 1305031237_029714000 + 21_000_000, False),
    ],
)
def test_masks_are_found_by_index_or_time(tmp_path, name, index, stamp_ns, found):
    folder = mask_folder(tmp_path / "m", {name: MASK}, "# mine\n7 door leaf\n65535 cup\n")
    frame = frame_of(np.ones((48, 64)), index, stamp_ns)
    s = Masks(folder)(frame)
    is_sound(s, frame)
    assert s.identities.tolist() == ([7, 65535] if found else [])
    assert s.names == (("door leaf", "cup") if found else ())
    assert s.notes == (() if found else ("masks: no file for this frame",))
    assert (s.labels == 1).sum() == (200 if found else 0)


def test_the_nearest_of_several_times_is_taken(tmp_path):
    files = {f"10.{k:02d}0000.png": np.full((48, 64), k + 1, np.uint8) for k in range(6)}
    masks = Masks(mask_folder(tmp_path / "m", files))
    for ns, identity in ((9_995_000_000, 1), (10_014_000_000, 2), (10_016_000_000, 3), (10_069_000_000, 6)):
        assert masks(frame_of(np.ones((48, 64)), 0, ns)).identities.tolist() == [identity]


@pytest.mark.parametrize(
    ("table", "text", "names"),
    [
        ("labels.txt", "id name\n7 door leaf\n65535   cup  \n", ("door leaf", "cup")),
        ("labels.csv", 'id,name\n7,"cup, red"\n65535, door\n0,none\n', ("cup, red", "door")),
        ("labels.txt", "7 cup\n7 cup\n", ("cup", "")),
        ("other.txt", "7 cup\n", ("", "")),
    ],
)
def test_label_tables(tmp_path, table, text, names):
    s = Masks(mask_folder(tmp_path / "m", {"0.png": MASK}, text, table))(frame_of(np.ones((48, 64))))
    assert s.names == names
    assert s.notes == (("masks: identity without a row in the label table",) if "" in names else ())


@pytest.mark.parametrize("broken", [b"", b"no image", b"\x89PNG\r\n\x1a\n1234"])
def test_a_mask_that_cannot_be_decoded_is_told_and_counted(tmp_path, broken):
    s = Masks(mask_folder(tmp_path / "m", {"0.png": broken}))(frame_of(np.ones((48, 64))))
    assert len(s) == 0
    assert s.notes == ("masks: file cannot be decoded",)


@pytest.mark.parametrize(
    ("image", "told"),
    [
        (MASK[:24, :32], "mask is 32x24, the log's images are 64x48; scale the masks"),
        (np.zeros((48, 64, 3), np.uint8), "a colour or palette image with 3 channels"),
        (np.zeros((48, 64, 4), np.uint8), "a colour or palette image with 4 channels"),
    ],
)
def test_a_mask_that_cannot_be_used_is_an_error(tmp_path, image, told):
    masks = Masks(mask_folder(tmp_path / "m", {"0.png": image}))
    with pytest.raises(InputError, match=told) as e:
        masks(frame_of(np.ones((48, 64))))
    assert str(tmp_path / "m" / "0.png") in str(e.value)


@pytest.mark.parametrize(
    ("files", "labels", "told"),
    [
        ({}, None, "no mask"),
        ({"a.txt": b""}, None, "no mask"),
        ({"first.png": MASK}, None, "neither an index nor a time"),
        ({"1.png": MASK, "2.5.png": MASK}, None, "an index among names that are none"),
        ({"1.png": MASK, "001.png": MASK}, None, "two masks of one index"),
        ({"nan.png": MASK}, None, "neither an index nor a time"),
        ({"1e30.png": MASK}, None, "too late a time"),
        ({"1.png": MASK}, "seven cup\n", "labels.txt:1: write an identity"),
        ({"1.png": MASK}, "7 cup\n\n70000 cup\n", "labels.txt:3: write an identity"),
        ({"1.png": MASK}, "7\n", "labels.txt:1: write an identity"),
        ({"1.png": MASK}, "7 cup\n7 mug\n", "labels.txt:2: identity 7 has another name"),
        ({"1.png": MASK, "labels.csv": b"1,a"}, "1 a", "both labels.csv and labels.txt"),
        ({"1.png": MASK, "labels.csv": b"\xff\xfe\x00"}, None, "cannot read the label table"),
    ],
)
def test_a_folder_that_cannot_be_used_is_an_error(tmp_path, files, labels, told):
    folder = mask_folder(tmp_path / "m", files, labels)
    with pytest.raises(InputError, match=told) as e:
        load_segmenter(ObjectSettings(segmenter=f"masks:{folder}"))
    assert str(folder) in str(e.value)


def test_the_fingerprint_of_masks_speaks_of_names_and_contents(tmp_path):
    def of(name, files, labels):
        (tmp_path / name).mkdir()
        return Masks(mask_folder(tmp_path / name / "m", files, labels)).fingerprint

    first = of("a", {"0.png": MASK}, "7 cup")
    assert first == of("b", {"0.png": MASK}, "7 cup")
    others = [
        of("c", {"1.png": MASK}, "7 cup"),
        of("d", {"0.png": MASK}, "7 mug"),
        of("e", {"0.png": MASK + 1}, "7 cup"),
    ]
    assert len({first, *others}) == 4


# ---- which


@pytest.mark.parametrize("name", ["", "sam", "yolo", "masks:", "geometric:x", "none:x", "Yolo:x.onnx"])
def test_a_name_that_is_none_is_told_with_what_there_is(name):
    with pytest.raises(InputError, match=r"there are geometric, yolo:FILE.onnx, masks:FOLDER, none"):
        load_segmenter(ObjectSettings(segmenter=name))


def test_files_that_are_absent_are_told(tmp_path):
    for kind in ("yolo", "masks"):
        with pytest.raises(InputError, match="no such"):
            load_segmenter(ObjectSettings(segmenter=f"{kind}:{tmp_path / 'absent'}"))


def test_none_and_the_default():
    frame = frame_of(np.ones((48, 64)))
    s = load_segmenter(ObjectSettings(segmenter="none"))[0](frame)
    is_sound(s, frame)
    assert len(s) == 0
    assert isinstance(load_segmenter(ObjectSettings())[0], Geometric)
