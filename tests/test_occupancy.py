"""Occupancy grids: a known room gives the known cells, whichever way is up, and other tools read them."""

import dataclasses
import json

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from known_maps import element, saved, world
from vlmm_log.background import Background
from vlmm_log.elements import MotionClass, WorldMap
from vlmm_log.maps.grid import save_grid
from vlmm_log.maps.occupancy import FREE, OCCUPIED, R_GRID_WORLD, UNKNOWN, occupancy
from vlmm_log.maps.saved import WORLD_UP
from vlmm_log.pipeline.language.space import UP
from vlmm_log.settings import GridSettings
from vlmm_log.types import InputError

VOXEL = 0.05
S = GridSettings()
# A room of 60 x 40 voxels (3 x 2 m) whose floor is layer 0: walls along its left and far side, a box 0.5 m high on it,
# a rug of one voxel, a ceiling at 2.4 m, and a corner of the floor that nobody saw.
WIDTH, DEPTH, CEILING = 60, 40, 48
BOX, RUG, UNSEEN = (slice(10, 16), slice(30, 40)), (slice(2, 6), slice(5, 9)), (slice(30, 38), slice(50, 60))


def room_cells():
    """(n, 3) voxel coordinates, z up."""
    filled = np.zeros((DEPTH, WIDTH, CEILING + 1), bool)
    filled[:, :, 0] = filled[:, :, CEILING] = True
    filled[UNSEEN][..., 0] = False
    filled[:, 0] = filled[-1] = True
    filled[(*BOX, slice(1, 11))] = True
    filled[(*RUG, 1)] = True
    y, x, z = np.nonzero(filled)
    return np.stack([x, y, z], axis=1)


def expected():
    """(DEPTH, WIDTH) of the room's grid."""
    data = np.full((DEPTH, WIDTH), FREE, np.int8)
    data[UNSEEN] = UNKNOWN
    data[BOX] = data[:, 0] = data[-1] = OCCUPIED
    return data


def voxels(cells, voxel_m=VOXEL, points=1):
    cells = np.unique(np.asarray(cells, np.int32).reshape(-1, 3), axis=0)
    sums = np.tile(np.array([points, 0, 0, 0], np.int64), (len(cells), 1))
    return Background(voxel_m, cells, sums)


def turned(cells, up):
    """The same voxels in a world in which ``up`` points up. A voxel c covers [c, c + 1): the mirrored one is -c - 1."""
    doubled = (2 * np.asarray(cells) + 1) @ R_GRID_WORLD[up].astype(int)
    return (doubled - 1) // 2


def room(elements=(), up="+z", shift=(0, 0, 0)):
    return saved(world(elements, voxels=voxels(turned(room_cells() + np.array(shift), up))), world_up=up)


def refused(*args, **options):
    with pytest.raises(InputError, match=r"^[^\n]+$") as e:
        occupancy(*args, **options)
    return str(e.value)


# ---- the room


@given(shift=st.tuples(*[st.integers(-500, 500)] * 3))
def test_a_known_room_gives_the_known_cells_wherever_it_lies(shift):
    grid = occupancy(room(shift=shift), S)
    np.testing.assert_array_equal(grid.data, expected())
    np.testing.assert_allclose(grid.origin, np.array(shift[:2]) * VOXEL, atol=1e-9)
    assert grid.floor_m == pytest.approx((shift[2] + 0.5) * VOXEL, abs=0.01)
    assert (grid.motion_class == 255).all()
    assert (grid.element_id == -1).all()


@pytest.mark.parametrize("up", WORLD_UP)
def test_every_up_axis_gives_the_same_grid(up):
    R = R_GRID_WORLD[up]
    np.testing.assert_allclose(R @ UP[up], [0, 0, 1])
    assert np.linalg.det(R) == 1
    long = np.diag([0.04, 0.0025, 0.01])  # m^2, grid axes
    extents = {"+z": long, up: R.T @ long @ R}
    things = {
        axis: element(3, position=R_GRID_WORLD[axis].T @ [1.2, 0.9, 0.5], extent=S_[np.triu_indices(3)])
        for axis, S_ in extents.items()
    }
    plain, other = occupancy(room([things["+z"]]), S), occupancy(room([things[up]], up), S)
    assert (other.data == plain.data).all()
    assert (other.element_id == plain.element_id).all()
    np.testing.assert_array_equal(other.origin, plain.origin)
    assert other.floor_m == plain.floor_m


def test_in_the_camera_s_frame_the_grid_looks_ahead():
    """Camera axes, x right, y down, z forward: what is ahead has a high y, what is to the right a high x."""
    thing = element(1, position=(0.5, 0, 3), extent=[1e-6, 0, 0, 1e-6, 0, 1e-6])
    grid = occupancy(saved(world([thing]), world_up="-y"), S)
    np.testing.assert_allclose(grid.origin, [0.5, 3], atol=VOXEL)


@pytest.mark.parametrize("resolution", [0.01, 0.025, 0.03, 0.1, 0.2])
def test_other_resolutions_show_the_same_room(resolution):
    grid = occupancy(room(), dataclasses.replace(S, resolution_m=resolution))
    height, width = grid.data.shape
    assert abs(width * resolution - WIDTH * VOXEL) < 2 * resolution
    y, x = np.meshgrid(np.arange(DEPTH) + 0.5, np.arange(WIDTH) + 0.5, indexing="ij")
    column = np.floor(x * VOXEL / resolution - grid.origin[0] / resolution + 1e-9).astype(int)
    row = np.floor(y * VOXEL / resolution - grid.origin[1] / resolution + 1e-9).astype(int)
    there = grid.data[row, column]
    assert (there[expected() == OCCUPIED] == OCCUPIED).all()  # no obstacle is lost
    assert not (grid.data[1 : height - 1, 1 : width - 1] == UNKNOWN)[: height // 2].any()  # no hole between voxels
    if resolution <= VOXEL:
        assert np.mean(there == expected()) > 0.93


def test_the_band_is_above_the_floor():
    at = (BOX[0].start, BOX[1].start)
    rug = (RUG[0].start, RUG[1].start)
    assert occupancy(room(), dataclasses.replace(S, low_m=0.6)).data[at] == FREE
    assert occupancy(room(), dataclasses.replace(S, low_m=0.4)).data[at] == OCCUPIED
    assert occupancy(room(), dataclasses.replace(S, low_m=0.03)).data[rug] == OCCUPIED
    assert occupancy(room(), dataclasses.replace(S, high_m=2.5)).data[20, 30] == OCCUPIED  # the ceiling


def test_the_floor_is_found_below_furniture_and_above_stray_points():
    stray = [[x, 32, -k] for k, x in ((3, 52), (4, 53), (7, 54), (40, 55))]
    cells = np.concatenate([room_cells(), stray, [[x, y, 15] for x in range(20, 50) for y in range(5, 35)]])
    grid = occupancy(saved(world(voxels=voxels(cells))), S)
    assert grid.floor_m == pytest.approx(0.5 * VOXEL, abs=0.01)
    np.testing.assert_array_equal(grid.data == UNKNOWN, expected() == UNKNOWN)


def test_a_floor_over_several_layers_is_one():
    cells = room_cells()
    floor = cells[:, 2] == 0
    cells[floor, 2] += np.random.default_rng(0).choice([-1, 0, 1], floor.sum(), p=[0.2, 0.6, 0.2])
    grid = occupancy(saved(world(voxels=voxels(cells))), S)
    assert grid.floor_m == pytest.approx(0.5 * VOXEL, abs=0.005)
    np.testing.assert_array_equal(grid.data, expected())


def test_a_floor_that_is_given_is_taken():
    grid = occupancy(room(), dataclasses.replace(S, floor="-1.0"))
    assert grid.floor_m == -1
    assert grid.data[20, 20] == OCCUPIED  # what is the floor else
    for text in ("low", "nan", "inf", ""):
        assert "give a height in m, or auto" in refused(room(), dataclasses.replace(S, floor=text))


# ---- elements


def at(grid, x, y):
    return tuple(np.floor((np.array([y, x]) - grid.origin[::-1]) / grid.resolution_m).astype(int))


@pytest.mark.parametrize("degrees", [0, 30, 90, 137])
def test_an_element_covers_its_ellipse_of_two_sigmas(degrees):
    turn = np.deg2rad(degrees)
    R = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    sigmas = np.array([0.2, 0.06, 0.1])
    extent = (R * sigmas**2 @ R.T)[np.triu_indices(3)]
    thing = element(8, position=(1.5, 1, 0.5), extent=extent, motion_class=MotionClass.MOVING)
    grid = occupancy(room([thing]), dataclasses.replace(S, resolution_m=0.01))
    covered = grid.element_id == 8
    assert (grid.data[covered] == OCCUPIED).all()
    assert set(grid.motion_class[covered]) == {MotionClass.MOVING}
    assert set(grid.motion_class[~covered]) == {255}
    assert covered.sum() * 0.01**2 == pytest.approx(np.pi * 4 * sigmas[0] * sigmas[1], rel=0.02)
    along = R[:2, 0]
    for distance, inside in ((0.38, True), (0.42, False), (-0.38, True), (-0.42, False)):
        assert covered[at(grid, *(np.array([1.5, 1]) + distance * along))] == inside


def test_a_thin_element_leaves_no_gap():
    along = np.array([1, 0.7, 0]) / np.hypot(1, 0.7)
    leaf = element(2, position=(1.5, 1, 0.5), extent=(0.16 * np.outer(along, along))[np.triu_indices(3)])
    covered = (occupancy(room([leaf]), S).element_id == 2).astype(np.uint8)
    assert cv2.connectedComponents(covered, connectivity=8)[0] == 2  # the background and one piece
    assert 26 <= covered.sum() < 70  # 1.3 m along x


def test_a_point_and_what_is_no_covariance_cover_their_own_cell():
    point = element(1, position=(0.512, 0.512, 0.5), extent=[0] * 6)
    none = element(2, position=(1.512, 0.512, 0.5), extent=[-1, 0, 0, -1, 0, -1])
    grid = occupancy(room([point, none]), S)
    assert grid.element_id[at(grid, 0.512, 0.512)] == 1
    assert grid.element_id[at(grid, 1.512, 0.512)] == 2
    assert (grid.element_id >= 0).sum() < 10


def test_the_most_mobile_class_is_told_then_the_smaller_id():
    classes = {5: MotionClass.MOVABLE_STATIC, 6: MotionClass.MOVING, 7: MotionClass.MOVING, 8: MotionClass.STATIC}
    things = [element(i, position=(1, 1, 0.5), motion_class=c) for i, c in classes.items()]
    for order in (things, things[::-1]):
        grid = occupancy(room(order), S)
        assert grid.element_id[at(grid, 1, 1)] == 6
        assert grid.motion_class[at(grid, 1, 1)] == MotionClass.MOVING


def test_elements_outside_the_band_are_no_obstacles():
    flat = [0.01, 0, 0, 0.01, 0, 1e-6]
    lamp, rug = (element(i, position=(1, 0.3, z), extent=flat) for i, z in ((1, 2.3), (2, 0.05)))
    np.testing.assert_array_equal(occupancy(room([lamp, rug]), S).data, expected())
    assert (occupancy(room([lamp]), dataclasses.replace(S, high_m=2.4)).element_id == 1).any()


def test_only_a_query_s_answer():
    things = [element(i, position=(0.5 * i, 1, 0.5), extent=[1e-4, 0, 0, 1e-4, 0, 1e-4]) for i in (1, 2, 3)]
    grid = occupancy(room(things), S, ids=np.array([3, 1]))
    assert set(np.unique(grid.element_id)) == {-1, 1, 3}
    assert grid.data[at(grid, 1, 1)] == FREE  # nothing else stands where element 2 is
    np.testing.assert_array_equal(occupancy(room(things), S, ids=[]).data, expected())
    assert "no element 4" in refused(room(things), S, ids=[4])


def test_elements_without_a_background_are_drawn_at_any_height():
    grid = occupancy(saved(world([element(1, position=(0, 0, 30))])), S)
    assert np.isnan(grid.floor_m)
    assert set(np.unique(grid.data)) == {UNKNOWN, OCCUPIED}


# ---- too much, too little


def test_a_far_outlier_is_told_and_its_remedy_works():
    far = np.array([2**31 - 1, -(2**31), 0], np.int32)
    seen = voxels(room_cells(), points=5)
    cells, sums = np.vstack([seen.cells, far]), np.vstack([seen.sums, [1, 0, 0, 0]])
    stray = saved(WorldMap({}, {}, (Background(VOXEL, cells, sums),)))
    assert "too large; take larger cells, or leave out stray voxels with a higher min_points" in refused(stray, S)
    np.testing.assert_array_equal(occupancy(stray, dataclasses.replace(S, min_points=2)).data, expected())


@pytest.mark.parametrize("change", [{"position": (3e38, 0, 0.5)}, {"extent": [3e38, 0, 0, 3e38, 0, 3e38]}])
def test_an_absurd_element_is_told(change):
    absurd = element(1, **({"position": (1, 1, 0.5)} | change))
    assert "is too large" in refused(room([absurd]), S)
    assert "is too large" in refused(saved(world([absurd])), S)  # alone it needs few cells


@pytest.mark.parametrize("resolution", [1e-3, 1e-9, 0.0, -1.0, float("nan")])
def test_cells_that_are_too_small_or_none(resolution):
    assert "m cells" in refused(room(), dataclasses.replace(S, resolution_m=resolution))


def test_an_empty_map_has_no_grid():
    assert "kitchen: its map holds neither background nor element" in refused(saved(), S)


# ---- files


def trinary(grey, told):
    """What ROS's map_server makes of a pixel."""
    occupied = (grey if told["negate"] else 255.0 - grey) / 255.0
    data = np.full(grey.shape, UNKNOWN)
    data[occupied > told["occupied_thresh"]] = OCCUPIED
    data[occupied < told["free_thresh"]] = FREE
    return data[::-1]  # the image's first row is the highest y


def test_the_ros_pair_is_read_back_as_the_grid(tmp_path):
    grid = occupancy(room([element(1, position=(1.2, 0.9, 0.5))], shift=(-7, 3, 0)), S)
    path = tmp_path / "my: 'room' #1.yaml"
    save_grid(path, grid, force=False)
    pairs = (line.split(": ", 1) for line in path.read_text("utf-8").splitlines())
    told = {name: value if name == "mode" else json.loads(value) for name, value in pairs}
    assert told["image"] == "my: 'room' #1.pgm"
    grey = cv2.imread(str(tmp_path / told["image"]), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(trinary(grey, told), grid.data)
    assert {UNKNOWN, FREE, OCCUPIED} == set(np.unique(grid.data))
    np.testing.assert_allclose(told["origin"], [-7 * VOXEL, 3 * VOXEL, 0])
    assert (told["resolution"], told["mode"], told["negate"]) == (VOXEL, "trinary", 0)
    assert (told["occupied_thresh"], told["free_thresh"]) == (0.65, 0.196)
    assert sorted(p.suffix for p in tmp_path.iterdir()) == [".pgm", ".yaml"]


def test_npz_holds_every_layer_and_no_pickle(tmp_path):
    grid = occupancy(room([element(2**62, position=(1.2, 0.9, 0.5))]), S)
    save_grid(tmp_path / "room.npz", grid, force=False)
    with np.load(tmp_path / "room.npz", allow_pickle=False) as read:
        for field in dataclasses.fields(grid):
            value = np.asarray(getattr(grid, field.name))
            np.testing.assert_array_equal(read[field.name], value)
            assert read[field.name].dtype == value.dtype
    save_grid(tmp_path / "again.npz", grid, force=False)
    assert (tmp_path / "room.npz").read_bytes() == (tmp_path / "again.npz").read_bytes()


@pytest.mark.parametrize("taken", ["a.yaml", "a.pgm"])
def test_neither_file_of_the_pair_is_replaced_without_force(tmp_path, taken):
    grid = occupancy(room(), S)
    (tmp_path / taken).write_text("mine")
    with pytest.raises(InputError, match=f"{taken}: exists; give --force"):
        save_grid(tmp_path / "a.yaml", grid, force=False)
    assert [p.name for p in tmp_path.iterdir()] == [taken]
    save_grid(tmp_path / "a.yaml", grid, force=True)
    assert (tmp_path / taken).read_bytes() != b"mine"


def test_a_grid_s_suffix_that_is_none(tmp_path):
    with pytest.raises(InputError, match=r"\.npz, or as \.yaml"):
        save_grid(tmp_path / "a.png", occupancy(room(), S), force=False)
