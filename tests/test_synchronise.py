"""Approximate-time synchronisation: the stream's pairs are those of the whole lists, with a bounded memory."""

from hypothesis import given
from hypothesis import strategies as st

from vlmm_log.readers.bag.synchronise import LATENESS_NS, synchronised
from vlmm_log.readers.stamps import associate
from vlmm_log.readers.stored import Shot
from vlmm_log.types import Skipped

MS = 1_000_000


def shot(kind, stamp_ns, index=0):
    return Shot(kind, stamp_ns, index, f"{kind} {index}", lambda: None)


def stream(rgb, depth, latency=0):
    """Images in the order in which they would be recorded, depth ``latency`` ns after colour of the same stamp."""
    shots = [(t, shot("rgb", t, k)) for k, t in enumerate(rgb)]
    shots += [(t + latency, shot("depth", t, k)) for k, t in enumerate(depth)]
    return [x for _, x in sorted(shots, key=lambda s: (s[0], s[1].kind))]


def paired(shots, tolerance_ns):
    items = list(synchronised(shots, tolerance_ns))
    pairs = [(x[0].stamp_ns, x[1].stamp_ns) for x in items if not isinstance(x, Skipped)]
    return pairs, [x for x in items if isinstance(x, Skipped)]


stamps = st.lists(st.integers(0, 400), unique=True, max_size=40).map(sorted).map(lambda x: [t * MS for t in x])


@given(stamps, stamps, st.integers(0, 60), st.integers(-300, 300))
def test_the_pairs_are_those_of_the_whole_lists(rgb, depth, tolerance, latency):
    pairs, left_out = paired(stream(rgb, depth, latency * MS), tolerance * MS)
    wanted = [(rgb[i], depth[j]) for i, j in associate(rgb, depth, tolerance * MS)]
    assert sorted(pairs) == sorted(wanted)
    assert len(left_out) == len(rgb) + len(depth) - 2 * len(wanted)
    assert [d for _, d in pairs] == sorted(d for _, d in pairs)


def test_a_message_is_used_once_and_the_nearest_wins():
    pairs, left_out = paired(stream([0, 30 * MS], [20 * MS]), 25 * MS)
    assert pairs == [(30 * MS, 20 * MS)]
    assert [(x.what, x.index) for x in left_out] == [("rgb 0", 0)]


def test_little_is_held_back_when_one_topic_falls_silent():
    held = []

    def counted():
        yield shot("depth", 0)
        for k in range(1000):
            held.append(k)
            yield shot("rgb", k * 30 * MS, k)

    most = told = 0
    for item in synchronised(counted(), 20 * MS):
        told += 1 if isinstance(item, Skipped) else 2
        most = max(most, len(held) + 1 - told)
    assert most < 2 * LATENESS_NS / (30 * MS)


def test_a_repeated_stamp_and_a_late_image_are_told():
    shots = [
        shot("rgb", 0, 0),
        shot("rgb", 0, 1),
        shot("depth", 5 * MS),
        shot("rgb", 90 * MS, 2),
        shot("rgb", 60 * MS, 3),
    ]
    shots += [shot("depth", 61 * MS, 1)]
    pairs, left_out = paired(shots, 20 * MS)
    assert pairs == [(0, 5 * MS), (60 * MS, 61 * MS)]
    assert [x.reason for x in left_out] == [
        "stamp repeated",
        "stamp out of order; the image was sorted in",
        "no depth image within 0.02 s",
    ]


def test_a_straggler_does_not_bring_frames_out_of_order():
    """What was around it has been given out; the clock itself is set back where several come so late in a row."""
    both = [shot(kind, k * 100 * MS, k) for k in range(60) for kind in ("rgb", "depth")]
    stragglers = [shot("rgb", 1050 * MS, 60), shot("depth", 1050 * MS, 60)]
    for shots in ([*both[:80], *stragglers, *both[80:]], [*both, *stragglers]):
        pairs, left_out = paired(shots, 20 * MS)
        assert pairs == [(k * 100 * MS,) * 2 for k in range(60)]
        assert {(x.stamp_ns, x.reason) for x in left_out} == {(1050 * MS, "image comes too late: by over 2 s")}
        assert len(left_out) == 2
    again = [shot(kind, k * 100 * MS, k) for k in range(60, 70) for kind in ("rgb", "depth")]
    back = [shot(x.kind, x.stamp_ns - 5900 * MS, x.index) for x in again]
    pairs, left_out = paired([*both, *back], 20 * MS)
    assert len(pairs) == 70
    assert [x.reason for x in left_out] == ["clock of the stamps was set back here"]


def test_losses_pass_through_at_their_time():
    shots = [
        shot("rgb", 0),
        shot("depth", 0),
        Skipped(50 * MS, "chunk", "fails its CRC"),
        shot("rgb", 99 * MS),
        shot("depth", 99 * MS),
    ]
    kinds = [isinstance(x, Skipped) for x in synchronised(shots, 10 * MS)]
    assert kinds == [False, True, False]
