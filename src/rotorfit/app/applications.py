"""The public functions that use a model: simulate, convert, plan the next flight, fly it, tune, export."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy.typing as npt

from rotorfit.app.inputs import (
    CardLike,
    FilePath,
    Flights,
    ModelLike,
    as_array,
    as_axes,
    as_card,
    as_logs,
    as_model,
    as_number,
    as_whole,
    as_word,
    joined,
    named,
    path_text,
)
from rotorfit.core.card import Card
from rotorfit.core.errors import LinkError
from rotorfit.core.flight_data import Flight
from rotorfit.core.flight_plan import Flown, Plan, Status
from rotorfit.core.frames import AXES
from rotorfit.core.model import Model
from rotorfit.core.progress import Progress
from rotorfit.core.results import Fit, Validation

if TYPE_CHECKING:
    from rotorfit.control.control_law import Kind
    from rotorfit.control.tuning import Tuning
    from rotorfit.dynamics.trajectory import StateSpace, Trajectory
    from rotorfit.exports import Export


def simulate(
    model: ModelLike,
    command_time: npt.ArrayLike,
    command: npt.ArrayLike,
    time: npt.ArrayLike,
    pose: npt.ArrayLike | None = None,
    velocity: npt.ArrayLike | None = None,
) -> Trajectory:
    """Simulates the motion under held commands from a given state.

    An axis whose coefficients are not all known moves by the likelihood's point, as in an export with `predictor=True`;
    one without such a point keeps its velocity.

    Args:
        model: A model, a fit, or a model file.
        command_time: Increasing stamps, shape (M,) [s]. A command holds until the next; before the first, and until
            its delay has passed, there is none.
        command: x, y, z, yaw commands in the heading frame, shape (M, 4) [unit of the card's command].
        time: Increasing times of the result, shape (N,) [s]; the motion starts at the first.
        pose: World x, y, z [m] and yaw [rad] at the first time, shape (4,); the origin by default.
        velocity: Rate of `pose`, shape (4,) [m/s, rad/s]; zero by default.

    Returns:
        Pose and velocity at these times, world frame, without trim and disturbance.

    Raises:
        TypeError: `model` is not a model, or an array has another shape.
        ModelError: The model file cannot be used; no times, times that do not increase, or a number that is not finite.
    """
    from rotorfit.dynamics import trajectory

    known = as_model(model)
    when, until = as_array(command_time, (None,), "command_time"), as_array(time, (None,), "time")
    what = as_array(command, (when.size, 4), "command")
    start = None if pose is None else as_array(pose, (4,), "pose")
    speed = None if velocity is None else as_array(velocity, (4,), "velocity")
    return trajectory.simulate(known, when, what, until, start, speed)


def state_space(model: ModelLike) -> StateSpace:
    """The model as a linear state space with input delays, at a fixed heading.

    Args:
        model: A model, a fit, or a model file.

    Returns:
        The matrices A, B and C, and the delay of each input.

    Raises:
        TypeError: `model` is not a model.
        ModelError: No axis has numbers, the structure of one is not linear, or the file cannot be used.
    """
    from rotorfit.dynamics import trajectory

    return trajectory.state_space(as_model(model))


def convert(model: ModelLike, limits: str | Mapping[str, Any]) -> Model:
    """Converts a model to other limits: the same vehicle under another tilt, climb, rotation or speed limit.

    Args:
        model: A model, a fit, or a model file.
        limits: A text such as `tilt=20deg,vertical_speed=2`, or a mapping as in `[limits]` of a card.

    Returns:
        The converted model.

    Raises:
        TypeError: `model` is not a model, or `limits` are not limits.
        ModelError: The model cannot be converted like this, or its file cannot be used.
        CardError: There is no such limit.
    """
    from rotorfit.core.limits import limits_from_text
    from rotorfit.dynamics import other_limits

    if not isinstance(limits, str | Mapping):
        raise TypeError(f"limits are a text or a mapping, not {named(limits)}")
    return other_limits.convert(as_model(model), limits_from_text(limits) if isinstance(limits, str) else limits)


def plan(
    card: CardLike | None = None,
    *,
    after: ModelLike | None = None,
    design: str | None = None,
    room: str | Sequence[float] | None = None,
    box: str | Sequence[float] | None = None,
    axes: str | Sequence[str] | None = None,
    open_loop: bool = False,
    duration: float = 60.0,
    amplitude: float | None = None,
    speed: float | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> Plan:
    """Designs a flight and predicts what it will tell.

    Args:
        card: The vehicle's card, with its limits; `sim:VEHICLE` for a simulated one. None with `after`.
        after: A model, to design the flight that adds most to it. None with `card`.
        design: Design of the signals, such as `multisine` or `optimal`; None for the default.
        room: Length, width and height [m], or `6x4x3`; the origin is at the centre of its floor.
        box: The fence itself, x0, y0, z0, x1, y1, z1 [m], in place of `room`.
        axes: Axes to excite; None for all, or after a model for those that are least known.
        open_loop: Whether to leave out the feedback on all axes.
        duration: Longest duration [s].
        amplitude: Factor on the full amplitude; None for the largest that fits.
        speed: Largest horizontal speed [m/s]; None for 1.5.
        seed: Seed of sequences and draws.
        progress: Called with a fraction and a text; raising in it cancels.

    Returns:
        The plan, to be saved, edited and flown.

    Raises:
        TypeError: `after` is not a model, or another argument has the wrong type.
        PlanError: Neither or both of card and model are given, the design is unknown, or there is no space to fly in.
        CardError, ModelError: The card or the model file cannot be used.
    """
    from rotorfit.planning.request import Request, planned

    request = Request(
        card if card is None or isinstance(card, Card) else path_text(card),
        as_model(after) if isinstance(after, Model | Fit) else None if after is None else path_text(after),
        None if design is None else as_word(design, "design"), joined(room, "x"), joined(box, ","),
        None if axes is None else as_axes(axes), False, open_loop, as_number(duration, "a duration"),
        None if amplitude is None else as_number(amplitude, "an amplitude"),
        None if speed is None else as_number(speed, "a speed"), as_whole(seed, "a seed"),
    )  # fmt: skip
    return planned(request, progress)[0][0]


def fly(
    plan: Plan | FilePath,
    link: str,
    path: FilePath,
    *,
    card: CardLike | None = None,
    poses: str = "",
    land: bool = True,
    take_off: bool = False,
    seed: int = 0,
    real_vehicle: bool = False,
    status: Callable[[Status], None] | None = None,
) -> Flown:
    """Flies a plan under guard and records it; Ctrl-C ends the flight in hover.

    Args:
        plan: A plan, or its file.
        link: `sim`, `sim:VEHICLE,wind=1,gusts=0.3`, `replay:FILE`, `ros1`, `ros2`, `mavlink` or `tello`.
        path: Path of the recording, a file that does not exist yet.
        card: The vehicle's settings and connection now; None for the plan's card.
        poses: `NAME:ADDRESS` of another link that gives the poses; empty for the vehicle's own.
        land: Whether the vehicle lands at the end.
        take_off: Whether it begins on the floor.
        seed: Seed of a simulated vehicle.
        real_vehicle: Whether a link to a real vehicle is allowed; without it only simulations and replays are flown.
        status: Called with reports of progress a few times a second; it must return at once.

    Returns:
        How the flight ended; its `reason` is `completed`, or what ended it.

    Raises:
        TypeError: An argument has the wrong type.
        PlanError, CardError: The plan or the card cannot be used.
        LinkError: The link cannot be opened, a preflight check failed, or the vehicle is real and not allowed.
        LogError: The file of the recording exists already, or cannot be written.
    """
    from rotorfit.flying.mission import flown_mission, mission
    from rotorfit.flying.preflight import refuse

    given = plan if isinstance(plan, Plan) else path_text(plan)
    to, where, chosen = as_word(link, "link"), Path(path_text(path)), as_card(card)
    with mission(
        given, to, where, chosen, take_off, as_whole(seed, "a seed"), as_word(poses, "link of poses")
    ) as wanted:
        refuse(wanted.ready)
        if wanted.link.live and not real_vehicle:
            raise LinkError(f"{link} moves a real vehicle: nothing was flown; allow it with real_vehicle=True")
        flown = flown_mission(wanted, land, lambda: nullcontext(status))
    return replace(flown, notes=(*wanted.ready.notes, *flown.notes))


def tune(
    model: ModelLike,
    design: Kind = "predictor",
    *,
    path: FilePath | None = None,
    rate: float | None = None,
    latency: float = 0.015,
    axes: str | Sequence[str] = AXES,
    peak: float = 1.7,
    draws: int = 200,
    seed: int = 0,
) -> Tuning:
    """Gains of a position controller, as fast as the model's uncertainty allows.

    Args:
        model: A model, a fit, or a model file.
        design: `predictor`, `lqr` or `linearising`.
        path: Path of the gains file to write, `.toml` or `.yaml`; None writes nothing.
        rate: Command rate, 5 to 500, with a fresh pose for each command [1/s]; None is 50, or that of the poses of the
            model's flights where these were fewer.
        latency: Time from the exposure of a pose to the command that uses it, 0 to 0.5 [s].
        axes: Axes to tune.
        peak: Highest peak of the sensitivity for 95 % of the vehicles drawn, 1.2 to 3.
        draws: Number of vehicles drawn from the covariance, at least 20.
        seed: Seed of the draws.

    Returns:
        Gains and margins of the axes that the model knows well enough, and why the others have none.

    Raises:
        TypeError: `model` is not a model, or another argument has the wrong type.
        ModelError: No axis can be tuned, or the design, rate, latency, peak or number of draws is not possible.
        RotorfitError: There is no such axis.
    """
    from rotorfit.control import tuning
    from rotorfit.exports.gains import save_gains

    known = as_model(model)
    made = tuning.tune(
        known, cast("Kind", as_word(design, "design")), rate=None if rate is None else as_number(rate, "a rate"),
        latency=as_number(latency, "a latency"), axes=as_axes(axes), peak=as_number(peak, "a peak"),
        draws=as_whole(draws, "a count of draws"), seed=as_whole(seed, "a seed"),
    )  # fmt: skip
    if path is not None:
        save_gains(made, known, path_text(path))
    return made


def export(
    model: ModelLike,
    to: str,
    path: FilePath | None = None,
    *,
    dt: float = 0.02,
    predictor: bool = False,
    physical: bool = False,
    round_delay: bool = False,
    training: Sequence[Flight] | None = None,
    flights: Flights = (),
    name: str | None = None,
) -> Export:
    """Exports a model for a controller, an estimator or a simulator.

    Args:
        model: A model, a fit, or a model file.
        to: Name of a format, as `rotorfit export` lists them.
        path: Path to write, which is overwritten; None writes nothing.
        dt: Sample period of the C header, and of rounded delays [s].
        predictor: Whether to also export axes that are not identifiable, at the point that predicts best.
        physical: Whether commands are in SI units where the card has fractions of a limit.
        round_delay: Whether to round delays to whole samples of dt; the file states by how much.
        training: The flights of the fit, for the speeds at which the model was trained; None for those of the fit, or
            those whose logs are still in place.
        flights: Flights as in `validate`, on which the exported numbers are scored, for the header; without any, the
            model's own leave-one-out scores.
        name: Name of the vehicle in the file; None for that of the path, else of the card.

    Returns:
        The export, with its text and notes.

    Raises:
        TypeError: `model` is not a model, or another argument has the wrong type.
        ExportError: The format is unknown, it cannot hold a structure of the model, or no axis is left.
        ModelError: The model file cannot be used.
        LogError, CardError, FlightError: As in `validate`.
    """
    from rotorfit import exports
    from rotorfit.app import workflows
    from rotorfit.exports.validity import trained_on

    logs = as_logs(flights)
    if training is None:
        training = model.flights if isinstance(model, Fit) else workflows.training_flights(as_model(model))[0]
    named_or_known = path_text(model) if isinstance(model, str | PathLike) else as_model(model)

    def score(exported: Model) -> Validation:
        return workflows.validate_logs(exported, logs)[0]

    return exports.export(
        named_or_known, as_word(to, "format"), None if path is None else Path(path_text(path)),
        dt=as_number(dt, "a period"), predictor=predictor, physical=physical, round_delay=round_delay,
        name=None if name is None else as_word(name, "vehicle"), trained=trained_on(training),
        score=score if logs else None,
    )  # fmt: skip
