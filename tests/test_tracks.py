"""Association: who is who from frame to frame."""

import numpy as np
import pytest

from vlmm_log.elements import OBSERVATION, Sightings
from vlmm_log.pipeline.tracks import Carried, Tracks, _overlaps, associate, carrying, remember
from vlmm_log.settings import TrackSettings
from vlmm_log.types import Features, FlowField, Frame, FramePair, Segments

H, W = 60, 80
STEP_NS = 33_000_000
S = TrackSettings()


def scene(boxes, *, names=None, positions=None, identities=None, features=None):
    """Instances that are boxes (v, u, height, width)."""
    n = len(boxes)
    labels = np.zeros((H, W), np.int32)
    rows = np.zeros(n, OBSERVATION)
    for k, (v, u, h, w) in enumerate(boxes):
        labels[v : v + h, u : u + w] = k + 1
        rows["position"][k] = (0.01 * (u + w / 2), 0.01 * (v + h / 2), 1.0)
        rows["pixels"][k] = h * w
        rows["extent"][k, [0, 3, 5]] = (0.01 * w) ** 2 / 12, (0.01 * h) ** 2 / 12, 1e-4
    if positions is not None:
        rows["position"] = positions
    ids = np.full(n, -1, np.int64) if identities is None else np.array(identities, np.int64)
    segments = Segments(labels, tuple(names or [""] * n), np.ones(n, np.float32), ids)
    vectors = np.zeros((n, 4), np.float32) if features is None else np.array(features, np.float32)
    return Sightings(segments, rows, np.zeros((n, 4), np.int32), np.ones(n, np.bool_)), Features(vectors)


def follow(scenes, *, flow=(0.0, 0.0), gap=1, s=S, step_ns=STEP_NS):
    """Ids of each scene in turn; the image moves by ``flow`` a frame."""
    tracks, found = Tracks(), []
    for t, (sightings, features) in enumerate(scenes):
        tracked = associate(sightings, features, tracks, t * step_ns, s)
        image = np.zeros((H, W, 3), np.uint8)
        depth = np.ones((H, W), np.float32)
        frames = [Frame(k * step_ns, k, image, depth, np.eye(3)) for k in (t, t + gap)]
        forward = np.zeros((H, W, 2), np.float32)
        forward[:] = np.array(flow) * gap
        tracks = remember(tracks, tracked, FramePair(*frames), carrying(FlowField(forward, -forward, depth)), s)
        found.append(tracked.ids.tolist())
    return found


@pytest.mark.parametrize("gap", [1, 2, 3])
def test_masks_are_carried_by_the_flow_whatever_the_gap(gap):
    """Far apart in 3-D at each step, so that only the carried mask tells."""
    boxes = [[(10, 5 + 9 * t, 12, 10), (40, 5 + 9 * t, 12, 10)] for t in range(5)]
    scenes = [scene(b, positions=[[7.0 * t, 0, 0], [7.0 * t, 5, 0]]) for t, b in enumerate(boxes)]
    assert follow(scenes, flow=(9.0, 0.0), gap=gap) == [[1, 2]] * 5


def test_the_order_of_instances_does_not_matter():
    a, b = (10, 5, 12, 10), (40, 30, 12, 10)
    found = follow([scene([a, b]), scene([b, a]), scene([a, b])])
    assert found == [[1, 2], [2, 1], [1, 2]]


def test_an_element_is_found_again_after_a_gap_by_place_and_label():
    door, cup = (5, 5, 40, 20), (30, 50, 10, 10)
    gone = [scene([door], names=["door"])] * 4
    scenes = [scene([door, cup], names=["door", "cup"]), *gone, scene([door, cup], names=["door", "cup"])]
    assert follow(scenes)[-1] == [1, 2]


def test_something_else_in_the_same_place_after_a_gap_is_new():
    cup = (30, 50, 10, 10)
    features = np.eye(4)[:2]
    scenes = [
        scene([cup], names=["cup"], features=features[:1]),
        scene([]),
        scene([(5, 5, 8, 8)], names=["cat"], features=features[1:]),
    ]
    assert follow(scenes)[-1] == [2]


def test_an_element_unseen_for_long_is_forgotten_by_the_tracks():
    box = (30, 50, 10, 10)
    scenes = [scene([box], names=["cup"]), *[scene([])] * 3, scene([box], names=["cup"])]
    assert follow(scenes, s=TrackSettings(forget_s=0.2))[-1] == [1]
    assert follow(scenes, s=TrackSettings(forget_s=0.01))[-1] == [2]


def test_a_label_that_flips_keeps_the_element():
    box = (10, 10, 30, 30)
    scenes = [scene([box], names=[name], features=[np.eye(4)[k]]) for k, name in enumerate(["tv", "laptop", "tv"])]
    assert follow(scenes) == [[1]] * 3


def test_given_identities_bypass_it_all():
    a, b = (10, 5, 12, 10), (40, 30, 12, 10)
    scenes = [scene([a, b], identities=[7, 3]), scene([b, a], identities=[7, 3])]
    assert follow(scenes) == [[7, 3], [7, 3]]


def test_new_elements_never_take_a_given_identity():
    a, b = (10, 5, 12, 10), (40, 30, 12, 10)
    scenes = [scene([a, b], identities=[5, -1]), scene([(20, 60, 8, 8)], identities=[-1], positions=[[9, 9, 9]])]
    assert follow(scenes) == [[5, 6], [7]]


def test_one_instance_an_element_and_one_element_an_instance():
    rng = np.random.default_rng(0)
    scenes = []
    for _ in range(30):
        n = rng.integers(0, 8)
        boxes = [(*rng.integers(0, 40, 2), *rng.integers(4, 20, 2)) for _ in range(n)]
        scenes.append(scene(boxes, names=list(rng.choice(["cup", "chair", ""], n))))
    for ids in follow(scenes):
        assert len(set(ids)) == len(ids)


def test_a_mask_without_depth_is_followed_by_overlap():
    box = (10, 10, 30, 30)
    unseen = [[np.nan] * 3]
    scenes = [scene([box]), scene([box], positions=unseen), scene([box], positions=unseen)]
    assert follow(scenes) == [[1]] * 3
    assert follow([scene([box], positions=unseen)] * 4) == [[1]] * 4


def test_a_good_match_is_not_given_up_for_two_poor_ones():
    """Similarities .6 and .34 against .3 and 0: the sum of the poor ones is larger, and both are too poor to hold."""
    far = np.array([[0.0, 0, 0], [50.0, 0, 0]])
    a, b = scene([(0, 0, 30, 30), (30, 40, 20, 20)], positions=far, names=["a", "b"])
    c, d = scene([(0, 9, 30, 30), (0, 0, 30, 9)], positions=far[::-1] + 500.0, names=["a", "b"])
    s = TrackSettings(position_weight=0.0, feature_weight=0.0, min_similarity=0.35)
    found = follow([(a, b), (c, d)], s=s)
    assert found[1][0] == 1 and found[1][1] not in (1, 2)


def test_what_was_never_lost_outranks_what_is_found_again():
    """A second chair stood in the same place long ago; the one that is followed keeps the instance."""
    box = (10, 10, 30, 30)
    here = [[0.25, 0.25, 1.0]]
    ghost = scene([(0, 50, 20, 20)], names=["chair"], positions=here)
    chair = scene([box], names=["chair"], positions=[[0.4, 0.25, 1.0]])
    shrunk = scene([(10, 10, 30, 25)], names=["chair"], positions=here)
    found = follow([ghost, scene([]), chair, chair, shrunk])
    assert found[3] == found[2] == found[4]


def test_a_mask_that_shrinks_does_not_outweigh_the_rest():
    """Sixteen pixels land on each: their number is no overlap."""
    v, u = np.mgrid[0:H, 0:W]
    flow = np.stack([(25 + (u - 10) // 4) - u, (25 + (v - 10) // 4) - v], axis=-1).astype(np.float32)
    before, _ = scene([(10, 10, 40, 40)])
    carried = Carried(before.segments.labels, np.array([1]), carrying(FlowField(flow, flow, flow[..., 0])), 0, STEP_NS)
    after, _ = scene([(25, 25, 10, 10)])
    overlap, known = _overlaps(after, carried, [1], STEP_NS)
    assert known.all() and 0 < overlap[0, 0] <= 1


def test_an_element_is_forgotten_on_time_even_in_the_next_pair():
    box = (30, 50, 10, 10)
    scenes = [scene([box], names=["cup"]), scene([box], names=["cup"])]
    assert follow(scenes, s=TrackSettings(forget_s=1.0), step_ns=10**12) == [[1], [2]]
    assert follow(scenes, s=TrackSettings(forget_s=2000.0), step_ns=10**12) == [[1], [1]]
