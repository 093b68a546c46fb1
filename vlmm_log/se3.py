"""Rigid motions as (..., 4, 4) float64 matrices, twists as (..., 6): rotation vector rad, translation m."""

from __future__ import annotations

import numpy as np

from vlmm_log.types import Float64


def skew(v: Float64) -> Float64:
    """(..., 3, 3) matrices of the cross product with (..., 3) vectors."""
    x, y, z = np.moveaxis(np.asarray(v, np.float64), -1, 0)
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(*x.shape, 3, 3)


def exp(twist: Float64) -> Float64:
    """The motion (..., 4, 4) of a twist (..., 6). Rodrigues' formula; Barfoot, State Estimation for Robotics, 7.1."""
    twist = np.asarray(twist, np.float64)
    W = skew(twist[..., :3])
    W2 = W @ W
    angle2 = np.sum(twist[..., :3] ** 2, axis=-1)[..., None, None]
    small = angle2 < 1e-12
    safe2 = np.where(small, 1.0, angle2)
    angle = np.sqrt(safe2)
    a = np.where(small, 1.0 - angle2 / 6.0, np.sin(angle) / angle)
    b = np.where(small, 0.5 - angle2 / 24.0, (1.0 - np.cos(angle)) / safe2)
    c = np.where(small, 1.0 / 6.0, (angle - np.sin(angle)) / (safe2 * angle))
    T = np.zeros((*twist.shape[:-1], 4, 4))
    T[..., :3, :3] = np.eye(3) + a * W + b * W2
    left_jacobian = np.eye(3) + b * W + c * W2
    T[..., :3, 3] = (left_jacobian @ twist[..., 3:, None])[..., 0]
    T[..., 3, 3] = 1.0
    return T


def log(T: Float64) -> Float64:
    """The twist (6,) of one motion (4, 4), its angle below pi."""
    R, t = T[:3, :3], T[:3, 3]
    axis2 = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    sine2 = float(np.linalg.norm(axis2))
    angle = float(np.arctan2(sine2, np.trace(R) - 1.0))
    if sine2 > 1e-9:
        rotation = axis2 / sine2 * angle
    elif angle < 1.0:
        rotation = axis2 / 2.0
    else:  # half a turn: the axis is the largest column of R + 1
        column = (R + np.eye(3))[:, int(np.argmax(np.diag(R)))]
        rotation = column / np.linalg.norm(column) * angle
    W = skew(rotation)
    theta = float(np.linalg.norm(rotation))
    d = 1.0 / 12.0 if theta < 1e-4 else (1.0 - theta / 2.0 / np.tan(theta / 2.0)) / theta**2
    return np.concatenate([rotation, (np.eye(3) - 0.5 * W + d * W @ W) @ t])


def inverse(T: Float64) -> Float64:
    """The inverse motions (..., 4, 4)."""
    Rt = np.swapaxes(T[..., :3, :3], -1, -2)
    out = np.zeros_like(T)
    out[..., :3, :3] = Rt
    out[..., :3, 3] = -(Rt @ T[..., :3, 3:])[..., 0]
    out[..., 3, 3] = 1.0
    return out


def from_quaternion(translation: Float64, xyzw: Float64) -> Float64:
    """Motions (..., 4, 4) of positions (..., 3) and unit quaternions (..., 4) in x, y, z, w order.

    The one place where a quaternion becomes a rotation. The caller has checked the norm.
    """
    x, y, z, w = np.moveaxis(np.asarray(xyzw, np.float64), -1, 0)
    T = np.zeros((*x.shape, 4, 4))
    T[..., 0, 0], T[..., 0, 1], T[..., 0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)
    T[..., 1, 0], T[..., 1, 1], T[..., 1, 2] = 2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)
    T[..., 2, 0], T[..., 2, 1], T[..., 2, 2] = 2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)
    T[..., :3, 3] = translation
    T[..., 3, 3] = 1.0
    return T


def quaternion(T: Float64) -> Float64:
    """Unit quaternion (4,) of a motion (4, 4) in x, y, z, w order, w not negative. Shepperd 1978."""
    R = T[:3, :3]
    squares = np.array([1 + R[0, 0] - R[1, 1] - R[2, 2], 1 - R[0, 0] + R[1, 1] - R[2, 2]])
    squares = np.append(squares, [1 - R[0, 0] - R[1, 1] + R[2, 2], 1 + np.trace(R)])
    x, y, z = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
    xy, xz, yz = R[0, 1] + R[1, 0], R[0, 2] + R[2, 0], R[1, 2] + R[2, 1]
    rows = np.array([[squares[0], xy, xz, x], [xy, squares[1], yz, y], [xz, yz, squares[2], z], [x, y, z, squares[3]]])
    q = rows[int(np.argmax(squares))]  # the largest divisor is the safest
    q = q / np.linalg.norm(q)
    return np.asarray(-q if q[3] < 0 else q, np.float64)


def slerp(q0: Float64, q1: Float64, s: float) -> Float64:
    """Unit quaternion (4,) at share s of the shorter arc from q0 to q1. Shoemake, SIGGRAPH 1985."""
    dot = float(q0 @ q1)
    if dot < 0.0:
        q1, dot = -q1, -dot
    angle = np.arccos(min(dot, 1.0))
    if angle < 1e-6:
        mixed = (1.0 - s) * q0 + s * q1
    else:
        mixed = (np.sin((1.0 - s) * angle) * q0 + np.sin(s * angle) * q1) / np.sin(angle)
    return np.asarray(mixed / np.linalg.norm(mixed))


def kabsch(source: Float64, target: Float64) -> Float64:
    """Motions (..., 4, 4) that bring points (..., N, 3) onto points (..., N, 3) in least squares.

    Kabsch 1976, Umeyama 1991; the paper's closed form, the determinant guarding against reflections.
    """
    source_mean = source.mean(axis=-2, keepdims=True)
    target_mean = target.mean(axis=-2, keepdims=True)
    U, _, Vt = np.linalg.svd(np.swapaxes(target - target_mean, -1, -2) @ (source - source_mean))
    Vt = Vt.copy()
    Vt[..., 2, :] *= np.linalg.det(U @ Vt)[..., None]
    R = U @ Vt
    T = np.zeros((*R.shape[:-2], 4, 4))
    T[..., :3, :3] = R
    T[..., :3, 3] = (target_mean - source_mean @ np.swapaxes(R, -1, -2))[..., 0, :]
    T[..., 3, 3] = 1.0
    return T
