"""Rows of the tables that report, terminal and studio draw: coefficients beside the paper's, pooled scores.

Numbers are in SI; the unit that a reader sees is `SPEED` and `LENGTH` of an axis.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES
from rotorfit.core.laws import structure_named
from rotorfit.core.model import COEFFICIENTS, Model
from rotorfit.core.results import FlightScores, Validation

SPEED = {axis: ("deg/s", 180 / np.pi) if axis == "yaw" else ("cm/s", 100.0) for axis in AXES}
"""Unit of a velocity error for people, and the factor from SI."""

LENGTH = {axis: ("deg", 180 / np.pi) if axis == "yaw" else ("cm", 100.0) for axis in AXES}
"""Unit of a position error for people, and the factor from SI."""

_UNITS = {"natural_frequency": "rad/s", "damping_ratio": "", "damping_at_rest": "1/s", "quadratic_drag": "1/m or 1/rad"}
"""Units of combinations that are not seconds."""


@dataclass(frozen=True)
class HorizonErrors:
    """Errors at one horizon over all validation flights that command the axis, SI; None where there is no number.

    Attributes:
        axis: Name.
        horizon: [s].
        velocity: `model`, `hold`, `paper` to velocity RMSE.
        position: The same of the end point.
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
        axis: Name.
        name: `input`, `damping`, `delay`, a further parameter of the structure, or a combination such as `total_lag`.
        symbol: The paper's, such as g1; empty where it has none.
        unit: As text.
        value: Estimate.
        stderr: Standard error.
        low: Lower end of the 95 % interval.
        high: Upper end.
        status: Of the coefficient; of a combination `ok`, or `open` where an end is missing.
        paper: What the paper's regression gives on the same data.
    """

    axis: str
    name: str
    symbol: str
    unit: str
    value: float | None
    stderr: float | None
    low: float | None
    high: float | None
    status: str
    paper: float | None


def coefficient_rows(model: Model) -> tuple[CoefficientRow, ...]:
    """Coefficients and their identifiable combinations, axis by axis, with the paper's beside them."""
    rows = []
    for k, name in enumerate(AXES):
        axis, per = model.axes[name], command_unit(model, name)
        gain, damping = model.paper[2 * k : 2 * k + 2]
        papers = {"input": gain, "damping": damping, "steady_gain": None, "total_lag": None}
        if gain is not None and damping:
            papers |= {"steady_gain": gain / damping, "total_lag": 1 / damping if damping > 0 else None}
        rate = "rad/s" if name == "yaw" else "m/s"
        units = {"input": f"{rate}² per {per}", "damping": "1/s", "steady_gain": f"{rate} per {per}", **_UNITS}
        units |= {"input_up": units["input"], "input_down": units["input"]}
        for number, coefficient in enumerate(COEFFICIENTS):
            low, high = axis.ci95.get(coefficient, (None, None))
            rows.append(
                CoefficientRow(
                    name, coefficient, f"g{2 * k + number + 1}" if number < 2 else "",
                    units.get(coefficient, "s"), getattr(axis, coefficient), axis.stderr.get(coefficient), low, high,
                    axis.status.get(coefficient, "not_identifiable"), papers.get(coefficient),
                )
            )  # fmt: skip
        for extra in structure_named(axis.structure).extras if axis.predictor else ():
            low, high = axis.ci95.get(extra.name, (None, None))
            unit = {"speed": rate, "gain": f"{rate}² per {per}", "command": per}.get(extra.unit, extra.unit)
            value, error = axis.extra[extra.name], axis.stderr.get(extra.name)
            status = axis.status.get(extra.name, "given")
            rows.append(CoefficientRow(name, extra.name, "", unit, value, error, low, high, status, None))
        for combination, known in axis.combinations.items():
            low, high = known.ci95
            status = "ok" if low is not None and high is not None else "open"
            unit, paper = units.get(combination, "s"), papers.get(combination)
            rows.append(CoefficientRow(name, combination, "", unit, known.value, None, low, high, status, paper))
    return tuple(rows)


def command_unit(model: Model, axis: str) -> str:
    """Unit of a command of the model's card, for people."""
    channel = model.card.command.get(axis)
    if channel is None:
        return "unit of command"
    if channel.full_scale:
        return f"full {channel.full_scale.replace('_', ' ')}"
    units = {"tilt": "rad", "velocity": "m/s", "vertical_speed": "m/s", "yaw_rate": "rad/s"}
    return units.get(channel.meaning or "", "unit of command")


def scores_of(validation: Validation, flights: Sequence[Flight]) -> tuple[HorizonErrors, ...]:
    """Scores pooled over the flights that command the axis and were not fitted, weighted by the number of predictions.

    Args:
        validation: Scores, flight by flight.
        flights: The same flights, to tell what they command; where they are not at hand all scores count.
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
    squares, n = np.zeros(2), 0
    for flight in flights:
        errors = flight.axes[axis].horizons.get(key)
        if errors and errors.velocity_rmse is not None and errors.position_rmse is not None:
            squares += errors.n * np.array([errors.velocity_rmse, errors.position_rmse]) ** 2
            n += errors.n
    if not n:
        return None, None, 0
    velocity, position = np.sqrt(squares / n)
    return float(velocity), float(position), n
