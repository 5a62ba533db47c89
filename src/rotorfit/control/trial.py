"""A controller tried in the virtual flight room: how far the vehicle is from its reference path, at true instants."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from rotorfit.control.control_law import AxisLaw
from rotorfit.control.controller import (
    HOLD,
    STEPS,
    WAIT,
    AxisControllers,
    ReferencePath,
    Shape,
    at_rest,
    commanded,
    observe,
    within,
)
from rotorfit.control.tuning import Tuning
from rotorfit.core.errors import ModelError
from rotorfit.core.flight_plan import Space
from rotorfit.core.frames import AXES, Array, yaw_from_quaternion
from rotorfit.core.limits import disagreement
from rotorfit.core.model import Model
from rotorfit.files.cards import card_from_mapping
from rotorfit.planning.request import space_of_room
from rotorfit.simulation.air import wind_of
from rotorfit.simulation.flight_room import Conditions, FlightRoom
from rotorfit.simulation.vehicle import Vehicle, load_vehicle

LOOK = 2
"""The truth is looked at every so many commands."""

ROOM = "6x6x4"

DURATIONS: Mapping[Shape, float] = {"circle": 28.0, "lemniscate": 28.0, "steps": WAIT + HOLD * len(STEPS)}
"""Room [m] and paths [s] of `try_tuning`."""

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


@dataclass(frozen=True)
class PathScore:
    """How a controller followed one path, over several seeds; medians, infinite where most flights failed.

    Attributes:
        path: What was to be followed.
        error: Medians over the seeds.
        saturated: Mean share of the commands that full scale has bounded.
        failed: Flights that left the space.
        flights: How many.
    """

    path: ReferencePath
    error: TrackingError
    saturated: float
    failed: int
    flights: int


def try_tuning(tuning: Tuning, model: Model, address: str, seeds: int = 3) -> tuple[PathScore, ...]:
    """Tries gains on a circle, a lemniscate and steps in a room of 6 x 6 x 4 m.

    The paths are flown at no more than 1 m/s, half of the speed of full commands and the speed whose turns take 0.3 of
    the full acceleration, as the model has them: where a linear model may be trusted.

    Args:
        tuning: Gains of all four axes.
        model: That they come from.
        address: `VEHICLE,wind=MEAN,gusts=SIGMA`, as of the link `sim`.
        seeds: Flights of each path, with the seeds 1, 2, 3 ...

    Raises:
        ModelError: An axis has no gains, or the model's commands mean something else to this vehicle.
        VehicleError: No such vehicle.
        LinkError: An option that nobody knows.
    """
    name, *options = address.split(",")
    vehicle = load_vehicle(name)
    if missing := [axis for axis in AXES if axis not in tuning.axes]:
        raise ModelError(f"no gains for {', '.join(missing)}: all four axes must be held to try them in flight")
    if trouble := disagreement(model.card, card_from_mapping(vehicle.card(), vehicle.name)):
        raise ModelError(f"the model's card is not one of {vehicle.name}: {trouble}; try another vehicle")
    controller, space = controller_of(tuning, vehicle), space_of_room(ROOM)
    conditions = Conditions(wind=wind_of(options, address))
    out = []
    for shape, duration in DURATIONS.items():
        path = ReferencePath(shape, 1.0, _speed(controller), duration)
        within(path, space)
        trials = [try_path(controller, vehicle, conditions, path, space, 1 + i) for i in range(seeds)]
        errors = [tracking_error(trial) for trial in trials]
        columns = [[getattr(error, part) for error in errors] for part in vars(errors[0])]
        middle = TrackingError(*(None if None in column else float(np.median(column)) for column in columns))  # type: ignore[arg-type]
        share = float(np.mean([trial.saturated for trial in trials]))
        out.append(PathScore(path, middle, share, sum(trial.failed for trial in trials), seeds))
    return tuple(out)


def scores_mapping(scores: Sequence[PathScore]) -> dict[str, dict[str, float | int | None]]:
    """Scores by the name of the path as plain JSON types; None where most flights failed."""
    return {
        one.path.shape: {
            "speed": one.path.speed,
            **{
                name: value if value is not None and np.isfinite(value) else None
                for name, value in vars(one.error).items()
            },
            "saturated": one.saturated,
            "failed": one.failed,
            "flights": one.flights,
        }
        for one in scores
    }


def _speed(controller: AxisControllers) -> float:
    """Of a path of 1 m that stays where the model is linear [m/s]."""
    reach = [law.input * scale for law, scale in zip(controller.laws.values(), controller.full_scale, strict=True)][:2]
    steady = [full / max(controller.laws[axis].damping, 1e-3) for axis, full in zip("xy", reach, strict=True)]
    return float(min(1.0, *(0.5 * speed for speed in steady), *(np.sqrt(0.3 * full) for full in reach)))


def controller_of(laws: Tuning | Mapping[str, AxisLaw], vehicle: Vehicle) -> AxisControllers:
    """A controller for a vehicle of the room: gains that were tuned, or laws from elsewhere, and its full scale."""
    of_axes = {axis: one.law for axis, one in laws.axes.items()} if isinstance(laws, Tuning) else dict(laws)
    return AxisControllers(of_axes, np.array(vehicle.limits()) / np.array(vehicle.full_scale()))


def try_path(
    controller: AxisControllers, vehicle: Vehicle, conditions: Conditions, path: ReferencePath, space: Space, seed: int
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
            steering = observe(controller, steering, last.stamp * 1e-9, _pose(last.values), path)
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
