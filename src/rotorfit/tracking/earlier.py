"""The model of an earlier flight: reported under its name until this flight tells as much, and compared with it.

The two are not combined: that would pull a vehicle that was changed on the ground towards what it was. As long as this
flight tells fewer of input, damping and delay than the earlier model, the numbers are those of the earlier model, under
its name, unless this flight contradicts one of them. After that they are those of this flight, together with their
difference from the earlier ones,

    z = 1.96 (a - b) / sqrt(h_a^2 + h_b^2)

where a and b are the two values (logarithms, except for times), and h_a and h_b the half widths, on the facing sides,
of their intervals of the vehicle, which include the spread between flights of one vehicle.
`bench/bench_real_coverage.py` counts this statistic on pairs of recorded flights.
"""

import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path

from scipy.special import stdtr

from rotorfit.core.card import Card
from rotorfit.core.errors import CardError
from rotorfit.core.frames import AXES
from rotorfit.core.limits import disagreement
from rotorfit.core.model import COEFFICIENTS, NORMAL, Interval, Model
from rotorfit.core.results import Fit
from rotorfit.core.tracked import QUANTITIES, TIMES, Alarm, TrackedAxis
from rotorfit.files.models import load

SHARE = 0.25
"""Share of the promised false alarms that comparisons with the earlier model may raise."""

DEGREES = 5.0
"""Degrees of freedom of the Student distribution behind the p-values of a comparison. Of 769 pairs of recorded flights
of one vehicle, 6 differ by more than 4, 2 by more than 5 and 1 by more than 6 standard errors; it predicts 8, 3 and
1.4."""

CONTRADICTS = 0.01
"""p-value below which an input, damping or delay of this flight contradicts that of the earlier model: 4.0 standard
errors. It raises no alarm, but the earlier numbers are not shown beside it. Of 60 simulated flights of the same vehicle
none fell below it; 6 of the 769 recorded pairs do."""

RELENTS = 0.05
"""p-value up to which what was contradicted stays so: 2.6 standard errors. At one limit alone the state went to and fro
with every refit about it."""

ALIKE = ("steady_gain", "total_lag")
"""Quantities that mean the same under every law."""

Known = tuple[float, float, float]
"""A value, and the ends of its interval."""


@dataclass(frozen=True)
class Earlier:
    """The model of an earlier flight.

    Attributes:
        model: The model.
        name: What it is called, such as the name of its file.
    """

    model: Model
    name: str = "the earlier model"


@dataclass(frozen=True)
class Unlike:
    """A quantity compared with its earlier value.

    Attributes:
        name: `AXIS.QUANTITY`.
        p_value: Probability that two flights of one vehicle differ as much.
        change: Ratio of new to old, or their difference [s], with the ends of its 95 % interval.
    """

    name: str
    p_value: float
    change: Known


def earlier_of(after: Model | Fit | str | PathLike[str]) -> Earlier:
    """The earlier model given as a model, a fit or a model file; a file also gives it its name.

    Raises:
        TypeError: `after` is something else.
        ModelError: The file cannot be used.
    """
    if isinstance(after, Fit):
        return Earlier(after.model)
    if isinstance(after, Model):
        return Earlier(after)
    if isinstance(after, str | PathLike):
        return Earlier(load(Path(after)), Path(after).name)
    raise TypeError(f"expected a model, a fit or the path of a model file, got {type(after).__name__}")


def check_earlier(earlier: Earlier, card: Card) -> None:
    """Refuses an earlier model whose commands have another meaning than those of the flight's card.

    Raises:
        CardError: The meanings differ.
    """
    both = replace(
        card, command={axis: one for axis, one in card.command.items() if axis in earlier.model.card.command}
    )
    if trouble := disagreement(both, earlier.model.card, ("the flight's card", f"that of {earlier.name}")):
        raise CardError(f"{earlier.name}: {trouble}; convert it (rotorfit convert), or leave --after out")


def limits_of_earlier(earlier: Earlier, card: Card) -> Iterator[str]:
    """Lines on what an earlier model cannot do for a flight: it has a card of another name, or tells too little."""
    if earlier.model.card.name != card.name:
        yield f"{earlier.name} is of another card, {earlier.model.card.name}, than the flight, {card.name}"
    known = {axis: known_before(earlier, axis).keys() for axis in AXES if axis in card.command}
    if missing := [axis for axis, names in known.items() if not names]:
        yield f"{earlier.name} knows nothing of {', '.join(missing)}: all numbers there are from this flight"
    enough = [{*COEFFICIENTS}, *({"damping", name} for name in ALIKE)]
    few = [axis for axis, names in known.items() if names and not any(names >= needed for needed in enough)]
    if few:
        yield (
            f"{earlier.name} tells too little of {', '.join(few)} to be compared with this flight: its damping, and "
            "input and delay, steady gain or total lag, each with an interval; a fit by maximum likelihood gives them"
        )


def known_before(earlier: Earlier, axis: str) -> dict[str, Known]:
    """The quantities of an axis that the earlier model tells, each with its interval of the vehicle."""
    known = earlier.model.axes[axis]
    values = {**{name: getattr(known, name) for name in COEFFICIENTS}, **known.extra}
    values |= {name: part.value for name, part in known.combinations.items()}
    return _closed(values, {**known.ci95, **{name: part.ci95 for name, part in known.combinations.items()}})


def _closed(values: Mapping[str, float | None], ends: Mapping[str, Interval]) -> dict[str, Known]:
    """The quantities that have a value and a closed interval."""
    out = {}
    for name in QUANTITIES:
        value, (low, high) = values.get(name), ends.get(name, (None, None))
        if value is not None and low is not None and high is not None:
            out[name] = value, low, high
    return out


def until_known(out: TrackedAxis, earlier: Earlier, axis: str) -> TrackedAxis:
    """The axis with the numbers of the earlier model, if that tells more coefficients than this flight so far."""
    if tells_as_much(out, earlier, axis):
        return out
    before = known_before(earlier, axis)
    return replace(
        out,
        state=f"{out.state} (until then from {earlier.name})",
        values={name: before[name][0] if name in before else None for name in QUANTITIES},
        ci95={name: (low, high) for name, (_, low, high) in before.items()},
        ci95_flight={},
        structure=earlier.model.axes[axis].structure,
        earlier=earlier.name,
    )


def told_after(out: TrackedAxis, earlier: Earlier, axis: str, alone: bool, before: Collection[str] = ()) -> TrackedAxis:
    """The axis with the numbers of the earlier model while that tells more; from then on compared with it.

    Args:
        out: What this flight tells.
        earlier: The earlier model.
        axis: Name of the axis.
        alone: Whether the earlier model is not shown any more: the vehicle is another one, or this flight has told as
            much.
        before: Quantities that this flight contradicted a look ago.
    """
    against = contradicted(out, earlier, axis, before)
    shown = out if alone or against else until_known(out, earlier, axis)
    if shown.earlier:
        return shown
    told = {one.name.partition(".")[2]: one.change for one in (*compared(out, earlier, axis), *against)}
    if not against:
        return replace(out, against=told)
    names = tuple(one.name.partition(".")[2] for one in against)
    said = ", ".join(name.replace("_", " ") for name in names)
    return replace(out, state=f"{out.state} (contradicts {earlier.name}: {said})", against=told, contradicts=names)


def contradicted(out: TrackedAxis, earlier: Earlier, axis: str, before: Collection[str] = ()) -> tuple[Unlike, ...]:
    """Those of input, damping and delay that cannot be what the earlier model says, under the same law.

    Those of `before` remain until they agree clearly. Not steady gain and total lag: as long as the damping is not
    known, they may be almost anything for a moment.
    """
    both = {one.name.partition(".")[2]: one for one in _both(out, earlier, axis)}
    return tuple(
        one
        for name, one in both.items()
        if name in COEFFICIENTS and one.p_value < (RELENTS if name in before else CONTRADICTS)
    )


def tells_as_much(out: TrackedAxis, earlier: Earlier, axis: str) -> bool:
    """Whether this flight tells as many coefficients of an axis as the earlier model."""
    before = known_before(earlier, axis)
    own = sum(out.values.get(name) is not None for name in COEFFICIENTS)
    return own >= sum(name in before for name in COEFFICIENTS)


def compared(out: TrackedAxis, earlier: Earlier, axis: str) -> tuple[Unlike, ...]:
    """Each quantity that both models tell, compared.

    Only those of `ALIKE` if their laws differ, or if one of them does not tell input, damping and delay: where one
    cannot be identified, the interval of another belongs to one optimum of several, and a little more data may prefer
    another one. None where one of them does not tell the damping: near 0 it makes steady gain and total lag anything.
    """
    before, now = known_before(earlier, axis), _closed(out.values, out.ci95)
    if "damping" not in before or "damping" not in now:
        return ()
    complete = all(name in before and name in now for name in COEFFICIENTS)
    return tuple(one for one in _both(out, earlier, axis) if complete or one.name.partition(".")[2] in ALIKE)


def _both(out: TrackedAxis, earlier: Earlier, axis: str) -> tuple[Unlike, ...]:
    """Each quantity that both models tell and that means the same in both, compared."""
    before, now = known_before(earlier, axis), _closed(out.values, out.ci95)
    same_law = out.structure == earlier.model.axes[axis].structure
    return tuple(
        _unlike(f"{axis}.{name}", before[name], now[name])
        for name in before
        if name in now and (name in ALIKE or same_law) and (name in TIMES or min(*before[name], *now[name]) > 0)
    )


def _unlike(name: str, before: Known, now: Known) -> Unlike:
    """Compares a quantity with its earlier value."""
    apart = name.partition(".")[2] in TIMES
    (b, b_low, b_high), (a, a_low, a_high) = (each if apart else map(math.log, each) for each in (before, now))
    below, above = math.hypot(a - a_low, b_high - b), math.hypot(a_high - a, b - b_low)
    facing = below if a > b else above
    z = NORMAL * abs(a - b) / facing if facing > 0 else 0.0
    low, change, high = (each if apart else math.exp(each) for each in (a - b - below, a - b, a - b + above))
    return Unlike(name, float(2 * stdtr(DEGREES, -z)), (change, low, high))


def another_vehicle(found: list[Unlike], earlier: Earlier, now: float) -> Alarm:
    """The alarm that the vehicle is not that of the earlier model.

    Args:
        found: The quantities that differ, at least one.
        earlier: The earlier model.
        now: Time of the alarm [s].
    """
    worst = sorted(found, key=lambda one: one.p_value)
    named = {one.name.partition(".")[0] for one in found}
    said = ", ".join(f"{one.name.replace('.', ' ').replace('_', ' ')} {_by(one)}" for one in worst)
    why = f"another vehicle than {earlier.name}, or set otherwise: {said}; more than flights of one vehicle differ by"
    change = {one.name: one.change[1:] for one in worst}
    return Alarm(
        now, tuple(axis for axis in AXES if axis in named), "another_vehicle", (0.0, 0.0), change, 1.0,
        worst[0].p_value, why,
    )  # fmt: skip


def _by(one: Unlike) -> str:
    if one.name.partition(".")[2] in TIMES:
        return "{:+.3f} s ({:+.3f} to {:+.3f})".format(*one.change)
    return "{:.2f} times ({:.2f} to {:.2f})".format(*one.change)
