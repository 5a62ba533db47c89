"""Several models, or several flights, side by side: charts of rows, and which model leads."""

from collections.abc import Sequence
from dataclasses import dataclass

from rotorfit.assessment.case import Case
from rotorfit.assessment.evidence import Evidence
from rotorfit.assessment.rows import SPEED
from rotorfit.core.frames import AXES
from rotorfit.core.model import COEFFICIENTS
from rotorfit.core.results import named_apart
from rotorfit.reporting.tables import unit_text
from rotorfit.reporting.views import ChartRow, RowChart, look_of
from rotorfit.reporting.words import chance, figure, rounded, term_of

LONGEST_NAME = 21
"""Largest length of a name beside a chart [characters]."""

FLIGHTS = (
    "Each row is a flight: the further left the dot, the better; the hollow dot is holding the velocity. Dots of "
    "one column mean that the model is as good on every flight."
)

COEFFICIENTS_READING = (
    "Each row is a model: dot and bar are the estimate and its 95 % interval. Bars that overlap may be "
    "one truth; bars that do not are a real difference, if both models are right."
)


def names_of(cases: Sequence[Case]) -> tuple[str, ...]:
    """Short names of models: the stems of their files if they are distinct, else the paths."""
    stems = [case.path.rpartition("/")[2].removesuffix(".json") for case in cases]
    return tuple(stems if len(set(stems)) == len(stems) else [case.path for case in cases])


@dataclass(frozen=True)
class Lead:
    """One axis: the velocity error of each model, the best one, and whether its lead is significant."""

    axis: str
    errors: tuple[str, ...]
    best: int
    reason: str


def leads(evidences: Sequence[Evidence], horizon: float) -> tuple[Lead, ...]:
    """For every axis, the model that predicts the velocity best, and whether its lead is significant.

    Args:
        evidences: Evidence of the models.
        horizon: Horizon of the predictions [s].
    """
    out = []
    for axis in AXES:
        errors = {
            k: error
            for k, evidence in enumerate(evidences)
            for score in evidence.scores
            if score.axis == axis and score.horizon == horizon
            if (error := score.velocity.get("model")) is not None
        }
        if errors:
            unit, factor = SPEED[axis]
            texts = tuple(f"{figure(factor * errors[k])} {unit}" if k in errors else "—" for k in range(len(evidences)))
            first, *others = sorted(errors, key=lambda k: errors[k])
            reason = _shown(evidences, first, others[0], axis, horizon) if others else "the only one that was scored"
            behind = {tuple(not flight.fitted for flight in evidences[k].case.validation.flights) for k in errors}
            if len(behind) > 1:
                reason += "; each is scored on the flights that it was not fitted to, which are not the same"
            out.append(Lead(axis, texts, first, reason))
    return tuple(out)


def _shown(evidences: Sequence[Evidence], best: int, second: int, axis: str, horizon: float) -> str:
    """The result of the paired test of the two best models, in words."""
    test = evidences[min(best, second)].against.get(max(best, second))
    pooled = test.axes[axis][f"{horizon:g}"]["velocity"].pooled if test else None
    if test is None:
        return "leads; not tested, for its card reads other motion"
    if pooled is None:
        scored = [evidences[k].case.validation.flights for k in (best, second)]
        told = any(axis in one.unlike(other) for one, other in zip(*scored, strict=True))
        why = "only one of the two is told where the vehicle turns" if told else "no flight has enough predictions"
        return f"leads; not tested, for {why}"
    p = "" if pooled.p is None else f" ({chance(pooled.p)})"
    if pooled.verdict in ("better", "worse"):
        return f"leads, and that is no chance{p}"
    return "leads; the flights are too short to tell" if pooled.verdict == "too_short" else f"leads, maybe by chance{p}"


def flights_side_by_side(cases: Sequence[Case], names: Sequence[str], horizon: float) -> tuple[RowChart, ...]:
    """Velocity error of every flight at one horizon [s], a chart for each axis that several flights move."""
    charts = []
    for axis in AXES:
        unit, factor = SPEED[axis]
        rows, values = [], []
        flights = cases[0].validation.flights
        for number, (flight, name) in enumerate(zip(flights, named_apart(flights, folders=False), strict=True)):
            dots = []
            for k, case in enumerate(cases):
                role = "model" if len(cases) == 1 else look_of(k)
                dots.append((role, names[k], _error(case.validation.flights[number].axes[axis], horizon)))
            hold = cases[0].validation.baselines["hold"][number].axes[axis]
            dots.append(("naive", "holding the velocity", _error(hold, horizon)))
            if axis in flight.moved and any(value for _, _, value in dots[:-1]):
                known = [(label, value) for _, label, value in dots if value is not None]
                said = ", ".join(f"{label} {figure(factor * value)}" for label, value in known)
                fitted = " (was fitted: proves nothing)" if flight.fitted else ""
                points = tuple((role, value * factor if value else None) for role, _, value in dots)
                shown = shortened(f"{name} (fitted)" if flight.fitted else name)
                rows.append(ChartRow(shown, points, f"{name}, {axis}, {horizon:g} s ahead: {said} {unit}{fitted}"))
                if not flight.fitted and points[0][1] is not None:
                    values.append(points[0][1])
        if len(rows) > 1:
            seen = f"{axis}: {_range(values)} {unit}." if values else ""
            label = f"velocity error over {horizon:g} s [{unit}]"
            charts.append(RowChart(f"{axis}: flight by flight", label, tuple(rows), FLIGHTS, seen, x_log=True))
    return tuple(charts)


def _range(values: Sequence[float]) -> str:
    """The errors of the flights that count, in words."""
    over = "one flight that was not fitted" if len(values) == 1 else f"{len(values)} flights that were not fitted"
    return f"over {over}, {' to '.join(dict.fromkeys(figure(f(values)) for f in (min, max)))}"


def shortened(name: str) -> str:
    """A name that fits beside a chart; if it is too long, its middle is left out."""
    return name if len(name) <= LONGEST_NAME else f"{name[: LONGEST_NAME - 9]}…{name[-8:]}"


def _error(axis: object, horizon: float) -> float | None:
    found = axis.horizons.get(f"{horizon:g}")  # type: ignore[attr-defined]
    return found.velocity_rmse if found and found.velocity_rmse else None


def coefficients_side_by_side(evidences: Sequence[Evidence], names: Sequence[str]) -> tuple[RowChart, ...]:
    """Estimates and intervals of every coefficient, one chart for each coefficient of an axis."""
    found = [{(row.axis, row.name): row for row in evidence.coefficients} for evidence in evidences]
    charts = []
    for axis in AXES:
        for name in COEFFICIENTS:
            mine = [each[axis, name] for each in found]
            if all(row.value is None and row.low is None and row.high is None for row in mine):
                continue
            rows = []
            for k, row in enumerate(mine):
                scale = row.stderr or (row.high - row.low) / 4 if row.low is not None and row.high is not None else None
                ends = " to ".join("open" if end is None else rounded(end, scale) for end in (row.low, row.high))
                value = f"{rounded(row.value, scale)}, 95 % interval {ends} {unit_text(row)}"
                text = f"{names[k]}: {axis} {term_of(name)} {value}"
                rows.append(ChartRow(shortened(names[k]), ((look_of(k), row.value),), text, row.low, row.high))
            units = dict.fromkeys(unit_text(row) for row in mine)
            title, label = f"{axis}: {term_of(name)}", f"{term_of(name)} [{' or '.join(units)}]"
            summary = "; ".join(row.text for row in rows)
            charts.append(RowChart(title, label, tuple(rows), COEFFICIENTS_READING, f"{summary}."))
    return tuple(charts)
