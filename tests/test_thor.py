"""AI2-THOR: what the recorder writes of a world known in Unity's axes, and what the reader and the truth make of it."""

from dataclasses import dataclass, field

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import record_ai2thor
from vlmm_log import se3
from vlmm_log.models.masks import Masks
from vlmm_log.readers.plain import Plain
from vlmm_log.readers.thor import Thor
from vlmm_log.readers.thor_truth import FILE, motion, movers, read_truth
from vlmm_log.settings import ReadSettings
from vlmm_log.types import InputError

EVER = 2**62
WIDTH, HEIGHT, FOV = 80, 60, 70.0  # px, px, degrees from top to bottom
NEAR, FAR = 0.1, 20.0
ROOM = np.array([[-3.0, 0.0, -2.0], [2.5, 2.6, 4.0]])  # in Unity: x right, y up, z ahead, m
BOX, BALL = "Box|+00.50|+00.40|+01.80", "Basket Ball|-01.00|+00.30|+02.00"
COLOURS = {"Floor|0": [10, 20, 30], BOX: [200, 10, 40], BALL: [7, 90, 250]}
SIZE = np.array([0.8, 0.8, 0.6])  # of the box, m
CAMERAS = [(0.3, 1.6, -1.0, 0, 20), (-0.4, 1.5, -0.8, 12, 25), (2.0, 1.4, 1.5, 290, 15), (0.0, 1.2, 3.4, 175, -5)]


def unity(yaw, pitch):
    """Rotation of Unity's camera: its right, up and ahead as columns. Yaw turns ahead to the right, pitch down."""
    y, p = np.radians([yaw, pitch])
    right = [np.cos(y), 0, -np.sin(y)]
    ahead = [np.sin(y) * np.cos(p), -np.sin(p), np.cos(y) * np.cos(p)]
    up = [np.sin(y) * np.sin(p), np.cos(p), np.cos(y) * np.sin(p)]
    return np.array([right, up, ahead]).T


def view(x, y, z, yaw, pitch, box):
    """z (H, W) m, points (H, W, 3) in Unity's world and which colour of COLOURS, from a camera in the room."""
    f = HEIGHT / 2 / np.tan(np.radians(FOV) / 2)
    v, u = np.mgrid[0:HEIGHT, 0:WIDTH]
    rays = (
        np.stack([(u - (WIDTH - 1) / 2) / f, -(v - (HEIGHT - 1) / 2) / f, np.ones(u.shape)], -1) @ unity(yaw, pitch).T
    )
    eye = np.array([x, y, z])
    with np.errstate(divide="ignore"):
        depth = np.maximum((ROOM[0] - eye) / rays, (ROOM[1] - eye) / rays).min(-1)
        a, b = ((corner - eye) / rays for corner in (box - SIZE / 2, box + SIZE / 2))
    enter, leave = np.minimum(a, b).max(-1), np.maximum(a, b).min(-1)
    hit = (enter < leave) & (enter > 0)
    depth = np.where(hit, enter, depth)
    points = eye + rays * depth[..., None]
    name = np.where(hit, BOX, np.where(points[..., 1] < 1e-6, "Floor|0", ""))
    return depth, points, name


def painted(points):
    """Colour (..., 3) of points in Unity's world: smooth, and another one everywhere."""
    return np.clip(40 * (points - ROOM[0]) + 10, 0, 255).astype(np.uint8)


def metadata(x, y, z, yaw, pitch, box, turned=0.0, openness=0.0):
    still = {"moveable": False, "pickupable": False, "openable": False, "visible": True}

    def thing(name, kind, position, yaw, **flags):
        place = {"position": dict(zip("xyz", map(float, position), strict=True))}
        turn = {"rotation": {"x": 0.0, "y": float(yaw), "z": 0.0}}
        return {"objectId": name, "objectType": kind, **place, **turn, **still, **flags}

    return {
        "screenWidth": WIDTH,
        "screenHeight": HEIGHT,
        "fov": FOV,
        "depthFormat": "Meters",
        "cameraPosition": {"x": x, "y": y, "z": z},
        "agent": {
            "position": {"x": x, "y": 0.9, "z": z},
            "rotation": {"x": 0.0, "y": float(yaw % 360), "z": 0.0},
            "cameraHorizon": float(pitch),
        },
        "objects": [
            thing(BOX, "Box", box, 0, moveable=True, openable=True, openness=openness),
            thing(BALL, "BasketBall", (-1, 0.3, 2), turned, pickupable=True),
        ],
        "colors": [{"name": name, "color": colour} for name, colour in COLOURS.items()],
    }


@dataclass
class Shot:
    """What the recorder takes of an ai2thor.server.Event."""

    metadata: dict
    frame: np.ndarray
    depth_frame: np.ndarray
    instance_segmentation_frame: np.ndarray
    instance_masks: dict = field(default_factory=dict)


def images(camera, box):
    """Colour, depth as the simulator's shader gives it, and the instances' colours."""
    z, points, name = view(*camera, box)
    ids = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    for known, colour in COLOURS.items():
        ids[name == known] = colour
    return painted(points), (z * (FAR - NEAR) / FAR).astype(np.float32), ids


def shot(camera, box=(0.5, 0.4, 1.8), **state):
    box = np.array(box)
    rgb, depth, ids = images(camera, box)
    masks = {name: (ids == colour).all(-1) for name, colour in COLOURS.items()}
    return Shot(metadata(*camera, box, **state), rgb, depth, ids, {n: m for n, m in masks.items() if m.any()})


def real(camera, box=(0.5, 0.4, 1.8), **state):
    """The same as an event of the simulator's own package, from the bytes that the simulator sends."""
    server = pytest.importorskip("ai2thor.server", reason="the package ai2thor is not installed")
    box = np.array(box)
    rgb, depth, ids = (np.ascontiguousarray(image[::-1]) for image in images(camera, box))  # it sends rows from below
    event = server.Event(metadata(*camera, box, **state))
    event.add_image(rgb.tobytes())
    planes = {"camera_near_plane": NEAR, "camera_far_plane": FAR}
    event.add_image_depth(depth.tobytes(), depth_format=server.DepthFormat.Meters, **planes)
    alpha = np.full((HEIGHT, WIDTH, 1), 255, np.uint8)
    event.add_image_ids(np.concatenate([ids, alpha], -1).tobytes())
    return event


def recorded(folder, events):
    record_ai2thor.record(events, folder)
    log = Thor().open(folder, ReadSettings())
    return log, list(log.frames(0, EVER))


def in_unity(frame):
    """Points (H, W, 3) of a frame in Unity's world: its axes 1 and 2 change places."""
    v, u = np.mgrid[0 : frame.depth.shape[0], 0 : frame.depth.shape[1]]
    rays = np.stack([u, v, np.ones(u.shape)], -1) @ np.linalg.inv(frame.K).T
    T = frame.T_world_cam
    return ((rays * frame.depth[..., None]) @ T[:3, :3].T + T[:3, 3])[..., [0, 2, 1]]


@pytest.mark.parametrize("event", [shot, real])
def test_what_cameras_see_lies_where_it_is(tmp_path, event):
    log, frames = recorded(tmp_path, [event(c) for c in CAMERAS])
    assert (len(frames), log.has_poses, log.world_up, log.camera.fx) == (4, True, "+z", log.camera.fy)
    for camera, frame in zip(CAMERAS, frames, strict=True):
        z, true, _ = view(*camera, np.array([0.5, 0.4, 1.8]))
        points = in_unity(frame)
        assert np.linalg.norm(points - true, axis=-1).max() < 3e-4  # m; 0.1 mm of depth, at the corner of a wide view
        assert np.abs(frame.depth - z).max() < 1.1e-4
        np.testing.assert_array_equal(frame.rgb, painted(true))
        assert np.linalg.det(frame.T_world_cam[:3, :3]) == pytest.approx(1)


def test_two_views_of_one_surface_agree(tmp_path):
    _, (a, b, *_) = recorded(tmp_path, [shot(c) for c in CAMERAS])
    v, u = np.mgrid[0:HEIGHT, 0:WIDTH]
    rays = np.stack([u, v, np.ones(u.shape)], -1) @ np.linalg.inv(a.K).T * a.depth[..., None]
    T = np.linalg.inv(b.T_world_cam) @ a.T_world_cam
    seen = rays @ T[:3, :3].T + T[:3, 3]
    px = seen @ b.K.T
    at = np.round(px[..., :2] / px[..., 2:]).astype(int)
    inside = ((at >= 0) & (at < [WIDTH, HEIGHT])).all(-1)
    there = in_unity(b)[at[inside][:, 1], at[inside][:, 0]]
    floor = (in_unity(a)[inside][:, 1] < 1e-3) & (there[:, 1] < 1e-3)
    assert floor.sum() > 300
    assert np.abs(in_unity(a)[inside][floor] - there[floor])[:, 1].max() < 1e-3
    apart = np.linalg.norm(in_unity(a)[inside][floor] - there[floor], axis=1)
    assert np.median(apart) < 0.03  # a pixel's width on the floor


@given(st.floats(0, 360), st.floats(-60, 60))
def test_a_pose_is_a_rotation_that_looks_where_unity_does(yaw, pitch):
    position, quaternion = record_ai2thor.camera_pose(metadata(1.0, 2.0, 3.0, yaw, pitch, np.zeros(3)))
    T = se3.from_quaternion(position, quaternion)
    right, up, ahead = unity(yaw, pitch).T[:, [0, 2, 1]]  # in our axes
    np.testing.assert_allclose(T[:3], np.stack([right, -up, ahead, [1, 3, 2]], 1), atol=1e-9)
    assert np.linalg.det(T) == pytest.approx(1)


@pytest.mark.parametrize("event", [shot, real])
def test_masks_keep_identities_and_names(tmp_path, event):
    log, frames = recorded(tmp_path, [event(c) for c in CAMERAS[:2]])
    segment = Masks(tmp_path / "masks")
    box = next(x.identity for x in read_truth(tmp_path) if x.type == "Box")
    for camera, frame in zip(CAMERAS[:2], frames, strict=True):
        found = segment(frame)
        assert set(found.names) == {"box", "floor"}
        assert not found.notes
        name = view(*camera, np.array([0.5, 0.4, 1.8]))[2]
        k = found.identities.tolist().index(box)
        np.testing.assert_array_equal(found.labels == k + 1, name == BOX)
    assert "truth of 2 objects in 2 frames: truth/objects.jsonl" in log.notes
    assert any("--segmenter masks:" in note for note in log.notes)


def test_motion_is_that_of_the_world(tmp_path):
    states = [
        ((0.5, 0.4, 1.8), {}),
        ((0.5, 0.4, 1.8), {"turned": 30.0}),
        ((0.9, 0.4, 1.5), {"turned": 30.0, "openness": 0.5}),
    ]
    recorded(tmp_path, [shot(c, box, **more) for c, (box, more) in zip(CAMERAS, states, strict=False)])
    truth = read_truth(tmp_path)
    box, ball = truth[:2]
    assert (box.id, box.moveable, box.pickupable, box.openable, box.movable) == (BOX, True, False, True, True)
    assert (ball.type, ball.moveable, ball.movable, ball.visible) == ("BasketBall", False, True, True)
    np.testing.assert_allclose(box.T_world_object[:3, 3], [0.5, 1.8, 0.4])
    by = {m.identity: m for m in motion(truth, 0, 2)}
    np.testing.assert_allclose(by[box.identity].displacement, [0.4, -0.3, 0.0], atol=1e-9)
    assert by[box.identity].opened == 0.5
    assert by[ball.identity].turn_rad == pytest.approx(np.radians(30))
    np.testing.assert_allclose(by[ball.identity].displacement, 0)
    pairs = ((0, 1), (1, 2), (0, 2), (2, 2), (0, 7))
    moved = [{ball.identity}, {box.identity}, {box.identity, ball.identity}, set(), set()]
    assert [set(movers(truth, *pair)) for pair in pairs] == moved


def test_an_object_turns_about_the_upright_of_our_world(tmp_path):
    recorded(tmp_path, [shot(CAMERAS[0]), shot(CAMERAS[0], turned=90.0)])
    before, after = (x.T_world_object for x in read_truth(tmp_path) if x.id == BALL)
    # in Unity, from above, its ahead turns from z to x: ours from y to x
    np.testing.assert_allclose(after[:3, :3] @ before[:3, :3].T @ [0, 1, 0], [1, 0, 0], atol=1e-9)


def test_what_is_too_far_is_unseen():
    depth = np.array([[1.0, 13.0, 13.2, 19.9, 0.0]], np.float32) * np.float32(0.995)
    assert record_ai2thor.stored_depth(depth, (0.1, 20.0)).tolist() == [[5000, 65000, 0, 0, 0]]
    assert record_ai2thor.stored_depth(np.array([[2.0]]), (0.0, 20.0)).tolist() == [[10000]]


def test_events_that_cannot_be_recorded(tmp_path):
    event = shot(CAMERAS[0])
    with pytest.raises(ValueError, match="renderDepthImage=True"):
        record_ai2thor.record([Shot(event.metadata, event.frame, None, None)], tmp_path)
    wider = shot(CAMERAS[0])
    wider.metadata["fov"] = 90.0
    with pytest.raises(ValueError, match="frame 1: the camera's size or field of view has changed"):
        record_ai2thor.record([event, wider], tmp_path)


def test_who_reads_it(tmp_path):
    recorded(tmp_path, [shot(c) for c in CAMERAS])
    assert Thor().recognises(tmp_path)
    (tmp_path / FILE).unlink()
    assert not Thor().recognises(tmp_path)
    plain = list(Plain().open(tmp_path, ReadSettings()).frames(0, EVER))
    assert [f.T_world_cam is None for f in plain] == [False] * 4


GOOD = '"frame": 0, "identity": 1, "id": "a", "type": "A", "openness": 0, "moveable": 0, "pickupable": 0, "openable": 0'


@pytest.mark.parametrize(
    "line",
    [
        "{",
        "[]",
        "{" + GOOD + "}",
        "{" + GOOD + ', "visible": 1, "position": [0, 0, 0], "rotation": [0, 0, 0, 2]}',
        "{" + GOOD + ', "visible": 1, "position": [0, 0], "rotation": [0, 0, 0, 1]}',
    ],
)
def test_truth_that_cannot_be_read(tmp_path, line):
    good = "{" + GOOD + ', "visible": 1, "position": [0, 0, 0], "rotation": [0, 0, 0, 1]}'
    (tmp_path / "truth").mkdir()
    (tmp_path / FILE).write_text(f"{good}\n{line}\n")
    with pytest.raises(InputError, match=r"objects\.jsonl:2: not an object") as e:
        read_truth(tmp_path)
    assert "\n" not in str(e.value)
    (tmp_path / FILE).unlink()
    with pytest.raises(InputError, match="record with examples"):
        read_truth(tmp_path)
