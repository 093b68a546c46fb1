"""Rendered rooms: the truth beside them is exact, the noise is what it says, equal calls give equal bytes."""

import csv
import hashlib
import json
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

pytest.importorskip("open3d", reason="simulate needs Open3D, the sim extra")

from vlmm_log import se3, simulate
from vlmm_log.models.prior import read_table
from vlmm_log.readers import open_log
from vlmm_log.simulation import noise as sensor_noise
from vlmm_log.simulation.kernels import Lens
from vlmm_log.simulation.noise import DepthNoise, measured, nguyen_sigma, quadratic_sigma, sensor
from vlmm_log.simulation.raycast import build, cast, exposure
from vlmm_log.simulation.scenes import SCENES, drawn
from vlmm_log.simulation.view import Shutter, studio, taken
from vlmm_log.types import InputError

SIZE, GAP, FRAMES = (180, 240), 3, 8
FLAT = np.ones((240, 320), np.float32)


@pytest.fixture(scope="module")
def rendered(tmp_path_factory):
    out = tmp_path_factory.mktemp("sim") / "kitchen"
    simulate("kitchen", out, frames=FRAMES, seed=3, size=SIZE, gap=GAP)
    return Truth(out)


class Truth:
    """What a folder says, read with nothing of the project but quaternions."""

    def __init__(self, out):
        self.out, self.about = out, json.loads((out / "truth/truth.json").read_text())
        rows = np.loadtxt(out / "truth/poses.txt")
        self.poses = se3.from_quaternion(rows[:, 1:4], rows[:, 4:])
        self.owner = {int(r["part"]): int(r["instance"]) for r in table(out / "truth/parts.csv")}
        self.parts = {(i, 0): np.eye(4) for i in range(len(rows))}
        for r in table(out / "truth/part_poses.csv"):
            pose = np.array([float(r[k]) for k in ("tx", "ty", "tz", "qx", "qy", "qz", "qw")])
            self.parts[int(r["frame"]), int(r["part"])] = se3.from_quaternion(pose[:3], pose[3:])
        values = dict(line.split() for line in (out / "camera.txt").read_text().splitlines())
        self.f, self.cx, self.cy = (float(values[k]) for k in ("fx", "cx", "cy"))

    def image(self, kind, i):
        return cv2.imread(str(self.out / f"truth/{kind}/{i:06d}.png"), cv2.IMREAD_UNCHANGED)

    def depth(self, i):
        return self.image("depth", i) / self.about["depth_units_per_meter"]

    def flow(self, i):
        """(H, W, 2) px and (H, W) valid."""
        stored = self.image("flow", i)[..., ::-1].astype(np.float64)
        return (stored[..., :2] - 2**15) / 64, stored[..., 2] == 1

    def carried(self, a, b):
        """Camera points (H, W, 3) of frame b of what frame a sees, and the way in the world (H, W)."""
        depth, part = self.depth(a), self.image("parts", a)
        v, u = np.mgrid[0 : depth.shape[0], 0 : depth.shape[1]]
        points = np.stack([(u - self.cx) / self.f * depth, (v - self.cy) / self.f * depth, depth, 0 * depth + 1], -1)
        out, way = np.zeros((*depth.shape, 3)), np.zeros(depth.shape)
        for p in np.unique(part):
            world = points[part == p] @ self.poses[a].T
            then = world @ (self.parts[b, p] @ np.linalg.inv(self.parts[a, p])).T
            way[part == p] = np.linalg.norm((then - world)[:, :3], axis=1)
            out[part == p] = (then @ np.linalg.inv(self.poses[b]).T)[:, :3]
        return out, way


def table(path):
    with path.open(encoding="utf-8", newline="") as f:
        return list(csv.DictReader(f))


def digests(folder):
    files = sorted(p for p in folder.rglob("*") if p.is_file())
    return {p.relative_to(folder).as_posix(): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}


def test_equal_calls_give_equal_bytes(tmp_path):
    asked = {"frames": 5, "seed": 4, "size": (60, 80), "noise": "nguyen", "pose_noise": (0.5, 1.0), "readout_s": 0.02}
    for name in ("a", "b"):
        simulate("bedroom", tmp_path / name, **asked)
    assert digests(tmp_path / "a") == digests(tmp_path / "b")
    simulate("bedroom", tmp_path / "c", **asked | {"seed": 5})
    assert digests(tmp_path / "a") != digests(tmp_path / "c")


def test_the_folder_is_what_was_promised(rendered):
    names = {p.name for p in (rendered.out / "truth").iterdir()}
    images = {"instances", "parts", "depth", "flow", "motion"}
    assert names == images | {"truth.json", "parts.csv", "part_poses.csv", "poses.txt", "objects.csv"}
    for kind in images:
        n = FRAMES - GAP if kind in ("flow", "motion") else FRAMES
        assert sorted(p.name for p in (rendered.out / "truth" / kind).glob("*.png")) == [
            f"{i:06d}.png" for i in range(n)
        ]
    assert rendered.about["format"] == "vlmm-log truth" and rendered.about["noise"]["model"] == "clean"
    assert (rendered.about["scene"], rendered.about["gap"], rendered.about["frames"]) == ("kitchen", GAP, FRAMES)
    labels = dict(
        line.split(maxsplit=1) for line in (rendered.out / "truth/instances/labels.txt").read_text().splitlines()
    )
    objects = table(rendered.out / "truth/objects.csv")
    assert {r["id"]: r["name"] for r in objects} == labels
    assert all((float(r["path_m"]) > 0) <= (r["kind"] != "still") for r in objects)


def test_flow_is_what_the_poses_say(rendered):
    for a in (0, 4):
        seen, _ = rendered.carried(a, a + GAP)
        flow, valid = rendered.flow(a)
        v, u = np.mgrid[0 : SIZE[0], 0 : SIZE[1]]
        expected = rendered.f * seen[..., :2] / seen[..., 2:] + [rendered.cx, rendered.cy] - np.stack([u, v], -1)
        assert valid.mean() > 0.8
        assert np.abs(expected - flow)[valid].max() < 0.05


def test_depth_where_the_flow_leads_is_the_same_surface(rendered):
    for a in (0, 4):
        seen, _ = rendered.carried(a, a + GAP)
        flow, valid = rendered.flow(a)
        v, u = np.mgrid[0 : SIZE[0], 0 : SIZE[1]].astype(np.float32)
        at = np.float32(flow) + np.stack([u, v], -1)
        inverse = (1 / rendered.depth(a + GAP)).astype(np.float32)  # linear in the image on a plane
        there = 1 / np.maximum(cv2.remap(inverse, at[..., 0], at[..., 1], cv2.INTER_LINEAR), 1e-3)
        part, nearby = rendered.image("parts", a), rendered.image("instances", a + GAP)
        one = cv2.erode(nearby, np.ones((5, 5))) == cv2.dilate(nearby, np.ones((5, 5)))  # no edge of a thing is near
        wanted = cv2.remap(np.where(one, nearby, 0).astype(np.uint16), at[..., 0], at[..., 1], cv2.INTER_NEAREST)
        same = valid & (wanted == rendered.image("instances", a))
        off = np.abs(there - seen[..., 2])
        assert np.median(off[same & (part == 0)]) < 5e-4
        assert np.percentile(off[same & (part == 0)], 95) < 2e-3
        assert np.median(off[same & (part > 0)]) < 4e-3  # round things, at this size


def test_motion_is_what_moved_against_the_world(rendered):
    _, way = rendered.carried(2, 2 + GAP)
    motion = rendered.image("motion", 2)
    assert set(np.unique(motion)) <= {0, 128, 255}
    assert (way[motion == 255] > 0.0099).all() and (way[motion == 0] < 0.0011).all()
    assert ((way[motion == 128] > 0.0009) & (way[motion == 128] < 0.0101)).all()
    assert 0.01 < (motion == 255).mean() < 0.25


def test_parts_belong_to_their_instances(rendered):
    kinds = {int(r["id"]): r["kind"] for r in table(rendered.out / "truth/objects.csv")}
    for i in range(FRAMES):
        parts, instances = rendered.image("parts", i), rendered.image("instances", i)
        for p in np.unique(parts[parts > 0]):
            assert set(np.unique(instances[parts == p])) == {rendered.owner[p]}
        assert all(kinds[k] == "still" for k in np.unique(instances[parts == 0]))
        assert (instances > 0).all(), "rooms are closed"


def test_the_reader_reads_it(rendered):
    frames = list(open_log(rendered.out).frames(0, 2**62))
    assert [frame.index for frame in frames] == list(range(FRAMES))
    f = 525 * SIZE[1] / 640
    assert np.allclose(frames[0].K, [[f, 0, (SIZE[1] - 1) / 2], [0, f, (SIZE[0] - 1) / 2], [0, 0, 1]])
    for frame, T, i in zip(frames, rendered.poses, range(FRAMES), strict=True):
        assert np.allclose(frame.T_world_cam, T, atol=2e-8)
        assert abs(frame.stamp_ns - (1000 + i / 30) * 1e9) < 1000
        assert np.nanmax(np.abs(frame.depth - rendered.depth(i))) < 2e-4  # 1/5000 m and 1/10000 m, rounded


@pytest.fixture(scope="module")
def hall():
    return build(drawn("living_room", 1, 3.0))


def test_rows_are_exposed_one_after_another(hall):
    size, lens, readout = (120, 160), Lens(131.25, 131.25, 79.5, 59.5), 0.03
    rolling = cast(hall, exposure(hall, 0.7, readout, size[0]), lens, size)
    for v in (0, 31, 60, 119):
        row = cast(hall, exposure(hall, 0.7 + (v / size[0] - 0.5) * readout, 0.0, size[0]), lens, size)
        assert np.allclose(rolling.depth[v], row.depth[v], atol=1e-5)
        assert (rolling.piece[v] == row.piece[v]).mean() > 0.99


def test_flow_is_exact_with_a_rolling_shutter(hall):
    size, readout = (120, 160), 0.03
    view = taken(studio(hall, size, Shutter(readout), DepthNoise(), 0), 12, 15)
    lens, H = Lens(131.25, 131.25, 79.5, 59.5), size[0]
    seen = exposure(hall, 12 / 30, readout, H)
    for v, u in [(5, 20), (60, 80), (110, 30), (70, 140), *zip(*np.nonzero(view.motion == 255), strict=True)][::40]:
        if not view.flow[v, u, 0]:
            continue
        at = np.array([u, v]) + (view.flow[v, u, 2:0:-1].astype(float) - 2**15) / 64
        part, z = view.parts[v, u], view.exact[v, u]
        ray = np.array([(u - lens.cx) / lens.fx * z, (v - lens.cy) / lens.fy * z, z, 1.0])
        then = exposure(hall, 15 / 30 + (at[1] / H - 0.5) * readout, 0.0, H)
        p = np.linalg.inv(then.T_part_cam[part, 0]) @ seen.T_part_cam[part, v] @ ray
        assert np.allclose(lens.fx * p[:2] / p[2] + [lens.cx, lens.cy], at, atol=0.05)


def test_depth_is_taken_later_where_that_is_asked_for(hall):
    size, lens = (120, 160), Lens(131.25, 131.25, 79.5, 59.5)
    view = taken(studio(hall, size, Shutter(0.0, 0.02), DepthNoise(), 0), 12, None)
    later = cast(hall, exposure(hall, 12 / 30 + 0.02, 0.0, size[0]), lens, size)
    assert np.array_equal(view.depth, later.depth) and not np.array_equal(view.exact, later.depth)
    assert view.flow is None and view.motion is None


@pytest.mark.parametrize("z", [0.8, 2.0, 4.0])
def test_sigma_is_the_stated_one(z):
    rng = np.random.default_rng(0)
    off = {m: measured(FLAT * z, FLAT, DepthNoise(m), 525.0, rng) - z for m in ("kinect_quadratic", "nguyen", "clean")}
    assert np.std(off["kinect_quadratic"]) == pytest.approx(0.0012 + 0.0028 * z**2, rel=0.03)
    assert np.std(off["nguyen"]) == pytest.approx(0.0012 + 0.0019 * (z - 0.4) ** 2, rel=0.03)
    assert not off["clean"].any()
    assert quadratic_sigma(np.float32(z)) == pytest.approx(0.0012 + 0.0028 * z**2)


def test_slanted_surfaces_are_noisier():
    slant = np.cos(np.deg2rad(np.array([0.0, 60.0, 75.0, 82.0, 89.0], np.float32)))
    sigma = nguyen_sigma(np.full(5, 2.0, np.float32), slant)
    theta = np.deg2rad(75)
    expected = 0.0012 + 0.0019 * 1.6**2 + 0.0001 / np.sqrt(2) * theta**2 / (np.pi / 2 - theta) ** 2
    assert sigma[2] == pytest.approx(expected, rel=1e-3)
    assert np.all(np.diff(sigma[:4]) > 0) and sigma[4] == pytest.approx(sigma[3], rel=1e-3)


def test_neighbours_are_correlated_a_little():
    noise = measured(FLAT * 2, FLAT, DepthNoise("kinect_quadratic"), 525.0, np.random.default_rng(1)) - 2
    near, far = (np.corrcoef(noise[:, :-k].ravel(), noise[:, k:].ravel())[0, 1] for k in (1, 4))
    assert 0.2 < near < 0.7 and abs(far) < 0.03


def test_disparity_comes_in_steps():
    rng, z, reach = np.random.default_rng(2), 3.0, 0.075 * 525
    exact = np.full(FLAT.shape, reach / np.arange(8, 8.125, 0.125 / 320)[: FLAT.shape[1]], np.float32) * 0 + z
    exact = reach / (reach / exact + np.linspace(0, 0.125, FLAT.shape[1], dtype=np.float32))  # over a whole step
    steps = reach / measured(exact.astype(np.float32), FLAT, DepthNoise("disparity"), 525.0, rng) / 0.125
    assert np.allclose(steps, np.rint(steps), atol=1e-3)
    assert np.std(steps - reach / exact / 0.125) == pytest.approx(np.sqrt(0.25 + 1 / 12), rel=0.03)


def test_flying_pixels_lie_between():
    z = np.where(np.arange(320) < 160, np.float32(1), np.float32(3)) * FLAT
    got = measured(z, FLAT, DepthNoise("clean", flying=0.4), 525.0, np.random.default_rng(3))
    edge = got[:, 159:161]
    assert np.mean((edge > 1) & (edge < 3)) == pytest.approx(0.4, abs=0.05)
    assert np.array_equal(got[:, :159], z[:, :159]) and np.array_equal(got[:, 161:], z[:, 161:])


def test_holes_are_in_the_shadow_and_where_it_is_grazed():
    z = np.where((np.arange(320) > 150) & (np.arange(320) < 200), np.float32(1.5), np.float32(3)) * FLAT
    got = measured(z, FLAT, DepthNoise("clean", holes=0.8), 525.0, np.random.default_rng(4))
    width = sensor_noise.BASELINE_M * 525 * (1 / 1.5 - 1 / 3)
    lost = (got == 0).mean(0)
    assert lost.sum() == pytest.approx(0.8 * width, abs=1.5) and lost[:130].sum() == 0 and lost[151:].sum() == 0
    grazed = measured(FLAT * 2, FLAT * np.float32(0.1), DepthNoise("clean", holes=0.5), 525.0, np.random.default_rng(5))
    assert (grazed == 0).mean() == pytest.approx(0.5, abs=0.02)
    blobs = measured(FLAT * 2, FLAT, DepthNoise("clean", blobs=6), 525.0, np.random.default_rng(6))
    assert 20 < (blobs == 0).sum() < 1500


def test_noise_that_does_not_exist_is_refused():
    assert sensor("clean") == DepthNoise() and sensor("nguyen").holes == 0.9 and sensor("nguyen", holes=0.0).holes == 0
    for wrong in ({"model": "gauss"}, {"flying": 1.5}, {"holes": -0.1}, {"blobs": -1}):
        with pytest.raises(InputError):
            DepthNoise(**wrong)


def test_pose_noise_is_the_stated_one(tmp_path):
    simulate("living_room", tmp_path / "a", frames=300, size=(16, 20), pose_noise=(1.0, 2.0), gap=300)
    truth = Truth(tmp_path / "a")
    rows = np.loadtxt(tmp_path / "a/groundtruth.txt")
    off = np.linalg.inv(truth.poses) @ se3.from_quaternion(rows[:, 1:4], rows[:, 4:])
    assert np.std(off[:, :3, 3]) == pytest.approx(0.02, rel=0.08)
    assert np.std([se3.log(T)[:3] for T in off]) == pytest.approx(np.deg2rad(1.0), rel=0.08)
    still = [r for r in table(tmp_path / "a/truth/objects.csv") if r["kind"] == "still"]
    assert all(float(r["path_m"]) == 0 for r in still)


def test_scenes_hold_many_things_that_move_and_that_do_not():
    known, lens, size = read_table(), Lens(525, 525, 319.5, 239.5), (480, 640)
    seen, types = 0, set()
    for name in SCENES:
        scene = drawn(name, 0, 3.0)
        world = build(scene)
        pixels = np.zeros(len(scene.things) + 1, int)
        for t in (0.0, 0.9, 1.8, 2.7):
            hits = cast(world, exposure(world, t, 0.0, size[0]), lens, size)
            assert hits.depth.min() > 0.3 and hits.depth.max() < 6.4 and (hits.depth > 2.5).mean() > 0.4
            pixels = np.maximum(pixels, np.bincount(world.instance[hits.piece].ravel(), minlength=len(pixels)))
        assert {thing.name for thing in scene.things} <= set(known)
        visible = [thing for thing, n in zip(scene.things, pixels[1:], strict=True) if n >= 500]
        movers = [thing for thing in visible if thing.kind != "still"]
        assert (
            4 <= len(movers) <= 7
            and len({thing.kind for thing in movers}) >= 4
            and 0.1 < len(movers) / len(visible) < 0.2
        )
        assert 0.35 < np.mean([known[thing.name].rho >= 0.55 for thing in visible]) < 0.65
        types |= {thing.name for thing in visible if known[thing.name].source.endswith("AI2-THOR")}
        seen += len(visible)
    assert seen >= 67 and len(types) >= 25


@pytest.mark.parametrize("name", SCENES)
def test_every_seed_makes_a_scene_whose_movers_move_most_of_the_time(name):
    t = np.arange(90) / 30
    for seed in range(12):
        for thing in drawn(name, seed, 3.0).things:
            if thing.kind != "still":
                motion, mark = thing.bodies[0].motion, np.array([*thing.mark, 1.0])
                speed = np.linalg.norm(np.diff((motion(t) @ mark)[:, :3], axis=0), axis=1) * 30
                assert np.mean(speed > 0.1) > 0.55 and speed.max() < 1.0, (seed, thing.name)


def test_an_existing_folder_is_replaced_only_by_force(tmp_path):
    asked = {"frames": 1, "size": (16, 20)}
    simulate("kitchen", tmp_path / "a", **asked)
    with pytest.raises(InputError, match="--force"):
        simulate("kitchen", tmp_path / "a", **asked)
    simulate("bedroom", tmp_path / "a", force=True, **asked)
    assert json.loads((tmp_path / "a/truth/truth.json").read_text())["scene"] == "bedroom"
    assert [p.name for p in tmp_path.iterdir()] == ["a"]


@pytest.mark.parametrize(
    "wrong", [{"frames": 0}, {"seed": -1}, {"gap": 0}, {"readout_s": 1.0}, {"pose_noise": (-1, 0)}, {"size": (4, 4)}]
)
def test_what_cannot_be_is_refused(tmp_path, wrong):
    with pytest.raises(InputError):
        simulate("kitchen", tmp_path / "a", **{"frames": 1, **wrong})
    assert not list(tmp_path.iterdir())


def test_without_open3d_it_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "open3d", None)
    with pytest.raises(InputError, match=r"pip install 'vlmm-log\[sim\]'"):
        simulate("kitchen", tmp_path / "a", frames=1, size=(16, 20))


def ran(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [str(Path(sys.executable).with_name("vlmm-log")), "simulate", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=120)


def test_command_line(tmp_path):
    done = ran("bedroom", tmp_path / "a", "--frames", 2, "--gap", 1, "--noise", "disparity", "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["frames"] == 2
    assert json.loads((tmp_path / "a/truth/truth.json").read_text())["noise"]["flying"] == 0.3
    for wrong in (
        ["attic", tmp_path / "b"],
        ["kitchen", tmp_path / "a"],
        ["kitchen", tmp_path / "b", "--pose-noise", "1"],
    ):
        failed = ran(*wrong)
        assert failed.returncode == 2 and len(failed.stderr.strip().splitlines()) == 1
        assert failed.stdout == ""


@pytest.mark.parametrize("raised", [OSError, ImportError])
def test_where_a_system_library_is_missing_the_line_that_installs_it_is_told(tmp_path, monkeypatch, raised):
    fake = tmp_path / "open3d"
    fake.mkdir()
    said = "libGL.so.1: cannot open shared object file: No such file or directory"
    (fake / "__init__.py").write_text(f"raise {raised.__name__}({said!r})")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "open3d", raising=False)
    with pytest.raises(InputError, match=r"libGL\.so\.1.* apt-get install .*libgl1"):
        simulate("kitchen", tmp_path / "room", frames=1, size=(16, 20))
    assert not (tmp_path / "room").exists()
