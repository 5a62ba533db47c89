"""Physics of a model: accelerations, speeds and times, compared with what the card leads one to expect."""

import math
from collections.abc import Callable
from dataclasses import dataclass

from rotorfit.core.frames import AXES, POSE_UNITS
from rotorfit.core.limits import (
    COMMAND_UNITS,
    PEOPLE,
    Figure,
    Meaning,
    Quantity,
    expectation,
    limit_that_gives,
    meaning_of,
)
from rotorfit.core.model import STRUCTURE, Axis, Model

QUANTITIES = ("acceleration", "steady_speed", "time_constant", "total_lag")
"""The quantities of every axis, in this order."""


def physics(model: Model) -> dict[str, dict[str, Quantity]]:
    """Physical quantities of every axis, each with the model's own 95 % interval carried over.

    `acceleration` is the input gain, `steady_speed` the steady gain: at full command where commands are fractions of a
    limit, per unit of command where they are SI. `time_constant` is 1 / damping, under a second-order
    law the sum of both; `total_lag` is delay + 1 / damping, plus a lag on the input, less a zero.
    A tilt implies an expected acceleration, a commanded speed or rate an expected steady one; see docs/settings.md.

    Args:
        model: A model of any method.

    Returns:
        Axis name to `QUANTITIES` to quantity. A value that neither card nor data determine is None, with a reason.
    """
    return {axis: _quantities(model, axis) for axis in AXES}


def compared(model: Model, axis: str) -> Quantity:
    """The quantity of an axis that its card states: the acceleration for a tilt, else the steady speed."""
    asked = meaning_of(model.card, axis).asked
    return _quantities(model, axis)["acceleration" if asked == "tilt" else "steady_speed"]


def _quantities(model: Model, axis: str) -> dict[str, Quantity]:
    known, meaning = model.axes[axis], meaning_of(model.card, axis)
    length = POSE_UNITS[axis]
    per = f" per {COMMAND_UNITS[meaning.asked]}" if meaning.asked and not meaning.limit else ""
    tilt, no_gain = meaning.asked == "tilt", _why_not(known, "steady_gain")
    return {
        "acceleration": _quantity(_input(known), f"{length}/s^2{per}", meaning, tilt, _why(known, "input")),
        "steady_speed": _quantity(_steady(known), f"{length}/s{per}", meaning, not tilt, no_gain),
        "time_constant": _time(_time_constant(known), _why(known, "damping")),
        "total_lag": _time(_combination(known, "total_lag"), _why_not(known, "total_lag")),
    }


def _quantity(measured: Figure | None, unit: str, meaning: Meaning, expects: bool, why: str | None) -> Quantity:
    """A quantity per command, compared with the card's expectation if `expects`."""
    if meaning.asked is None:
        return Quantity(None, f"{unit} per unit of command", reason=meaning.reason)
    if not expects:
        return Quantity(measured, unit, reason=why)
    expected = expectation(meaning)
    implied = None
    if measured and meaning.limit:
        implied = mapped(measured, lambda reached: limit_that_gives(meaning, reached))
    if expected is None:
        reasons = [why, f"[limits] of the card does not say what {meaning.limit} was set"]
        return Quantity(measured, unit, None, None, implied, "; ".join(reason for reason in reasons if reason))
    ratio = mapped(measured, lambda reached: reached / expected) if measured else None
    return Quantity(measured, unit, expected, ratio, implied, why)


def _time(measured: Figure | None, why: str | None) -> Quantity:
    return Quantity(measured, "s", reason=why)


def mapped(figure: Figure, rising: Callable[[float], float]) -> Figure:
    """An increasing function of a figure, applied to its value and its ends; None stays None."""
    value, low, high = (None if part is None else rising(part) for part in (figure.value, *figure.ci95))
    return Figure(value, (low, high))


def _input(axis: Axis) -> Figure | None:
    return Figure(axis.input, axis.ci95["input"]) if axis.predictor else None


def _steady(axis: Axis) -> Figure | None:
    """The steady gain; the bare ratio for the paper's method, which gives no interval for it."""
    known = _combination(axis, "steady_gain")
    if known or axis.structure != STRUCTURE or axis.input is None or axis.damping is None or axis.damping <= 0:
        return known
    return Figure(axis.input / axis.damping)


def _combination(axis: Axis, name: str) -> Figure | None:
    part = axis.combinations.get(name)
    return None if part is None or part.ci95 == (None, None) else Figure(part.value, part.ci95)


def _time_constant(axis: Axis) -> Figure | None:
    """1 / b; an end of the damping at or below 0 gives an open upper end."""
    if not axis.predictor or (axis.damping is not None and axis.damping <= 0):
        return None
    low, high = (None if end is None or end <= 0 else 1 / end for end in axis.ci95["damping"])
    return Figure(None if axis.damping is None else 1 / axis.damping, (high, low))


def _why(axis: Axis, name: str) -> str | None:
    """Why a coefficient is missing; None where it is known."""
    if name == "damping" and axis.damping is not None and axis.damping <= 0:
        return "the damping is not positive"
    return None if axis.status[name] == "ok" else f"{name}: {axis.status[name]}"


def _why_not(axis: Axis, name: str) -> str | None:
    """Why a combination has no closed interval; None where it has one."""
    if not axis.predictor:
        return _why(axis, "input")
    part = axis.combinations.get(name)
    if part is None and axis.structure != STRUCTURE:
        return f"{name}: under {axis.structure} it depends on the commands"
    if part is None:
        return f"{name}: this method gives no interval of it"
    return f"{name}: its interval is open" if None in part.ci95 else None


@dataclass(frozen=True)
class PhysicsRow:
    """One row of the table of physics, in units for people: angles in degrees.

    Attributes:
        axis: Name.
        name: One of `QUANTITIES`.
        unit: As text.
        measured: Value with its interval.
        expected: None where the card implies no expectation.
        ratio: Measured over expected; None likewise.
    """

    axis: str
    name: str
    unit: str
    measured: Figure
    expected: float | None
    ratio: Figure | None


def physics_rows(model: Model) -> tuple[PhysicsRow, ...]:
    """Rows of the table of physics: what the card has an expectation for, and the time constants.

    Only axes whose commands have a meaning. Quantities that the table of coefficients shows already (steady gain
    without expectation, total lag) are left out.
    """
    rows = []
    for axis, quantities in physics(model).items():
        meaning = meaning_of(model.card, axis)
        compares = "acceleration" if meaning.asked == "tilt" else "steady_speed"
        for name in (compares, "time_constant") if meaning.asked else ():
            part = quantities[name]
            if part.measured is None or part.measured == Figure(None):
                continue
            unit, factor = _for_people(part.unit)
            expected = None if part.expected is None else factor * part.expected
            measured = _scaled(part.measured, factor)
            rows.append(PhysicsRow(axis, name, unit, measured, expected, part.ratio))
    return tuple(rows)


def _for_people(unit: str) -> tuple[str, float]:
    """A unit for people and the factor to it: yaw rates in degrees, no unit for speed per speed."""
    if unit == "rad/s":
        return "deg/s", 180 / math.pi
    over, per, under = unit.partition(" per ")
    return ("" if over == under else f"{over}/{under}" if per else unit), 1.0


def _scaled(figure: Figure, factor: float) -> Figure:
    return mapped(figure, lambda value: factor * value)


def implied_limits(model: Model) -> tuple[str, ...]:
    """One line for each axis whose card names a limit without its setting: the setting that the gain implies."""
    lines = []
    for axis in AXES:
        meaning, implied = meaning_of(model.card, axis), compared(model, axis).implied_limit
        if meaning.limit and meaning.setting is None and implied and implied.value and implied.value > 0:
            word = meaning.limit.replace("_", " ")
            lines.append(f"{axis}: equals a {word} limit of {people(implied, meaning.limit)}; the card gives none")
    return tuple(lines)


def people(figure: Figure, limit: str) -> str:
    """A limit setting with its interval, for people: `20.7 deg (20.1 to 21.3)`."""
    unit, factor = PEOPLE[limit]
    value, low, high = (None if v is None else f"{factor * v:.3g}" for v in (figure.value, *figure.ci95))
    interval = f" ({low or 'open'} to {high or 'open'})" if low or high else ""
    return f"{value} {unit}{interval}"
