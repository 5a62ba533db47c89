"""Reference paths for controllers: circle, lemniscate and steps, as functions of time with their derivatives.

A path is in the world frame, its positions around a centre. Circle and lemniscate wait, and then gather speed by a
phase whose rate grows as 10 s^3 - 15 s^4 + 6 s^5 of the share s of a ramp: velocity and acceleration have no jumps.
Steps are not announced: before a step nobody knows of it.
"""

from dataclasses import dataclass
from typing import Literal

import numba
import numpy as np

from rotorfit.errors import PlanError
from rotorfit.frames import Array
from rotorfit.plan import Four, Space

Shape = Literal["circle", "lemniscate", "steps"]
SHAPES: tuple[Shape, ...] = ("circle", "lemniscate", "steps")

WAIT, RAMP = 5.0, 3.0
"""Hover before a path; how long it gathers speed [s]."""

TURN, HEAVE = 0.8, 0.25
"""Of a lemniscate: how far the heading swings [rad]; how far the height, as a share of the size."""

HOLD = 6.0
"""Between two steps [s]."""

STEPS: tuple[Four, ...] = (
    (1.0, 0.0, 0.0, 0.0), (1.0, 1.0, 0.0, 0.0), (1.0, 1.0, 0.5, 0.0), (1.0, 1.0, 0.5, 1.5), (0.0, 0.0, 0.0, 0.0)
)  # fmt: skip
"""Where steps lead one after the other: x, y, z as shares of the size, yaw [rad]."""

_LEVELS = np.array(STEPS)


@dataclass(frozen=True)
class ReferencePath:
    """A path.

    Attributes:
        shape: Which one.
        size: Radius of the circle, half the length of the lemniscate, length of the steps [m].
        speed: Largest speed of circle and lemniscate [m/s].
        duration: Of the whole [s].
        centre: x, y, z [m] and yaw [rad] around which it lies.
    """

    shape: Shape
    size: float
    speed: float
    duration: float = 40.0
    centre: Four = (0.0, 0.0, 1.5, 0.0)

    def at(self, t: Array) -> tuple[Array, Array, Array]:
        """Position, velocity and acceleration of x, y, z, yaw at times from the start, each shape (N, 4)."""
        out = np.empty((3, t.size, 4))
        full = self.speed / (self.size * (1.0 if self.shape == "circle" else np.sqrt(2.0 + HEAVE**2)))
        _fill(SHAPES.index(self.shape), self.size, full, np.array(self.centre), t, out)
        return out[0], out[1], out[2]

    def known(self, t: Array, now: Array) -> tuple[Array, Array, Array]:
        """As `at`, as far as it is known at an earlier time: a step that is still to come is not."""
        return self.at(np.minimum(t, now) if self.shape == "steps" else t)

    @property
    def start(self) -> Four:
        """Where it begins."""
        x, y, z, yaw = self.at(np.zeros(1))[0][0].tolist()
        return x, y, z, yaw


@numba.njit(cache=True)
def _fill(shape, size, full, centre, t, out):  # type: ignore[no-untyped-def]
    """Position, velocity and acceleration, shape (3, N, 4), of a shape at times (N,); full: final rate of the phase."""
    out[:] = 0.0
    for n in range(t.size):
        since = max(t[n] - WAIT, 0.0)
        s = min(since / RAMP, 1.0)
        phase = full * (RAMP * s**4 * (2.5 - 3 * s + s**2) + max(since - RAMP, 0.0))
        rate, growth = full * s**3 * (10 - 15 * s + 6 * s**2), full * 30 * s**2 * (1 - s) ** 2 / RAMP
        c, s = np.cos(phase), np.sin(phase)
        if shape == 0:  # a circle, heading kept
            way = ((size * c, -size * s, -size * c), (size * s, size * c, -size * s), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
        elif shape == 1:  # Gerono's lemniscate, fastest in the middle, with swinging height and heading
            lift = HEAVE * size
            way = (
                (size * s, size * c, -size * s), (size * s * c, size * (c * c - s * s), -4 * size * s * c),
                (lift * s, lift * c, -lift * s), (TURN * s, TURN * c, -TURN * s),
            )  # fmt: skip
        else:
            way = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
            step = min(int(np.floor((t[n] - WAIT) / HOLD)), _LEVELS.shape[0] - 1)
            for a in range(4):
                if step >= 0:
                    out[0, n, a] = _LEVELS[step, a] * (size if a < 3 else 1.0)
        for a in range(4):
            out[0, n, a] += centre[a] + way[a][0]
            out[1, n, a] = way[a][1] * rate
            out[2, n, a] = way[a][2] * rate * rate + way[a][1] * growth


def within(path: ReferencePath, space: Space) -> None:
    """Refuses a path that leaves a space or its speed limits.

    Raises:
        PlanError: It does, and by how much.
    """
    position, velocity, _ = path.at(np.arange(0.0, path.duration, 0.02))
    out = np.maximum(np.array(space.lower) - position[:, :3], position[:, :3] - np.array(space.upper)).max()
    if out > 0:
        raise PlanError(f"the {path.shape} of {path.size:g} m leaves the space by {out:.2f} m: make it smaller")
    fast, climb = np.hypot(velocity[:, 0], velocity[:, 1]).max(), np.abs(velocity[:, 2]).max()
    if fast > space.speed * (1 + 1e-9) or climb > space.climb:
        raise PlanError(
            f"the {path.shape} is flown at up to {fast:.2f} m/s and climbs at {climb:.2f} m/s, beyond {space.speed:g} "
            f"and {space.climb:g} m/s: fly it slower"
        )
