"""Poses as they are written: rows of a chain of plain transforms, whatever convention they were listed in."""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from vlmm_log import se3
from vlmm_log.readers.conventions import AXES, Convention
from vlmm_log.readers.poses import Link, Poses, Trajectory
from vlmm_log.types import Float64, Int64, Skipped


@dataclass(frozen=True, eq=False)
class Pose:
    """One row: a moving link of the chain at one of its own times."""

    stamp_ns: int  # of the images' clock
    link: int
    position: Float64  # (3,) m
    quaternion: Float64  # (4,) unit, x y z w


@dataclass(frozen=True, eq=False)
class Chain:
    """``T_world_cam`` as a product of links without a convention, or resolved to one link.

    Resolved poses are listed at the stamps of the most finely sampled link and, so that no frame's pose is
    interpolated twice, at those of the depth images.
    """

    links: tuple[Link, ...]  # of a resolved one, none
    resolved: Poses | None
    gap_ns: int  # between poses that are interpolated when resolving
    up: str  # axis of the world that points up
    notes: tuple[str, ...] = ()

    def rows(self) -> Iterator[Pose | Skipped]:
        """Every row of every moving link by time; at equal times the first link's first."""
        if self.resolved is None:
            tracks = [_rows(k, x.motion) for k, x in enumerate(self.links) if isinstance(x.motion, Trajectory)]
            yield from heapq.merge(*tracks, key=lambda row: row.stamp_ns)
            return
        for stamp_ns in map(int, self.resolved.stamps_ns):
            reason = "not every link of the chain of transforms is known at this time"
            yield self._resolved(stamp_ns) or Skipped(stamp_ns, f"pose of {self.resolved.source}", reason)

    def at_image(self, stamp_ns: int) -> Pose | None:
        """The row that a depth image asks for: none if the chain is not resolved, or has a row of that time."""
        if self.resolved is None:
            return None
        stamps = self._stamps_ns
        k = int(np.searchsorted(stamps, stamp_ns))
        return None if k < stamps.size and stamps[k] == stamp_ns else self._resolved(stamp_ns)

    @cached_property
    def _stamps_ns(self) -> Int64:
        assert self.resolved is not None
        return self.resolved.stamps_ns

    def still(self) -> Iterator[tuple[int, Link]]:
        """The links that do not move, and where in the chain they are."""
        return ((k, x) for k, x in enumerate(self.links) if not isinstance(x.motion, Trajectory))

    def _resolved(self, stamp_ns: int) -> Pose | None:
        assert self.resolved is not None
        T = self.resolved.at(stamp_ns, self.gap_ns)
        return None if T is None else Pose(stamp_ns, 0, T[:3, 3], se3.quaternion(T))


def as_links(poses: Poses, gap_ns: int) -> Chain:
    """The chain as tf holds it: its links, and what its convention adds as still ones.

    Poses that map the world into the camera, chains that are walked backwards (a tree of frames has one root, the
    world) and mirrored worlds are resolved instead.
    """
    c = poses.convention
    ends = [c.world, *(T for T in (c.to_camera, AXES[c.axes]) if T is not None)]
    backwards = c.inverse or any(x.inverse and isinstance(x.motion, Trajectory) for x in poses.links)
    if backwards or not all(T is None or _is_rigid(T) for T in ends):
        return as_poses(poses, gap_ns)
    before = () if c.world is None else (Link(c.world),)
    after = tuple(Link(T) for T in ends[1:] if T is not None)
    turned = c.world is not None or AXES[c.axes] is not None
    told = ("the poses' convention is written as still transforms",) if turned else ()
    return Chain((*before, *(_plain(x, c) for x in poses.links), *after), None, gap_ns, poses.world_up, told)


def as_poses(poses: Poses, gap_ns: int) -> Chain:
    """The chain as one list of camera poses: as it is where it is one already, else resolved."""
    c, first = poses.convention, poses.links[0]
    bare = c.world is None and c.to_camera is None and AXES[c.axes] is None and not c.inverse
    if bare and len(poses.links) == 1 and isinstance(first.motion, Trajectory) and not first.inverse:
        return Chain((_plain(first, c),), None, gap_ns, poses.world_up)
    told = f"poses are T_world_cam resolved from {poses.source}, at its stamps and at those of the depth images"
    return Chain((), poses, gap_ns, poses.world_up, (told,))


def _rows(link: int, track: Trajectory) -> Iterator[Pose]:
    rows = zip(track.stamps_ns.tolist(), track.positions, track.quaternions, strict=True)
    return (Pose(stamp_ns, link, x, q) for stamp_ns, x, q in rows)


def _plain(link: Link, c: Convention) -> Link:
    """The link with its rows' order, units and clock put right."""
    T = link.motion
    if not isinstance(T, Trajectory):
        return link
    positions = T.positions if c.units_per_meter == 1 else T.positions / c.units_per_meter
    quaternions = T.quaternions if c.quaternion == "xyzw" else T.quaternions[:, [1, 2, 3, 0]]
    return Link(Trajectory(T.stamps_ns + c.offset_ns, positions, quaternions), link.inverse)


def _is_rigid(T: Float64) -> bool:
    R = T[:3, :3]
    return bool(np.allclose(R @ R.T, np.eye(3), atol=1e-9) and np.linalg.det(R) > 0)
