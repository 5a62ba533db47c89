"""Rows of the tables of report, terminal and studio: coefficients beside the paper's, pooled scores.

Numbers are in SI; `SPEED` and `LENGTH` give the units in which they are shown.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES, POSE_UNITS
from rotorfit.core.laws import given_by_law, structure_named
from rotorfit.core.limits import COMMAND_UNITS
from rotorfit.core.model import COEFFICIENTS, Interval, Model
from rotorfit.core.results import FlightScores, Validation

SPEED = {axis: ("deg/s", 180 / np.pi) if axis == "yaw" else ("cm/s", 100.0) for axis in AXES}
"""Unit in which a velocity error is shown, and the factor from SI."""

LENGTH = {axis: ("deg", 180 / np.pi) if axis == "yaw" else ("cm", 100.0) for axis in AXES}
"""Unit in which a position error is shown, and the factor from SI."""


@dataclass(frozen=True)
class HorizonErrors:
    """Errors at one horizon over all validation flights that command the axis, in SI; None where there is no number.

    Attributes:
        axis: Name of the axis.
        horizon: Prediction horizon [s].
        velocity: `model`, `hold`, `paper`, `coast` to velocity RMSE [m/s or rad/s].
        position: The same for the position at the end of the prediction [m or rad].
        n: Number of predictions.
    """

    axis: str
    horizon: float
    velocity: Mapping[str, float | None]
    position: Mapping[str, float | None]
    n: int


@dataclass(frozen=True)
class CoefficientRow:
    """One row of the table of coefficients; None where there is no number.

    Attributes:
        axis: Name of the axis.
        name: `input`, `damping`, `delay`, a further parameter of the structure, or a combination such as `total_lag`.
        symbol: The paper's symbol, such as g1; empty if it has none.
        kind: `coefficient`, `parameter` of the structure, or `combination`.
        unit: Unit in SI, such as `m/s^2`; `command` for the unit of the command itself.
        per: Unit of the command, if the unit is per command or that of the command; otherwise empty.
        value: Estimate.
        stderr: Standard error.
        low: Lower end of the 95 % interval.
        high: Upper end of the 95 % interval.
        status: Status of the coefficient; of a combination `ok`, or `open` if an end is missing.
        paper: Estimate of the paper's regression from the same data.
        flight: 95 % interval for these flights alone, if that for the vehicle differs.
        next_flight: 95 % interval for another flight, where several flights tell how flights differ.
        given: Whether the law fixes the value, instead of the data.
    """

    axis: str
    name: str
    symbol: str
    kind: str
    unit: str
    per: str
    value: float | None
    stderr: float | None
    low: float | None
    high: float | None
    status: str
    paper: float | None
    flight: Interval | None = None
    next_flight: Interval | None = None
    given: bool = False


def coefficient_rows(model: Model) -> tuple[CoefficientRow, ...]:
    """Coefficients and their identifiable combinations, for each axis, with the paper's beside them."""
    return tuple(row for name in AXES for row in _axis_rows(model, name))


def _axis_rows(model: Model, name: str) -> Iterator[CoefficientRow]:
    k, axis, per = AXES.index(name), model.axes[name], command_unit(model, name)
    gain, damping = model.paper[2 * k : 2 * k + 2]
    papers = {"input": gain, "damping": damping}
    if gain is not None and damping:
        papers |= {"steady_gain": gain / damping, "total_lag": 1 / damping if damping > 0 else None}
    rate = f"{POSE_UNITS[name]}/s"
    own = {"speed": rate, "acceleration": f"{rate}^2", "gain": f"{rate}^2"}
    units = {"damping": "1/s", "damping_at_rest": "1/s", "natural_frequency": "rad/s", "damping_ratio": ""} | {
        "input": f"{rate}^2", "input_up": f"{rate}^2", "input_down": f"{rate}^2", "steady_gain": rate,
        "quadratic_drag": f"1/{POSE_UNITS[name]}",
    }  # fmt: skip

    def row(
        part: str, kind: str, unit: str, of_command: bool, value: float | None, ends: Interval, status: str
    ) -> CoefficientRow:
        """A row of this axis, with symbol, standard error and the paper's value where its kind has them."""
        symbol = f"g{2 * k + COEFFICIENTS.index(part) + 1}" if part in COEFFICIENTS[:2] else ""
        error = axis.stderr.get(part) if kind != "combination" else None
        paper = papers.get(part) if kind != "parameter" else None
        flight = axis.combinations[part].ci95_flight if kind == "combination" else axis.ci95_flight.get(part)
        spread = axis.spread.get(part)
        other = spread.next_flight if spread and spread.source == "flights" else None
        given = axis.predictor is not None and part in given_by_law(axis.structure)
        return CoefficientRow(
            name, part, symbol, kind, unit, per if of_command else "", value, error, *ends,
            "given" if given else status, paper, flight, other, given,
        )  # fmt: skip

    for part in COEFFICIENTS:
        ends, status = axis.ci95.get(part, (None, None)), axis.status.get(part, "not_identifiable")
        yield row(part, "coefficient", units.get(part, "s"), part == "input", getattr(axis, part), ends, status)
    for extra in structure_named(axis.structure).extras if axis.predictor else ():
        ends, status = axis.ci95.get(extra.name, (None, None)), axis.status.get(extra.name, "given")
        unit, of_command = own.get(extra.unit, extra.unit), extra.unit in ("gain", "command")
        yield row(extra.name, "parameter", unit, of_command, axis.extra[extra.name], ends, status)
    for part, known in axis.combinations.items():
        status = "ok" if None not in known.ci95 else "open"
        of_command = part in ("steady_gain", "input_up", "input_down")
        value = None if known.ci95 == (None, None) else known.value  # of which the data say nothing
        yield row(part, "combination", units.get(part, "s"), of_command, value, known.ci95, status)


def command_unit(model: Model, axis: str) -> str:
    """Unit of a command in the model's card, as shown to users."""
    channel = model.card.command.get(axis)
    if channel is None:
        return "unit of command"
    if channel.full_scale:
        return f"full {channel.full_scale.replace('_', ' ')}"
    return COMMAND_UNITS.get(channel.meaning or "", "unit of command")


def scores_of(validation: Validation, flights: Sequence[Flight]) -> tuple[HorizonErrors, ...]:
    """Scores pooled over the flights that command the axis and were not fitted, weighted by the number of predictions.

    Args:
        validation: Scores of each flight.
        flights: The same flights, to see which axes they command; if they are not available, all scores count.
    """
    known = len(flights) == len(validation.flights)
    by_name = {"model": validation.flights, **validation.baselines}
    out = []
    for axis in AXES:
        fresh = [i for i, scores in enumerate(validation.flights) if not scores.fitted]
        used = [i for i in fresh if not known or axis in flights[i].moved]
        horizons = validation.flights[used[0]].axes[axis].horizons if used else {}
        for key in horizons:
            chosen = {name: [every[i] for i in used] for name, every in by_name.items() if every}
            pooled = {name: _pooled(every, axis, key) for name, every in chosen.items()}
            velocity = {name: result[0] for name, result in pooled.items()}
            position = {name: result[1] for name, result in pooled.items()}
            out.append(
                HorizonErrors(axis, float(key), velocity, position, max(result[2] for result in pooled.values()))
            )
    return tuple(out)


def _pooled(flights: Sequence[FlightScores], axis: str, key: str) -> tuple[float | None, float | None, int]:
    """Velocity RMSE, position RMSE and n at one horizon over several flights."""
    every = [errors for flight in flights if (errors := flight.axes[axis].horizons.get(key))]
    velocity = [(errors.n, errors.velocity_rmse) for errors in every if errors.velocity_rmse is not None]
    position = [(errors.n, errors.position_rmse) for errors in every if errors.position_rmse is not None]
    return _rms(velocity), _rms(position), sum(n for n, _ in velocity)


def _rms(errors: Sequence[tuple[int, float]]) -> float | None:
    """The RMS of RMS errors, each over n; None without any."""
    n = sum(count for count, _ in errors)
    return float(np.sqrt(sum(count * error**2 for count, error in errors) / n)) if n else None
