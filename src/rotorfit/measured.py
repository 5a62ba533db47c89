"""What was measured in a segment, on one clock, and the velocity of reference: what the prediction protocol needs."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from rotorfit.derivative import Derivatives, local_polynomial
from rotorfit.flight import Flight
from rotorfit.frames import AXES, Array, Mask

LONGEST_GAP = 1.0
"""No score across a hole in the pose of this length [s]."""

HALF_WIDTH = 0.125
"""Of the local cubic that gives the velocity of reference [s]; widened until it holds `LEAST` samples."""

LEAST = 7


@dataclass(frozen=True)
class Seen:
    """One segment on the clock of the poses, and of the velocities too where axes have nothing else. N stamps.

    Attributes:
        time: Shape (N,) [s].
        pose: Measured x, y, z, yaw, shape (N, 4); between poses where only the velocity has a stamp.
        reference: Velocity that predictions are held against, shape (N, 4), NaN where there is none.
        alone: Axes that are tracked by their velocity.
        velocity: World, shape (N, 4), NaN where there is none; None where every axis has poses.
        tracked: Whether what tracks each axis was measured at a stamp, shape (N, 4); None likewise.
        rounding: Variance that the rounding adds to the velocity of the lone axes, shape (4,).
    """

    time: Array
    pose: Array
    reference: Array
    alone: tuple[str, ...] = ()
    velocity: Array | None = None
    tracked: Mask | None = None
    rounding: Array = field(default_factory=lambda: np.zeros(len(AXES)))

    def velocity_of(self, pair: Sequence[int]) -> tuple[Array | None, Mask | None, Mask | None]:
        """What `predict` needs of two axes; None where both have poses at every stamp."""
        if self.velocity is None or self.tracked is None:
            return None, None, None
        alone = np.array([AXES[i] in self.alone for i in pair])
        values = np.nan_to_num(self.velocity[:, pair])  # what is not tracked is not looked at, but 0 times NaN is NaN
        return np.ascontiguousarray(values), np.ascontiguousarray(self.tracked[:, pair]), alone


def seen_in(flight: Flight, low: float, high: float) -> Seen:
    """What a flight measured between two times [s]."""
    inside = (flight.pose_time >= low) & (flight.pose_time <= high)
    t, pose = flight.pose_time[inside], np.column_stack([flight.position, flight.yaw])[inside]
    if flight.velocity is None or not flight.velocity_only or not t.size:
        return Seen(t, pose, _smooth(t, pose, t).velocity)
    own = flight.velocity.between(float(t[0]), high)
    time = np.union1d(t, own.time)
    velocity = np.full((time.size, len(AXES)), np.nan)
    velocity[np.searchsorted(time, own.time)] = own.value
    alone = np.isin(AXES, flight.velocity_only)
    reference = _smooth(t, pose, time).velocity
    for k in np.flatnonzero(alone):  # the same cubic smooths what needs no derivative
        reference[:, k] = _smooth(own.time, own.value[:, k : k + 1], time).value[:, 0]
    return Seen(
        time=time,
        pose=np.column_stack([np.interp(time, t, column) for column in pose.T]),
        reference=reference,
        alone=flight.velocity_only,
        velocity=velocity,
        tracked=np.where(alone, np.isfinite(velocity), np.isin(time, t)[:, None]),
        rounding=np.where(alone, flight.velocity.rounding, 0.0),
    )


def _smooth(time: Array, values: Array, at: Array) -> Derivatives:
    return local_polynomial(time, values, at, HALF_WIDTH, 3, least=LEAST, max_gap=LONGEST_GAP)
