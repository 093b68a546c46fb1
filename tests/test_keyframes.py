"""Which frames are compared, and reading ahead."""

import itertools
import threading
import time
from contextlib import closing

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vlmm_log.pipeline.keyframes import LONGEST_GAP, Gap, pairs, prefetched
from vlmm_log.settings import KeyframeSettings
from vlmm_log.types import Frame, FramePair, InputError, Skipped

MS = 1_000_000


def frame(index, stamp_ns=None):
    stamp_ns = 100 * MS * index if stamp_ns is None else stamp_ns
    return Frame(stamp_ns, index, np.zeros((1, 1, 3), np.uint8), np.ones((1, 1), np.float32), np.eye(3))


def left_out(name):
    return Skipped(0, name, "left out")


def told(stream, gap, stride=1):
    """Pairs as (first, second), what was left out as its text."""
    results = pairs(stream, KeyframeSettings(stride=stride, gap=gap))
    return [(x.first.index, x.second.index) if isinstance(x, FramePair) else f"{x.what}: {x.reason}" for x in results]


@given(st.integers(0, 20), st.integers(1, 8), st.integers(1, 5))
def test_gap_in_frames(n, gap, stride):
    starts = range(0, n, stride)
    expected = [(i, i + gap) for i in starts if i + gap < n]
    expected += [f"pair of frame {i}: no frame {gap} frames later" for i in starts if i + gap >= n]
    assert told(map(frame, range(n)), gap, stride) == told(map(frame, range(n)), str(gap), stride) == expected


@given(st.lists(st.integers(1, 250), max_size=20), st.integers(1, 400), st.integers(1, 4))
def test_gap_in_seconds(steps_ms, gap_ms, stride):
    stamps = list(itertools.accumulate(steps_ms, initial=0))
    expected = []
    for i in range(0, len(stamps), stride):
        misses = [(abs(stamps[j] - stamps[i] - gap_ms), j) for j in range(i + 1, len(stamps))]
        miss, j = min(misses, default=(gap_ms, 0))
        none = f"pair of frame {i}: no frame {gap_ms / 1e3:g} s later"
        expected.append((i, j) if 2 * miss <= gap_ms else none)
    stream = [frame(k, t * MS) for k, t in enumerate(stamps)]
    assert told(stream, f"{gap_ms / 1e3}s", stride) == expected


@pytest.mark.parametrize("gap", [2, "0.2s"])
def test_no_pair_spans_a_clock_that_was_set_back(gap):
    before = [frame(k, 3_600_000 * MS + k * 100 * MS) for k in range(4)]
    after = [frame(k, (k - 4) * 100 * MS) for k in range(4, 8)]
    expected = told(before, gap) + told(after, gap)
    assert (0, 2) in expected
    assert told([*before, *after], gap) == expected


def test_what_was_left_out_is_passed_on_in_order():
    stream = [left_out("a"), frame(0), left_out("b"), frame(1), frame(2), left_out("c")]
    assert told(stream, 1) == [
        "a: left out",
        "b: left out",
        (0, 1),
        (1, 2),
        "c: left out",
        "pair of frame 2: no frame 1 frames later",
    ]


@given(st.lists(st.booleans(), max_size=30), st.sampled_from([1, 3, "0.1s", "0.25s"]), st.integers(1, 3))
def test_order_is_kept_and_frames_left_out_do_not_count(kinds, gap, stride):
    stream = [frame(k) if is_frame else left_out(str(k)) for k, is_frame in enumerate(kinds)]
    results = list(pairs(stream, KeyframeSettings(stride=stride, gap=gap)))
    passed = [x for x in results if isinstance(x, Skipped) and x.reason == "left out"]
    assert passed == [x for x in stream if isinstance(x, Skipped)]
    starts = [x.first.index if isinstance(x, FramePair) else x.index for x in results if x not in passed]
    assert starts == [x.index for x in stream if isinstance(x, Frame)][::stride]


def test_pairs_come_as_soon_as_they_can():
    stream = iter([frame(0), frame(1), frame(2), frame(3)])
    first = next(pairs(stream, KeyframeSettings(gap=2)))
    assert (first.first.index, first.second.index) == (0, 2)
    assert next(stream).index == 3


def test_a_frame_without_partner_says_which_and_when():
    results = list(pairs([frame(7, 5 * MS)], KeyframeSettings(gap="0.5s")))
    assert results == [Skipped(5 * MS, "pair of frame 7", "no frame 0.5 s later", 7)]


def test_the_longest_gap():
    stream = [frame(k, k * MS) for k in range(LONGEST_GAP + 2)]
    n = LONGEST_GAP
    for gap in (n, f"{n / 1e3}s"):
        assert told(stream, gap)[:2] == [(0, n), (1, n + 1)]
    with pytest.raises(InputError, match="spans more than 300 frames"):
        told(stream, "60s")


@pytest.mark.parametrize(
    ("gap", "parsed"),
    [(3, Gap(3)), ("3", Gap(3)), (" 3 ", Gap(3)), ("0.1s", Gap(0, 100 * MS)), ("1e-9s", Gap(0, 1))],
)
def test_gap(gap, parsed):
    assert Gap.parse(gap) == parsed


@pytest.mark.parametrize(
    "gap",
    [
        0,
        -1,
        301,
        "0",
        "301",
        "x",
        "",
        "s",
        "-1s",
        "0s",
        "1e-10s",
        "nans",
        "infs",
        "1e400s",
        "1e300s",
        "3.5",
        "3 ms",
    ],
)
def test_what_is_no_gap_is_told(gap):
    with pytest.raises(
        InputError, match=r"^keyframes\.gap = .*give 1 to 300 frames, as in 3, or seconds, as in '0.1s'$"
    ):
        Gap.parse(gap)


@given(st.one_of(st.text(), st.text().map(lambda t: t + "s"), st.floats().map(lambda x: f"{x}s")))
def test_any_text_is_a_gap_or_an_input_error(text):
    try:
        gap = Gap.parse(text)
    except InputError:
        return
    assert (gap.frames > 0) != (gap.ns > 0)


# ---- reading ahead


def no_thread_left():
    return "prefetch" not in [t.name for t in threading.enumerate()]


@given(st.lists(st.one_of(st.integers(), st.none(), st.just("end")), max_size=12), st.integers(1, 4))
def test_prefetched_gives_the_same(items, ahead):
    assert list(prefetched(iter(items), ahead)) == items
    assert no_thread_left()


@pytest.mark.parametrize("error", [ValueError, InputError, KeyboardInterrupt, SystemExit])
@pytest.mark.parametrize("ahead", [1, 4])
def test_an_error_in_the_source_is_raised_where_it_is_read(error, ahead):
    def source():
        yield from range(3)
        raise error("broken")

    seen = []
    with pytest.raises(error, match="broken"):
        for item in prefetched(source(), ahead):
            seen.append(item)  # noqa: PERF402
    assert seen == [0, 1, 2]
    assert no_thread_left()


@pytest.mark.parametrize("consumed", [0, 1, 5])
def test_closing_early_stops_the_thread(consumed):
    with closing(prefetched(itertools.count(), 2)) as stream:
        assert list(itertools.islice(stream, consumed)) == list(range(consumed))
    assert no_thread_left()


def test_an_error_of_the_reader_stops_the_thread():
    with pytest.raises(ZeroDivisionError), closing(prefetched(itertools.count(), 2)) as stream:
        for item in stream:
            1 / item
    assert no_thread_left()


@pytest.mark.parametrize("ahead", [1, 3])
def test_reading_ahead_is_bounded(ahead):
    produced = 0
    filled = threading.Semaphore(0)

    def source():
        nonlocal produced
        for k in itertools.count():
            produced += 1
            filled.release()
            yield k

    with closing(prefetched(source(), ahead)) as stream:
        for consumed in range(1, 8):
            next(stream)
            for _ in range(1 if consumed > 1 else ahead + 1):
                assert filled.acquire(timeout=30)  # it does read ahead
            assert produced <= consumed + ahead + 2
        time.sleep(0.3)
        assert produced <= 7 + ahead + 2
