"""Axes, rotations, the heading frame, unwrapping, units.

World frame: z up, yaw counter-clockwise from the world's x axis. Heading frame: the world turned by yaw, so x is
forward and y is left of the vehicle. Everything is SI.
"""

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

Indices = npt.NDArray[np.int64]

Mask = npt.NDArray[np.bool_]

AXES = ("x", "y", "z", "yaw")
"""The four axes in the order of the commands, of the pose and of the paper's coefficients gamma."""

POSE_UNITS: Mapping[str, str] = MappingProxyType({"x": "m", "y": "m", "z": "m", "yaw": "rad"})
"""SI unit of the pose along each axis; velocities and accelerations are in it per second, and per second squared."""

UNIT_SCALE: Mapping[str, float] = MappingProxyType(
    {
        "m": 1.0,
        "cm": 1e-2,
        "mm": 1e-3,
        "m/s": 1.0,
        "cm/s": 1e-2,
        "rad": 1.0,
        "deg": np.pi / 180,
        "rad/s": 1.0,
        "deg/s": np.pi / 180,
        "s": 1.0,
        "ms": 1e-3,
        "us": 1e-6,
        "ns": 1e-9,
    }
)
"""Factor to SI from each unit that a card may name."""


def heading_from_world(vector: Array, yaw: Array) -> Array:
    """Rotates horizontal world vectors into the heading frame: R(yaw)^T v.

    Args:
        vector: Horizontal world components, shape (..., 2).
        yaw: Heading, shape (...) [rad].

    Returns:
        Forward and left components, shape (..., 2), in the unit of `vector`.

    Source: paper, eq. (3).
    """
    c, s = np.cos(yaw), np.sin(yaw)
    return np.stack([c * vector[..., 0] + s * vector[..., 1], -s * vector[..., 0] + c * vector[..., 1]], axis=-1)


def world_from_heading(vector: Array, yaw: Array) -> Array:
    """Rotates heading-frame vectors into the world frame: R(yaw) v.

    Args:
        vector: Forward and left components, shape (..., 2).
        yaw: Heading, shape (...) [rad].

    Returns:
        Horizontal world components, shape (..., 2), in the unit of `vector`.

    Source: paper, eq. (3).
    """
    return heading_from_world(vector, -yaw)


def yaw_from_quaternion(w: Array, x: Array, y: Array, z: Array) -> Array:
    """Heading of a body with attitude quaternion (w, x, y, z), each of shape (N,), in [-pi, pi] [rad].

    The quaternion need not be normalised. Source: the z-y-x Euler angles, yaw = atan2(R21, R11).
    """
    return np.arctan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z)


def quaternion_from_yaw(yaw: Array) -> Array:
    """Attitude quaternions w, x, y, z, shape (N, 4), of a level body with headings of shape (N,) [rad]."""
    half, zero = yaw / 2, np.zeros(yaw.size)
    return np.stack([np.cos(half), zero, zero, np.sin(half)], axis=1)
