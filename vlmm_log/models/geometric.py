"""Class-agnostic segments from the depth image alone: planes, and what depth steps part from them. No weights.

In inverse depth w = 1/z a plane is linear in pixel coordinates, a straight line stays straight, and the noise of a
structured-light or stereo sensor is about the same near and far (sigma_z grows with z^2). One number then tells
where surfaces meet: the second difference w(u - s) - 2 w(u) + w(u + s) is 0 on a plane, negative on a ridge, and
positive in a concave crease and behind a depth step. Cutting where it is positive leaves convex pieces (Uckermann et
al., IROS 2012; Tateno et al., IROS 2015). Pieces that meet in a crease are then joined unless one of them is a large
plane: a table and what stands on it stay two, head and shoulders become one.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from vlmm_log.compiled import jit
from vlmm_log.types import Float32, Float64, Frame, Int32, Int64, Segments

Bools = NDArray[np.bool_]
WORKING_WIDTH = 320  # px: the depth image is thinned to about this width; Kinect depth resolves no more
SMOOTHING = 5  # px, side of the mean: quantised disparity makes steps of .003 / m
ARM = 4  # px, s above: beyond the smoothing. Longer arms part wall and floor more surely, and head and torso too
DIAGONAL_ARM = 3  # px each way, about the same length
CREASE = 0.008  # 1/m, second difference that cuts; about 5 times the .0017 / m of one pixel from 0.9 m on
MISSING = np.float32(-100.0)  # 1/m, in place of unseen inverse depth: an arm that ends there is never concave
SMALLEST = 38  # px of the working image, about 150 of a 640x480 one: smaller seeds start no segment
FLAT = CREASE  # 1/m, rms distance from the fitted plane: less than what makes a crease
FLAT_SHARE = 0.02  # of the image: smaller pieces of anything look flat
SUPPORT_SHARE = 0.25  # of the image: a piece this large is what things stand on or before, flat or not
STEP = 0.02  # 1/m across the seam of two pieces, 2 px: more is a depth step, 2 cm at 1 m
SEAM = 4  # px, and SEAM_SHARE of the common border must be without a step to join two pieces
SEAM_SHARE = 0.6
FLAT_NAME = "flat surface"  # not "plane": a word model reads that as an aircraft
LEVELS = 100.0  # grey levels for 1/m in the flooding: one is .01 / m, about a crease, and 2.55 / m (0.4 m) the last


class Geometric:
    """The segmenter."""

    def __call__(self, frame: Frame) -> Segments:
        """Surfaces between creases and depth steps, in the order of their topmost pixel; a large plane is named flat.

        Pixels without depth, and the seam between two segments, belong to none.
        """
        H, W = frame.depth.shape
        stride = max(1, round(W / WORKING_WIDTH))
        inverse = inverse_depth(frame.depth[::stride, ::stride])
        pieces, count = flooded(inverse, concavity(smoothed(inverse)))
        flat = flat_ones(pieces[::2, ::2], inverse[::2, ::2], count)
        firsts, number = np.unique(joined(pieces, inverse, flat), return_inverse=True)
        n = firsts.size - 1  # the first is "none"
        full = number.astype(np.int32)[pieces].repeat(stride, 0).repeat(stride, 1)[:H, :W].copy()
        full[np.isnan(frame.depth)] = 0
        names = tuple(FLAT_NAME if flat[k] else "" for k in firsts[1:])
        notes = () if n else ("geometric: no surface in the depth image",)
        return Segments(full, names, np.ones(n, np.float32), np.full(n, -1, np.int64), notes, partition=True)


def inverse_depth(depth: Float32) -> Float32:
    """1/z (h, w) 1/m; 0 where unseen."""
    return np.asarray(np.nan_to_num(np.float32(1) / depth, nan=0.0), np.float32)


def smoothed(inverse: Float32) -> Float32:
    """Mean of the seen neighbours; MISSING where less than a third of them is seen."""
    side = (SMOOTHING, SMOOTHING)
    seen = cv2.blur((inverse > 0).astype(np.float32), side)
    return np.where(seen > 1 / 3, cv2.blur(inverse, side) / np.maximum(seen, 1 / 3), MISSING)


def concavity(inverse: Float32) -> Float32:
    """Largest second difference over four directions, 1/m."""
    h, w = inverse.shape
    padded = cv2.copyMakeBorder(inverse, ARM, ARM, ARM, ARM, cv2.BORDER_CONSTANT, value=float(MISSING))
    largest = np.full((h, w), MISSING)
    for dy, dx in ((0, ARM), (ARM, 0), (DIAGONAL_ARM, DIAGONAL_ARM), (DIAGONAL_ARM, -DIAGONAL_ARM)):
        ends = padded[ARM - dy :, ARM - dx :][:h, :w] + padded[ARM + dy :, ARM + dx :][:h, :w]
        np.maximum(largest, ends, out=largest)
    return largest - 2 * inverse


def flooded(inverse: Float32, concave: Float32) -> tuple[Int32, int]:
    """Labels (h, w), 0 none, and how many: what holds together away from creases, grown back to them.

    Flooding goes where inverse depth changes least first, so that a step ends in the right one of its two sides.
    """
    seen = inverse > 0
    smooth = (seen & (concave < CREASE)).astype(np.uint8)
    core = cv2.erode(smooth, np.ones((3, 3), np.uint8))  # closes gaps in a crease
    core[[0, -1]] = 0  # the flooding overwrites the image's border
    core[:, [0, -1]] = 0
    _, pieces, figures, _ = cv2.connectedComponentsWithStats(core, connectivity=4)
    kept = figures[:, cv2.CC_STAT_AREA] >= SMALLEST
    kept[0] = False
    n = int(np.count_nonzero(kept))
    markers = np.where(kept, np.cumsum(kept), 0).astype(np.int32)[pieces]
    markers[~seen] = n + 1
    grey = np.clip(inverse * LEVELS, 0, 255).astype(np.uint8)
    cv2.watershed(cv2.merge([grey, grey, grey]), markers)
    markers[(markers < 0) | (markers > n)] = 0
    return np.asarray(markers, np.int32), n


def flat_ones(labels: Int32, inverse: Float32, n: int) -> Bools:
    """Whether each of n pieces is large and lies on one plane, from index 1 on.

    A plane w = a u + b v + c is fitted by least squares to every piece at once, from sums of products.
    """
    h, w = labels.shape
    sums = np.zeros((n + 1, 4, 4))
    _sum_products(labels, inverse, sums)
    large = sums[:, 2, 2] > FLAT_SHARE * h * w
    large[0] = False
    return np.array([k and _rms(s) < FLAT for k, s in zip(large, sums, strict=True)], bool)


@jit
def _sum_products(labels: Int32, inverse: Float32, sums: Float64) -> None:
    """Sums of products of (u, v, 1, w) over each label, u and v in widths from the corner less a half."""
    h, w = labels.shape
    terms = np.ones(4)
    for y in range(h):
        terms[1] = y / w - 0.5
        for x in range(w):
            terms[0], terms[3] = x / w - 0.5, inverse[y, x]
            into = sums[labels[y, x]]
            for i in range(4):
                for j in range(4):
                    into[i, j] += terms[i] * terms[j]


def joined(labels: Int32, inverse: Float32, flat: Bools) -> Int64:
    """For each piece the first of those that it belongs with: neighbours without a depth step, none a support."""
    n = flat.size
    border, creased = np.zeros(n * n), np.zeros(n * n)
    for before, after in ((np.s_[:, :-2], np.s_[:, 2:]), (np.s_[:-2], np.s_[2:])):  # on both sides of a seam
        a, b = labels[before], labels[after]
        seam = (a != b) & (a > 0) & (b > 0)
        pair = np.minimum(a, b)[seam] * n + np.maximum(a, b)[seam]
        level = np.abs(inverse[before] - inverse[after])[seam] < STEP
        border += np.bincount(pair, minlength=n * n)
        creased += np.bincount(pair, level, n * n)
    support = flat | (np.bincount(labels.ravel(), minlength=n) > SUPPORT_SHARE * labels.size)
    first = np.arange(n)
    for i, j in np.argwhere(((creased >= SEAM) & (creased > SEAM_SHARE * border)).reshape(n, n)):
        if not support[i] and not support[j]:
            first[first == max(first[i], first[j])] = min(first[i], first[j])
    return first


def _rms(sums: Float64) -> float:
    """Of the residuals, from the (4, 4) sums of products of (u, v, 1, w)."""
    try:
        plane = np.linalg.solve(sums[:3, :3], sums[:3, 3])
    except np.linalg.LinAlgError:  # all on one line, as a piece of a tiny image may be: it shows no plane
        return float("inf")
    return float(np.sqrt(max(0.0, sums[3, 3] - plane @ sums[:3, 3]) / sums[2, 2]))
