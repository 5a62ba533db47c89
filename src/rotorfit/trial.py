"""A controller tried in the virtual flight room: how far the vehicle is from its reference path, at true instants."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from rotorfit.control_law import AxisLaw
from rotorfit.frames import Array, yaw_from_quaternion
from rotorfit.plan import Space
from rotorfit.reference_paths import HOLD, STEPS, WAIT, ReferencePath
from rotorfit.simulator import Conditions, FlightRoom
from rotorfit.steering import Controller, at_rest, commanded, seen
from rotorfit.tune import Tuning
from rotorfit.vehicle import Vehicle

LOOK = 2
"""The truth is looked at every so many commands."""

BAND = 0.1
"""A step has settled when it stays within this share of its height."""


@dataclass(frozen=True)
class Trial:
    """One flight. N instants at which the truth was looked at.

    Attributes:
        path: What was to be followed.
        time: Shape (N,) [s].
        pose: True x, y, z, yaw, unwrapped, shape (N, 4).
        reference: Wanted then, shape (N, 4).
        saturated: Share of the commands that full scale has bounded on some axis.
        failed: Whether it left the space; the flight ends there.
    """

    path: ReferencePath
    time: Array
    pose: Array
    reference: Array
    saturated: float
    failed: bool


@dataclass(frozen=True)
class TrackingError:
    """Errors of a flight, from the end of the first hover on; infinite where it has failed.

    Attributes:
        position: Root mean square of the distance [m].
        heading: Root mean square of the heading's error [rad].
        overshoot: Largest of the steps beyond their end, share of their height; None without steps.
        settling: Median time from a step until the axis stays within a tenth of it [s]; None without steps.
    """

    position: float
    heading: float
    overshoot: float | None
    settling: float | None


def controller_of(laws: Tuning | Mapping[str, AxisLaw], vehicle: Vehicle) -> Controller:
    """A controller for a vehicle of the room: gains that were tuned, or laws from elsewhere, and its full scale."""
    of_axes = {axis: one.law for axis, one in laws.axes.items()} if isinstance(laws, Tuning) else dict(laws)
    return Controller(of_axes, np.array(vehicle.limits()) / np.array(vehicle.full_scale()))


def try_path(
    controller: Controller, vehicle: Vehicle, conditions: Conditions, path: ReferencePath, space: Space, seed: int
) -> Trial:
    """Flies a path in the room, from its start, by the poses as they arrive.

    Args:
        controller: That commands the vehicle.
        vehicle: What flies.
        conditions: Air, mocap, radio.
        path: To be followed.
        space: Whose fence ends the flight.
        seed: Of everything random in the room.
    """
    room = FlightRoom(vehicle, conditions, seed, path.start)
    steering, period = at_rest(np.array(path.start)), controller.period
    ticks = int(path.duration / period)
    times, poses, failed = [], [], False
    lower, upper = np.array(space.lower), np.array(space.upper)
    for k in range(ticks):
        t = k * period
        arrived = [sample for sample in room.advance(round(t * 1e9)) if sample.stream == "pose"]
        if arrived:
            last = arrived[-1]
            steering = seen(controller, steering, last.stamp * 1e-9, _pose(last.values), path)
        steering, command = commanded(controller, steering, t, path)
        room.send(command.tolist())
        if k % LOOK == 0:
            true = room.truth()
            times.append(t)
            poses.append(_pose((*true.position, *true.quaternion)))
            if failed := bool((poses[-1][:3] < lower).any() or (poses[-1][:3] > upper).any()):
                break
    time, pose = np.array(times), np.array(poses)
    pose[:, 3] = np.unwrap(pose[:, 3])
    return Trial(path, time, pose, path.at(time)[0], steering.saturated / max(k + 1, 1), failed)


def _pose(values: tuple[float, ...]) -> Array:
    w, x, y, z = (np.array(part) for part in values[3:7])
    return np.array([*values[:3], float(yaw_from_quaternion(w, x, y, z))])


def tracking_error(trial: Trial) -> TrackingError:
    """The errors of a flight."""
    steps = trial.path.shape == "steps"
    if trial.failed:
        return TrackingError(np.inf, np.inf, np.inf if steps else None, np.inf if steps else None)
    counted = trial.time >= WAIT
    error = (trial.pose - trial.reference)[counted]
    overshoot, settling = _steps(trial) if steps else (None, None)
    return TrackingError(
        float(np.sqrt(np.mean(np.sum(error[:, :3] ** 2, axis=1)))),
        float(np.sqrt(np.mean(error[:, 3] ** 2))),
        overshoot,
        settling,
    )


def _steps(trial: Trial) -> tuple[float, float]:
    """Largest overshoot, and median settling time of the steps; one that does not settle takes the whole hold."""
    beyond, settled = [], []
    levels = np.vstack([np.zeros(4), STEPS]) * np.array([trial.path.size] * 3 + [1.0])
    for number, (before, after) in enumerate(pairwise(levels)):
        start = WAIT + number * HOLD
        inside = (trial.time >= start) & (trial.time < start + HOLD)
        for axis in np.flatnonzero(after != before):
            height = after[axis] - before[axis]
            share = (trial.pose[inside, axis] - trial.reference[inside, axis]) / height
            beyond.append(float(share.max()))
            out = np.flatnonzero(np.abs(share) > BAND)
            settled.append(float(trial.time[inside][out[-1]] - start) if out.size else 0.0)
    return max(beyond), float(np.median(settled))
