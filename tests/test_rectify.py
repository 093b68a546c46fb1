"""Lens distortion undone, and depth registered to colour: against analytic renderings and textbook forms."""

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as runs
from hypothesis import strategies as st
from scipy import ndimage

from vlmm_log import se3
from vlmm_log.readers.intrinsics import Intrinsics
from vlmm_log.readers.rectify import Rectifier, source_places
from vlmm_log.readers.register import LARGEST, SAME_SURFACE, register
from vlmm_log.types import InputError

# ---- lens distortion

CAMERA = Intrinsics(130.0, 128.0, 78.6, 61.3, 160, 120, source="test camera")
SIZE = (120, 160)
LENSES = {
    "freiburg1": (0.2624, -0.9531, -0.0054, 0.0026, 1.1633),
    "freiburg2": (0.2312, -0.7849, -0.0033, -0.0001, 0.9172),
    "Bonn": (0.039903, -0.099343, -0.000730, -0.000144, 0.0),
    "barrel": (-0.28, 0.07, 0.0002, 0.00002),
    "Azure Kinect": (0.53, -2.58, 0.0006, -0.0002, 1.49, 0.41, -2.4, 1.42),
    "fisheye": (-0.013, 0.0203, -0.0145, 0.0038),
}
MODELS = {"Azure Kinect": "rational_polynomial", "fisheye": "equidistant"}


def lens(name):
    return replace(CAMERA, distortion=LENSES[name], model=MODELS.get(name, "plumb_bob"))


def grid(size):
    """Pixel centres (2, H, W) px: u, v."""
    v, u = np.mgrid[: size[0], : size[1]]
    return np.array([u, v], float)


def projected(camera, points):
    """Points (n, 3) m in the distorted image, (n, 2) px."""
    project = cv2.fisheye.projectPoints if camera.model == "equidistant" else cv2.projectPoints
    D = np.array(camera.distortion)
    if camera.model == "equidistant":
        return project(points[:, None], np.zeros(3), np.zeros(3), camera.K, D)[0].reshape(-1, 2)
    return project(points, np.zeros(3), np.zeros(3), camera.K, D)[0].reshape(-1, 2)


def rays(camera, uv):
    """Where the rays of distorted pixels (2, H, W) meet z = 1, (2, H, W): Newton's steps on the projection itself."""
    shape, target = uv.shape, uv.reshape(2, -1).T

    def place(xy):
        return projected(camera, np.column_stack([xy, np.ones(len(xy))]))

    xy = (target - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
    step = 1e-5
    for _ in range(12):
        error = target - place(xy)
        columns = [(place(xy + d) - place(xy - d)) / (2 * step) for d in step * np.eye(2)]
        xy = xy + np.linalg.solve(np.stack(columns, -1), error[..., None])[..., 0]
    assert np.abs(target - place(xy)).max() < 1e-6
    return xy.T.reshape(shape)


def pattern(xy):
    """A smooth scene at z = 1, (H, W, 3) u8."""
    x, y = xy
    bands = [np.sin(17 * x + 5 * y), np.sin(13 * y - 6 * x), np.cos(9 * x) * np.cos(11 * y)]
    return np.rint(127.5 + 110 * np.stack(bands, -1)).astype(np.uint8)


@pytest.mark.parametrize("name", ["barrel", "Bonn", "fisheye"])  # of which every pixel of the image has a ray
def test_a_rendering_through_the_lens_becomes_the_pinhole_rendering(name):
    camera, rectifier = lens(name), Rectifier(lens(name), SIZE)
    pinhole = (grid(SIZE) - np.array([camera.cx, camera.cy])[:, None, None]) / np.array([[[camera.fx]], [[camera.fy]]])
    distorted = pattern(rays(camera, grid(SIZE)))
    off = np.abs(rectifier.rgb(distorted).astype(int) - pattern(pinhole))
    seen = np.isfinite(rectifier.depth(np.ones(SIZE, np.float32)))
    seen = ndimage.binary_erosion(seen)  # at the border black is mixed in
    assert seen.mean() > 0.95
    assert off[seen].max() <= 6  # of 220: 1/32 px and the bilinear chord
    assert 2 * off[seen].mean() < np.abs(distorted.astype(int) - pattern(pinhole)).mean()


@pytest.mark.parametrize("name", LENSES)
def test_points_land_where_the_pinhole_projects_them(name):
    camera, rectifier = lens(name), Rectifier(lens(name), SIZE)
    from_u, from_v = (rectifier.depth(x.astype(np.float32)) for x in grid(SIZE))  # the source pixel shown at each pixel
    z = np.random.default_rng(0).uniform(0.5, 8, SIZE)
    points = np.linalg.inv(camera.K) @ (np.stack([*grid(SIZE), np.ones(SIZE)]) * z).reshape(3, -1)
    true_u, true_v = projected(camera, points.T).T.reshape(2, *SIZE)
    H, W = SIZE
    inside = (true_u > -0.49) & (true_u < W - 0.51) & (true_v > -0.49) & (true_v < H - 0.51)
    assert inside.mean() > 0.85
    assert np.abs(from_u - true_u)[inside].max() < 0.6
    assert np.abs(from_v - true_v)[inside].max() < 0.6
    outside = (true_u < -0.51) | (true_u > W - 0.49) | (true_v < -0.51) | (true_v > H - 0.49)
    assert np.isnan(from_u[outside]).all()
    assert rectifier.unseen_share == pytest.approx(outside.mean(), abs=0.002)


def test_depth_is_never_mixed_and_holes_stay():
    depth = np.where(grid(SIZE)[0] // 5 % 2 == 0, 1.0, 4.0).astype(np.float32)
    depth[40:50, 60:90] = np.nan
    out = Rectifier(lens("barrel"), SIZE).depth(depth)
    assert set(np.unique(out[np.isfinite(out)])) == {1.0, 4.0}
    assert 200 < np.isnan(out).sum() < 450


def test_what_the_lens_does_not_show_is_black_and_unseen():
    rectifier = Rectifier(
        replace(lens("freiburg1"), cx=-900.0, cy=-900.0), SIZE
    )  # an image far beside the axis: all outside
    assert rectifier.unseen_share == 1
    assert not rectifier.rgb(np.full((*SIZE, 3), 255, np.uint8)).any()
    assert np.isnan(rectifier.depth(np.ones(SIZE, np.float32))).all()


@runs(max_examples=30)
@given(st.tuples(st.floats(-0.2, 0.2), st.floats(-0.1, 0.1), st.floats(-0.01, 0.01), st.floats(-0.01, 0.01)))
def test_mild_lenses_do_not_fold(distortion):
    x, y = source_places(replace(CAMERA, distortion=distortion), SIZE)
    Rectifier(replace(CAMERA, distortion=distortion), SIZE)
    points = np.linalg.inv(CAMERA.K) @ np.stack([*grid(SIZE), np.ones(SIZE)]).reshape(3, -1)
    want = projected(replace(CAMERA, distortion=distortion), points.T).T.reshape(2, *SIZE)
    np.testing.assert_allclose([x, y], want, atol=1e-3)


@pytest.mark.parametrize(
    "wrong",
    [
        {"distortion": (-1.5, 0.0, 0.0, 0.0)},  # folds
        {"distortion": (3.0, -9.0, 0.0, 0.0)},
        {"distortion": (0.5, 0.0, 0.0, 0.0, 0.0, -6.0, 0.0, 0.0), "model": "rational_polynomial"},  # a pole
        {"distortion": (-1.0, 0.0, 0.0, 0.0), "model": "equidistant"},
        {"distortion": (0.1, 0.2, 0.3)},
        {"distortion": (0.1, 0.0, 0.0, 0.0), "model": "omni"},
        {"distortion": (np.nan, 0.0, 0.0, 0.0)},
        {"distortion": (0.1, 0.0, 0.0, 0.0), "width": 640, "height": 480},
    ],
)
def test_what_is_no_lens_is_told(wrong):
    with pytest.raises(InputError, match=r"^test camera: "):
        Rectifier(replace(CAMERA, **wrong), SIZE)


def test_a_fold_that_the_image_does_not_show_does_no_harm():
    camera = replace(CAMERA, distortion=(2.0, -2.9, 0.0, 0.0))  # stretches the corners away before it folds there
    x, _ = source_places(camera, SIZE)
    assert x[0, -2] > x[0, -1] > SIZE[1]
    Rectifier(camera, SIZE)


def test_images_of_another_size_are_told():
    with pytest.raises(InputError, match=r"^image is 160x100, .* 160x120"):
        Rectifier(lens("Bonn"), SIZE).depth(np.ones((100, 160), np.float32))


# ---- depth registered to colour

K_DEPTH = np.array([[96.0, 0, 59.3], [0, 95.0, 44.8], [0, 0, 1]])
DEPTH_SIZE = (90, 120)
T_RGB_DEPTH = se3.exp(np.array([0.01, -0.02, 0.015, -0.06, 0.008, 0.01]))
SPHERE, RADIUS = np.array([-0.15, 0.05, 1.1]), 0.25
BOX = np.array([[0.15, -0.3, 1.2], [0.4, 0.1, 1.5]])
WALL, WALL_M = np.array([0.3, -0.2, 0.93]), 2.0  # normal . x = distance


def colour_camera(scale):
    """K and size of a camera with ``scale`` times as many pixels a side."""
    K = K_DEPTH * [[scale], [scale], [1]]
    return K, (round(DEPTH_SIZE[0] * scale), round(DEPTH_SIZE[1] * scale))


def cast(origin, directions):
    """Distance along directions (3, ...) from origin (3,), and what is hit: 0 wall, 1 sphere, 2 box."""
    at = [(WALL_M - WALL @ origin) / np.tensordot(WALL, directions, 1)]
    b = np.tensordot(origin - SPHERE, directions, 1)
    a, c = (directions**2).sum(0), (origin - SPHERE) @ (origin - SPHERE) - RADIUS**2
    with np.errstate(invalid="ignore", divide="ignore"):
        at.append((-b - np.sqrt(b * b - a * c)) / a)
        slabs = (
            BOX.reshape(2, 3, *[1] * (directions.ndim - 1)) - origin.reshape(3, *[1] * (directions.ndim - 1))
        ) / directions
    enter, leave = slabs.min(0).max(0), slabs.max(0).min(0)
    at.append(np.where(enter < leave, enter, np.nan))
    distance = np.where(np.isfinite(at) & (np.array(at) > 0), at, np.inf)
    return distance.min(0), distance.argmin(0)


def rendered(K, size, T_cam_depth):
    """Depth (H, W) m of the scene, which stands in the depth camera's frame; what is hit; where, (3, H, W) m."""
    T_depth_cam = se3.inverse(T_cam_depth)
    bearings = np.tensordot(np.linalg.inv(K), np.stack([*grid(size), np.ones(size)]), 1)
    directions = np.tensordot(T_depth_cam[:3, :3], bearings, 1)
    depth, label = cast(T_depth_cam[:3, 3], directions)
    return depth, label, T_depth_cam[:3, 3, None, None] + directions * depth


def hidden_from_depth_camera(points):
    """Whether points (3, ...) m of the scene lie behind something, or out of the image, for the depth camera."""
    first, _ = cast(np.zeros(3), points)
    u, v = np.tensordot(K_DEPTH, points, 1)[:2] / points[2]
    H, W = DEPTH_SIZE
    return (first < 1 - 1e-6) | (u < -0.5) | (v < -0.5) | (u > W - 0.5) | (v > H - 0.5)


def dilated(mask, px):
    return ndimage.binary_dilation(mask, np.ones((3, 3)), iterations=px)


@pytest.mark.parametrize("scale", [0.6, 1.0, 1.7, 3.3])
def test_registered_depth_is_what_the_colour_camera_would_measure(scale):
    K, size = colour_camera(scale)
    depth = rendered(K_DEPTH, DEPTH_SIZE, np.eye(4))[0].astype(np.float32)
    truth, label, points = rendered(K, size, T_RGB_DEPTH)
    out = register(depth, K_DEPTH, K, T_RGB_DEPTH, size)
    hidden, reach = hidden_from_depth_camera(points), max(1, round(scale))  # reach: a depth pixel, in colour pixels
    edge = dilated(np.abs(ndimage.laplace(label.astype(float))) > 0, reach) | dilated(hidden, reach) & ~hidden
    clear = ~hidden & ~edge
    assert clear.mean() > 0.6
    assert np.isfinite(out[clear]).all()  # no hole
    slope = ndimage.maximum_filter(np.hypot(*np.gradient(truth)), 3)  # m a colour pixel
    limit = (slope * (0.75 * max(scale, 1)) + 2e-3)[clear]
    assert (np.abs(out - truth)[clear] <= limit).mean() > 0.999
    assert np.median(np.abs(out - truth)[clear]) < 3e-3
    shadow = hidden & ~dilated(~hidden, reach)
    assert shadow.sum() > 20 * scale**2
    assert np.isnan(out[shadow]).all()
    front = out < 0.9 * truth  # foreground drawn over what lies behind it: at most half a depth pixel, rounded up
    assert not (front & ~dilated(label > 0, math.ceil(scale / 2))).any()


def test_without_motion_depth_stays_as_it_is():
    rng = np.random.default_rng(1)
    depth = rng.uniform(0.3, 9, (120, 160)).astype(np.float32)
    depth[rng.random(depth.shape) < 0.2] = np.nan
    depth.flags.writeable = False
    out = register(depth, K_DEPTH, K_DEPTH, np.eye(4), depth.shape)
    np.testing.assert_array_equal(out.view(np.uint32), depth.view(np.uint32))


def textbook(depth, K_depth, K_rgb, T, size):
    """Patch by patch in float64."""
    out = np.full(size, np.inf)
    depth = np.where((depth > 0) & (depth < np.inf), depth.astype(float), np.nan)

    def place(x, y, z):
        """(u, v, depth) in the colour image of the depth image's place (x, y) at depth z."""
        point = T[:3, :3] @ (np.linalg.inv(K_depth) @ [x, y, 1.0] * z) + T[:3, 3]
        u, v, _ = K_rgb @ point / point[2]
        return u, v, point[2]

    for v, u in np.argwhere(np.isfinite(depth)):
        corners = []
        for dv in (0, 1):
            for du in (0, 1):
                near = depth[max(v + dv - 1, 0) : v + dv + 1, max(u + du - 1, 0) : u + du + 1]
                one_surface = np.nanmax(near) <= (1 + SAME_SURFACE) * np.nanmin(near)
                z = np.nanmean(near) if one_surface else depth[v, u]
                corners.append(place(u + du - 0.5, v + dv - 0.5, z))
        (left, top, _), (right, bottom, _) = np.min(corners, 0), np.max(corners, 0)
        z = place(u, v, depth[v, u])[2]
        if min(z, *(c[2] for c in corners)) <= 0 or max(right - left, bottom - top) > LARGEST:
            continue
        x, y = grid(size)
        out[(x >= left) & (x < right) & (y >= top) & (y < bottom) & (z < out)] = z
    return np.where(np.isinf(out), np.nan, out).astype(np.float32)


@pytest.mark.parametrize("scale", [0.5, 1.0, 2.2])
@pytest.mark.parametrize("forward", [0.0, 1.4])  # m; the second camera stands amid the surfaces
def test_kernel_against_textbook(forward, scale):
    rng = np.random.default_rng(0)
    surfaces = ndimage.gaussian_filter(rng.normal(0, 8, (24, 32)), 3)
    depth = (2 + surfaces + np.where(surfaces > 0.2, -0.7, 0) + rng.normal(0, 0.01, surfaces.shape)).astype(np.float32)
    depth[rng.random(depth.shape) < 0.1] = rng.choice([np.nan, 0, np.inf, -1])
    K_depth = np.array([[30.0, 0, 15.2], [0, 31.0, 11.7], [0, 0, 1]])
    K_rgb, size = K_depth * [[scale], [scale], [1]], (round(24 * scale), round(32 * scale))
    T = se3.exp(rng.normal(0, [0.05, 0.05, 0.3, 0.1, 0.1, 0.1])) @ se3.exp(np.array([0, 0, 0, 0, 0, -forward]))
    out, want = register(depth, K_depth, K_rgb, T, size), textbook(depth, K_depth, K_rgb, T, size)
    assert 0.4 < np.isfinite(want).mean() < 1
    np.testing.assert_allclose(out, want, rtol=1e-6)
    np.testing.assert_array_equal(out, register(depth, K_depth, K_rgb, T, size))


@pytest.mark.parametrize("forward", [0.9, 0.98, 1.02])
def test_a_surface_that_passes_through_the_colour_camera_is_cut_off_there(forward):
    depth = np.tile(1.04 ** np.arange(-16, 16), (24, 1)).astype(np.float32)  # m, 1 amid the image
    K_depth, K_rgb = (np.array([[f, 0, 15.3], [0, f, 11.7], [0, 0, 1]]) for f in (30.0, 10.0))
    T = se3.exp(np.array([0, 0, 0, 0, 0, -forward]))
    out, want = register(depth, K_depth, K_rgb, T, depth.shape), textbook(depth, K_depth, K_rgb, T, depth.shape)
    assert np.isfinite(want).any()
    np.testing.assert_allclose(out, want, rtol=1e-6)


small = st.floats(-0.08, 0.08)


@runs(max_examples=40)
@given(st.tuples(*[small] * 6), st.tuples(st.floats(-0.6, 0.6), st.floats(-0.6, 0.6)), st.floats(0.7, 2.5))
def test_a_plane_stays_a_plane_without_holes(twist, slant, scale):
    T, normal = se3.exp(np.array(twist)), np.array([*slant, 1.0])
    K, size = colour_camera(scale)

    def plane(K, size, T_cam_depth):
        n = T_cam_depth[:3, :3] @ normal  # n . x = d in that camera
        d = 1.5 + n @ T_cam_depth[:3, 3]
        return d / np.tensordot(n @ np.linalg.inv(K), np.stack([*grid(size), np.ones(size)]), 1)

    depth, truth = plane(K_DEPTH, DEPTH_SIZE, np.eye(4)), plane(K, size, T)
    out = register(depth.astype(np.float32), K_DEPTH, K, T, size)
    points = np.tensordot(np.linalg.inv(K), np.stack([*grid(size), np.ones(size)]), 1) * truth
    back = se3.inverse(T)
    u, v, z = np.tensordot(K_DEPTH, np.tensordot(back[:3, :3], points, 1) + back[:3, 3, None, None], 1)
    inside = (np.abs(u / z - 59.5) < 59.4) & (np.abs(v / z - 44.5) < 44.4)
    assert np.isfinite(out[inside]).all()
    limit = np.abs(np.gradient(truth)).sum(0) * (0.75 * max(scale, 1)) + 1e-6
    assert (np.abs(out - truth) <= limit)[inside].all()


def test_the_nearest_surface_wins_and_what_is_behind_the_camera_is_left_out():
    depth = np.full(DEPTH_SIZE, 3.0, np.float32)
    depth[30:60, 40:70] = 1.0

    def values(forward):
        """Depths seen, m, and the image, from a camera so many metres ahead and 0.1 m to the left."""
        T = se3.exp(np.array([0, 0, 0, 0.1, 0, -forward]))
        out = register(depth, K_DEPTH, K_DEPTH, T, DEPTH_SIZE)
        return set(np.unique(out[np.isfinite(out)])), out

    seen, out = values(0.5)
    assert seen == {0.5, 2.5}
    assert (out[20:70, 45:95] == 0.5).all()  # twice as large, and nothing shows through
    assert values(31 / 32)[0] == {1 / 32}  # patches of 32 px, before all else
    assert values(127 / 128)[0] == {2 + 1 / 128}  # too large
    assert values(1.0)[0] == {2.0}
    assert values(4.0)[0] == set()


@pytest.mark.parametrize(
    "wrong", [np.full((4, 4), np.nan), T_RGB_DEPTH.T, T_RGB_DEPTH * 2, np.eye(3), np.diag([1.0, 1, -1, 1])]
)
def test_what_is_no_rigid_motion_is_told(wrong):
    with pytest.raises(InputError, match=r"^depth to colour: .* is no rigid motion"):
        register(np.ones(DEPTH_SIZE, np.float32), K_DEPTH, K_DEPTH, wrong, DEPTH_SIZE)
