"""How a listed pose is to be read: direction, quaternion order, axes, what carries the camera, whose clock."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from vlmm_log import se3
from vlmm_log.settings import ReadSettings
from vlmm_log.types import Float64, InputError

# Axes of the frame whose pose is listed, from the camera's own (x right, y down, z forward): T_listed_camera.
AXES: dict[str, Float64 | None] = {
    "optical": None,
    "body": np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]]),  # REP 103: x forward, z up
    "opengl": np.diag([1.0, -1.0, -1.0, 1.0]),  # x right, y up, z back
}

# The page of Bonn RGB-D Dynamic (https://www.ipb.uni-bonn.de/data/rgbd-dynamic-dataset) gives the camera's pose as
# T_ros T_0 T_ros T_m for a listed pose T_0. No sequence could be had to check it on.
BONN_ROS: Float64 = np.array([[-1.0, 0, 0, 0], [0, 0, 1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
BONN_MARKER: Float64 = np.array(
    [
        [1.0157, 0.1828, -0.2389, 0.0113],
        [0.0009, -0.8431, -0.6413, -0.0098],
        [-0.3009, 0.6147, -0.8085, 0.0111],
        [0, 0, 0, 1],
    ]
)


@dataclass(frozen=True, eq=False)
class Convention:
    """``T_world_cam = world @ listed @ to_camera @ axes``; None stands for no change."""

    world: Float64 | None = None  # (4, 4)
    to_camera: Float64 | None = None  # (4, 4) pose of the camera in the frame whose pose is listed
    inverse: bool = False  # world-to-camera is listed
    quaternion: str = "xyzw"  # order in which it is listed
    axes: str = "optical"  # key of AXES
    offset_ns: int = 0  # added to the stamps of poses
    units_per_meter: float = 1.0  # of positions

    def listed(self, position: Float64, quaternion: Float64) -> Float64:
        """The listed motion (4, 4) of a position (3,) and a unit quaternion (4,) in the listed order."""
        xyzw = quaternion if self.quaternion == "xyzw" else quaternion[[1, 2, 3, 0]]
        return se3.from_quaternion(position if self.units_per_meter == 1 else position / self.units_per_meter, xyzw)

    def camera(self, listed: Float64) -> Float64:
        """``T_world_cam`` (4, 4) of a listed motion."""
        T = se3.inverse(listed) if self.inverse else listed
        T = T if self.world is None else self.world @ T
        for right in (self.to_camera, AXES[self.axes]):
            T = T if right is None else T @ right
        return T

    def turned(self, up: str) -> str:
        """The axis name "+z" and the like after ``world`` has turned it."""
        if self.world is None:
            return up
        axis = self.world[:3, "xyz".index(up[1])] * (1 if up[0] == "+" else -1)
        k = int(np.argmax(np.abs(axis)))
        return ("+" if axis[k] > 0 else "-") + "xyz"[k]


PLAIN = Convention()
"""Poses of the camera itself, as the field lists them."""


def bonn() -> Convention:
    """That of Bonn RGB-D Dynamic. Palazzolo et al., IROS 2019."""
    return Convention(world=BONN_ROS, to_camera=BONN_ROS @ _rigid(BONN_MARKER))


def icl() -> Convention:
    """That of ICL-NUIM, whose camera and world are left-handed, y up. Handa et al., ICRA 2014. Not checked on data."""
    mirror = np.diag([1.0, -1.0, 1.0, 1.0])
    return Convention(world=mirror, to_camera=mirror)


def asked(s: ReadSettings, own: Convention) -> Convention:
    """The source's own convention, changed by what the settings ask for. Raises InputError."""
    return replace(
        _carried(s.pose_to_camera, own),
        inverse=s.poses == "world_to_camera",
        quaternion=s.quaternion,
        axes=s.camera_axes,
        offset_ns=round(s.pose_offset_s * 1e9),
        units_per_meter=s.position_units_per_meter,
    )


def _carried(text: str, own: Convention) -> Convention:
    match text:
        case "":
            return own
        case "none":
            return replace(own, world=None, to_camera=None)
        case "bonn":
            return bonn()
        case "icl":
            return icl()
    T = rigid_from_text(text)
    if T is None:
        raise InputError(
            f"read.pose_to_camera = {text!r}: give 'none', 'bonn', 'icl' or the camera's pose in the tracked frame, "
            "'tx,ty,tz,qx,qy,qz,qw' in m"
        )
    return replace(own, world=None, to_camera=T)


def rigid_from_text(text: str) -> Float64 | None:
    """The motion (4, 4) of 'tx,ty,tz,qx,qy,qz,qw'; None where the text is none."""
    try:
        values = np.array([float(word) for word in text.replace(",", " ").split()])
    except ValueError:
        return None
    if values.size != 7 or not np.isfinite(values).all() or abs(np.linalg.norm(values[3:]) - 1) > 0.01:
        return None
    return se3.from_quaternion(values[:3], values[3:] / np.linalg.norm(values[3:]))


def _rigid(T: Float64) -> Float64:
    """The motion nearest to a published matrix whose 3x3 block is 1.06 times a rotation."""
    U, _, Vt = np.linalg.svd(T[:3, :3])
    out = T.copy()
    out[:3, :3] = U @ Vt
    return out
