"""Fields in steps: what a recording keeps of d_M and the like."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hn

from vlmm_log import rvl
from vlmm_log.readers import compressed_depth

numbers = st.one_of(st.just(float("nan")), st.floats(0, 2000, width=32), st.just(float("inf")))
fields = hn.arrays(np.float32, hn.array_shapes(min_dims=2, max_dims=2, max_side=30), elements=numbers)


@given(fields, st.sampled_from([2.0**-6, 2.0**-13, 0.1]))
def test_a_field_comes_back_to_the_nearest_step(field, step):
    back = rvl.decode_steps(rvl.encode_steps(field, step), step)
    assert back.shape == field.shape
    np.testing.assert_array_equal(np.isnan(back), np.isnan(field))
    seen = ~np.isnan(field)
    held = np.clip(field[seen], step, 65535 * step)
    np.testing.assert_allclose(back[seen], held, rtol=1e-3, atol=0.502 * step)


def test_noise_of_all_sizes_comes_back():
    rng = np.random.default_rng(0)
    for most in (2, 9, 70, 600, 70_000):
        counts = rng.integers(0, min(most, 65536), (97, 131)).astype(np.uint16)
        np.testing.assert_array_equal(rvl.decode(rvl.encode(counts), counts.size).reshape(counts.shape), counts)


def test_the_image_is_one_that_ros_reads():
    field = np.random.default_rng(1).random((40, 50)).astype(np.float32)
    counts = compressed_depth.decode(rvl.encode_steps(field, 2.0**-8), "16UC1; compressedDepth rvl")
    np.testing.assert_allclose(counts / 256, np.maximum(field, 1 / 256), atol=0.5 / 256 + 1e-6)


def test_any_layout_of_the_array_is_read_as_its_values():
    whole = np.random.default_rng(2).random((60, 80)).astype(np.float32)
    for part in (whole[::2, ::3], whole.T, whole[::-1]):
        back = rvl.decode_steps(rvl.encode_steps(part, 2.0**-10), 2.0**-10)
        np.testing.assert_allclose(back, np.maximum(part, 2.0**-10), atol=2.0**-11)


@pytest.mark.parametrize("cut", [0, 10, 19, 25])
def test_a_damaged_image_is_told(cut):
    image = rvl.encode_steps(np.random.default_rng(3).random((20, 20)).astype(np.float32), 0.01)
    with pytest.raises(ValueError, match="RVL"):
        rvl.decode_steps(image[:cut], 0.01)


def test_a_damaged_size_asks_for_no_memory():
    image = bytearray(rvl.encode_steps(np.ones((4, 4), np.float32), 0.01))
    image[12:20] = b"\xff\xff\xff\x7f" * 2
    with pytest.raises(ValueError, match="damaged size"):
        rvl.decode_steps(bytes(image), 0.01)
