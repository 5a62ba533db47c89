"""A controller tried in the virtual flight room: distance of the true vehicle from its reference path."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
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
from rotorfit.core.plain import by_reason
from rotorfit.files.cards import card_from_mapping
from rotorfit.planning.request import space_of_room
from rotorfit.simulation.air import Wind, wind_of
from rotorfit.simulation.flight_room import Conditions, FlightRoom
from rotorfit.simulation.sensors import Mocap
from rotorfit.simulation.vehicle import Vehicle, load_vehicle

LOOK = 2
"""Number of commands between two samples of the truth."""

ROOM = "6x6x4"

DURATIONS: Mapping[Shape, float] = {"circle": 28.0, "lemniscate": 28.0, "steps": WAIT + HOLD * len(STEPS)}
"""Room [m], and paths with their durations [s], of `try_tuning`."""

BAND = 0.1
"""A step has settled when it stays within this share of its height."""


@dataclass(frozen=True)
class Trial:
    """One flight, with N samples of the truth.

    Attributes:
        path: The reference path.
        time: Sample times, shape (N,) [s].
        pose: True world x, y, z [m] and unwrapped yaw [rad], shape (N, 4).
        reference: Reference at these times, world, shape (N, 4).
        saturated: Share of the commands that full scale bounded on some axis.
        failed: Whether the vehicle left the space, which ended the flight.
    """

    path: ReferencePath
    time: Array
    pose: Array
    reference: Array
    saturated: float
    failed: bool


@dataclass(frozen=True)
class TrackingError:
    """Tracking errors of a flight after the first hover; infinite if the flight failed.

    Attributes:
        position: RMS distance from the reference [m].
        heading: RMS error of the heading [rad].
        overshoot: Largest overshoot of the steps, as a share of their height; None without steps.
        settling: Median time from a step until the axis stays within a tenth of its height [s]; None without steps.
    """

    position: float
    heading: float
    overshoot: float | None
    settling: float | None


@dataclass(frozen=True)
class PathScore:
    """How a controller followed one path, over several seeds.

    Attributes:
        path: The reference path.
        error: Medians over the seeds; infinite if most flights failed.
        saturated: Mean share of the commands that full scale bounded.
        failed: Number of flights that left the space.
        flights: Number of flights.
        pose_age: Mean age of the pose that a command used [s].
    """

    path: ReferencePath
    error: TrackingError
    saturated: float
    failed: int
    flights: int
    pose_age: float


def try_tuning(tuning: Tuning, model: Model, address: str, seeds: int = 3) -> tuple[PathScore, ...]:
    """Tries gains on a circle, a lemniscate and steps in a room of 6 x 6 x 4 m.

    A fresh pose comes for each command, as old as the gains are for, or as young as frames of this rate can be.
    The speed is at most 1 m/s, half the steady speed at full command, and the speed whose turns take 0.3 of the full
    acceleration, all according to the model: there a linear model may be trusted.

    Args:
        tuning: Gains of all four axes.
        model: The model that they come from.
        address: `VEHICLE,wind=MEAN,gusts=SIGMA`, as for the link `sim`.
        seeds: Number of flights of each path, with the seeds 1, 2, 3 ...

    Raises:
        ModelError: An axis has no gains, or the model's commands have another meaning than those of this vehicle.
        VehicleError: There is no such vehicle.
        LinkError: The address has an unknown option.
        PlanError: A path does not fit into the room or exceeds its speeds.
    """
    vehicle, wind = trial_vehicle(model, address)
    _all_held({axis: tuning.refused.get(axis, "not in --axes") for axis in AXES if axis not in tuning.axes})
    controller, space = controller_of(tuning, vehicle), space_of_room(ROOM)
    mocap = _mocap(tuning)
    conditions = Conditions(wind=wind, mocap=mocap)
    out = []
    for shape, duration in DURATIONS.items():
        path = ReferencePath(shape, 1.0, _speed(controller), duration)
        within(path, space)
        trials = [try_path(controller, vehicle, conditions, path, space, 1 + i) for i in range(seeds)]
        errors = [tracking_error(trial) for trial in trials]
        columns = [[getattr(error, part) for error in errors] for part in vars(errors[0])]
        middle = TrackingError(*(None if None in column else float(np.median(column)) for column in columns))  # type: ignore[arg-type]
        share = float(np.mean([trial.saturated for trial in trials]))
        out.append(PathScore(path, middle, share, sum(trial.failed for trial in trials), seeds, _age(mocap)))
    return tuple(out)


def trial_vehicle(model: Model, address: str, axes: Sequence[str] = AXES) -> tuple[Vehicle, Wind]:
    """The vehicle and the wind of an address, for gains that are yet to be tuned for some axes.

    Raises:
        ModelError, VehicleError, LinkError: As `try_tuning`.
    """
    name, *options = address.split(",")
    vehicle, wind = load_vehicle(name), wind_of(options, f"--try {address}")
    card, named = card_from_mapping(vehicle.card(), vehicle.name), ("the model's card", "the vehicle's")
    if trouble := disagreement(model.card, card, named):
        raise ModelError(f"the model's card is not one of {vehicle.name}: {trouble}; try another vehicle")
    _all_held({axis: "not in --axes" for axis in AXES if axis not in axes})
    return vehicle, wind


def _all_held(missing: Mapping[str, str]) -> None:
    """Refuses a trial without gains of all axes; `missing`: axis name to the reason."""
    if missing:
        raise ModelError(f"all four axes must be held to try gains in flight; none for {by_reason(missing)}")


def _mocap(tuning: Tuning) -> Mocap:
    """Motion capture with the rate and the age of poses that gains are for."""
    fast = replace(Mocap(), rate=max(Mocap.rate, tuning.rate), latency=0.0)
    return replace(fast, latency=max(tuning.latency - _age(fast), 0.0))


def _age(mocap: Mocap) -> float:
    """Mean age of the newest pose at a command [s]: it waits for half a frame."""
    return mocap.latency + mocap.jitter + 0.5 / mocap.rate


def scores_mapping(scores: Sequence[PathScore]) -> dict[str, dict[str, float | int | None]]:
    """Scores by the name of the path, as plain JSON types; errors are None if most flights failed."""
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
            "pose_age": one.pose_age,
        }
        for one in scores
    }


def _speed(controller: AxisControllers) -> float:
    """Speed of a path of size 1 m within the range in which the model is linear [m/s]."""
    reach = [law.input * scale for law, scale in zip(controller.laws.values(), controller.full_scale, strict=True)][:2]
    steady = [full / max(controller.laws[axis].damping, 1e-3) for axis, full in zip("xy", reach, strict=True)]
    return float(min(1.0, *(0.5 * speed for speed in steady), *(np.sqrt(0.3 * full) for full in reach)))


def controller_of(laws: Tuning | Mapping[str, AxisLaw], vehicle: Vehicle) -> AxisControllers:
    """A controller for a simulated vehicle: tuned gains, or laws from elsewhere, with the vehicle's full scale."""
    of_axes = {axis: one.law for axis, one in laws.axes.items()} if isinstance(laws, Tuning) else dict(laws)
    return AxisControllers(of_axes, np.array(vehicle.limits()) / np.array(vehicle.full_scale()))


def try_path(
    controller: AxisControllers, vehicle: Vehicle, conditions: Conditions, path: ReferencePath, space: Space, seed: int
) -> Trial:
    """Flies a path in the room from its start, using the poses as they arrive.

    Args:
        controller: The controller.
        vehicle: The vehicle.
        conditions: Air, motion capture, radio.
        path: The reference path.
        space: The space; leaving it ends the flight.
        seed: Seed of everything random in the room.
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
    """The tracking errors of a flight."""
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
    """Largest overshoot and median settling time of the steps [s]; a step that never settles counts with `HOLD`."""
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
