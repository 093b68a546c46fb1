"""tf: the tree of frames over a whole log, and chains of transforms through it."""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from vlmm_log import se3
from vlmm_log.readers.bag.messages import Placed
from vlmm_log.readers.poses import Link, Trajectory, unit, usable_pose
from vlmm_log.types import Float64


@dataclass
class Edge:
    """All that was heard of one child in one parent."""

    stamps_ns: array[int] = field(default_factory=lambda: array("q"))
    values: array[float] = field(default_factory=lambda: array("d"))  # 7 a stamp

    def add(self, placed: Placed) -> None:
        """One more."""
        self.stamps_ns.append(placed.stamp_ns)
        self.values.extend(placed.values)

    def trajectory(self) -> Trajectory:
        """All of it in time order, of each stamp the first."""
        stamps, first = np.unique(np.frombuffer(self.stamps_ns, np.int64), return_index=True)
        values = np.frombuffer(self.values, np.float64).reshape(-1, 7)[first]
        return Trajectory(stamps, values[:, :3], unit(values[:, 3:]))

    def motion(self) -> Trajectory | Float64:
        """A trajectory; one transform (4, 4) where it never changes."""
        values = np.frombuffer(self.values, np.float64).reshape(-1, 7)
        if (values != values[0]).any():
            return self.trajectory()
        return se3.from_quaternion(values[0, :3], unit(values[:1, 3:])[0])


@dataclass
class Tree:
    """Frames and their parents."""

    still: dict[str, tuple[str, Edge]] = field(default_factory=dict)  # child -> parent, latest value: /tf_static
    moving: dict[str, dict[str, Edge]] = field(default_factory=dict)  # child -> parent -> all values: /tf
    refused: Counter[tuple[str, str]] = field(default_factory=Counter)  # child, reason -> transforms

    def add(self, placed: Placed) -> None:
        """A transform of /tf."""
        if self._usable(placed):
            self.moving.setdefault(placed.child, {}).setdefault(placed.parent, Edge()).add(placed)

    def add_still(self, placed: Placed) -> None:
        """A transform of /tf_static; a later one takes the place of an earlier one."""
        if self._usable(placed):
            edge = Edge()
            edge.add(placed)
            self.still[placed.child] = placed.parent, edge

    def complete(self, earlier: Tree) -> list[str]:
        """Add what an earlier part of the log alone has said; told which."""
        missing = [child for child in earlier.moving if child not in self.moving and child not in self.still]
        for child in missing:
            self.moving[child] = earlier.moving[child]
        return [f"transform of {child} as the log's beginning has it" for child in sorted(missing)]

    def parent(self, child: str) -> tuple[str, Edge] | None:
        """A frame's parent: the still one, else the one most often heard of."""
        if child in self.still:
            return self.still[child]
        heard = self.moving.get(child)
        return max(heard.items(), key=lambda e: len(e[1].stamps_ns)) if heard else None

    def ancestors(self, frame: str) -> list[str]:
        """The frame, its parent, and so on to the root."""
        line = [frame]
        while (above := self.parent(line[-1])) is not None and above[0] not in line:
            line.append(above[0])
        return line

    def chain(
        self, to: str, frame: str, motion: Callable[[Edge], Trajectory | Float64] = Edge.motion
    ) -> tuple[Link, ...] | None:
        """Links whose product is ``T_to_frame``, each edge read by ``motion``; None where the tree joins them not."""
        up, down = self.ancestors(to), self.ancestors(frame)
        meeting = next((name for name in up if name in down), None)
        if meeting is None:
            return None
        links = [Link(self._motion(name, motion), inverse=True) for name in up[: up.index(meeting)]]
        links += [Link(self._motion(name, motion)) for name in reversed(down[: down.index(meeting)])]
        return tuple(links)

    def still_transform(self, to: str, frame: str) -> Float64 | None:
        """``T_to_frame`` (4, 4) where all links between them are still; else None."""
        links = self.chain(to, frame)
        T: Float64 = np.eye(4)
        for link in () if links is None else links:
            if isinstance(link.motion, Trajectory):
                return None
            T = T @ (se3.inverse(link.motion) if link.inverse else link.motion)
        return None if links is None else T

    def conflicts(self) -> list[str]:
        """Frames that were given several parents."""
        several = {child: list(heard) for child, heard in self.moving.items() if len(heard) > 1}
        for child, (parent, _) in self.still.items():
            others = [name for name in self.moving.get(child, {}) if name != parent]
            if others:
                several[child] = [parent, *others]
        return [f"{child} has parents {', '.join(sorted(names))}" for child, names in sorted(several.items())]

    def _motion(self, child: str, motion: Callable[[Edge], Trajectory | Float64]) -> Trajectory | Float64:
        above = self.parent(child)
        assert above is not None
        return above[1].motion() if child in self.still else motion(above[1])

    def _usable(self, placed: Placed) -> bool:
        reason = usable_pose(placed.values)
        if placed.parent == placed.child or not placed.child or not placed.parent:
            reason = "transform names no two frames"
        if reason:
            self.refused[placed.child, reason] += 1
        return reason is None
