"""What to fly next, with the line to type; and which coefficients are less accurate than a controller needs."""

import shlex
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rotorfit.assessment.case import Case
from rotorfit.core.errors import PlanError
from rotorfit.core.frames import AXES, Array
from rotorfit.core.frozen import frozen_axes
from rotorfit.core.model import COEFFICIENTS, FROZEN, Model
from rotorfit.estimation.methods import maximises_likelihood
from rotorfit.planning.belief import belief_from_model
from rotorfit.planning.next_flight import wanted_errors, worst_group
from rotorfit.reporting.verdict import Use, Verdict
from rotorfit.reporting.views import ChartRow, RowChart
from rotorfit.reporting.words import and_list, figure, sentences

ROOM = "6x4x3"
"""Room in the lines to type [m], for the reader to replace."""

MOST_REMEDIES = 3
"""Largest number of findings that become steps of their own, among those that forbid the use of numbers."""


@dataclass(frozen=True)
class Step:
    """One thing to do: what, why, and the line to type, which may be empty."""

    what: str
    why: str
    command: str


def next_steps(case: Case, verdict: Verdict) -> tuple[Step, ...]:
    """The most helpful steps first: axes without a model, axes without validation, wide intervals, residuals.

    Args:
        case: The model with its flights.
        verdict: The verdict on it.
    """
    model = case.model
    commanded = [axis for axis in AXES if axis in model.card.command]
    lacking = [axis for axis in commanded if model.axes[axis].predictor is None]
    uses = [use for use in verdict.uses if use.horizon == verdict.horizon and use.axis in commanded]
    told = [finding for finding in model.findings if finding.code == FROZEN]
    frozen = frozen_axes(told)
    steps = [Step(sentences([f.remedy])[0], sentences([f.evidence])[0], "") for f in told]
    if unflown := [axis for axis in lacking if axis not in frozen]:
        why = f"No flight so far tells how {and_list(unflown)} answer{'s' if len(unflown) == 1 else ''}."
        steps.append(Step(f"Fly to learn {and_list(unflown)}.", why, _plan(case, unflown)))
    wrong = [f for f in model.findings if f.severity == "error" and f.axis not in lacking]
    steps += [Step(sentences([f.remedy])[0], sentences([f.evidence])[0], "") for f in wrong[:MOST_REMEDIES]]
    steps += _proof(case, uses)
    short = [use.axis for use in uses if use.answer == "limited"]
    steps += _vague(case, [axis for axis in commanded if axis not in (*lacking, *frozen)], short)
    if any(
        lamp.question == "residuals" and lamp.word == "not clean" for light in verdict.lights for lamp in light.lamps
    ):
        steps.append(_richer(case))
    if not steps:
        steps.append(
            Step(
                "Nothing has to be flown for this.",
                "Every axis is proven, and every coefficient is known as well as a controller needs. If you will fly "
                "faster than these flights, keep one such flight for another proof.",
                "",
            )
        )
    return tuple(steps)


def _proof(case: Case, uses: Sequence[Use]) -> list[Step]:
    """A flight for validation, for axes whose predictions are not proven, or what spoils those that there are."""
    unproven = [use.axis for use in uses if use.answer == "unproven" and not use.remedy]
    short = [use.axis for use in uses if use.answer == "limited"]
    misread = dict.fromkeys((use.remedy, use.reason) for use in uses if use.remedy)
    steps = [Step(sentences([remedy])[0], sentences([why])[0], "") for remedy, why in misread]
    if unproven:
        what = f"Fly {and_list(unproven)} once more, and keep that flight out of the fit."
        why = "Without a flight that was not fitted nothing is proven."
        steps.append(Step(what, why, _plan(case, unproven)))
    if short:
        what = f"Fly a longer or livelier proof of {and_list(short)}."
        reasons = dict.fromkeys(use.reason for use in uses if use.answer == "limited")
        steps.append(Step(what, f"{' '.join(sentences(list(reasons)))}", _plan(case, short)))
    return steps


def _vague(case: Case, known: Sequence[str], planned: Sequence[str]) -> list[Step]:
    """The flight that `plan --after` would choose: for the axes whose accuracy is furthest from what is wanted."""
    ratio = beside_wanted(case)
    if ratio is None or not known:
        return []
    group = worst_group(ratio, known)
    if set(group) & set(planned):
        return []
    rows = {axis: ratio[3 * AXES.index(axis) : 3 * AXES.index(axis) + 3] for axis in group}
    axis = max(rows, key=lambda each: float(rows[each].max()))
    times, name = float(rows[axis].max()), COEFFICIENTS[int(np.argmax(rows[axis]))]
    if times <= 1:
        return []
    why = f"The standard error of the {name} of {axis} is {figure(times)} times the target for a controller."
    return [Step(f"Fly {and_list(group)} once more, and fit with it.", why, _plan(case, group))]


def _richer(case: Case) -> Step:
    logs = [f"{source.path}@{source.span[0]:.15g}:{source.span[1]:.15g}" for source in case.model.flights]
    line = shlex.join(["rotorfit", "fit", *logs, "--structure", "auto", "-o", "richer.json"])
    why = "The residuals are not clean: the vehicle may do more than one gain, one damping and one delay say."
    return Step("No flight needed: let a richer law try.", why, line)


def _plan(case: Case, axes: Sequence[str]) -> str:
    return shlex.join(
        ["rotorfit", "plan", "--after", case.path, "--axes", ",".join(axes), "--room", ROOM, "-o", "next.toml"]
    )


def beside_wanted(case: Case) -> Array | None:
    """Standard errors of the twelve coefficients over the wanted ones, shape (12,); None if they are unknown."""
    model = case.model
    if not maximises_likelihood(model.method) or not any(axis.predictor for axis in model.axes.values()):
        return None
    try:
        belief = belief_from_model(model, case.path)
    except PlanError:  # there is nothing to plan with: the other steps stand
        return None
    with np.errstate(divide="ignore"):
        return np.asarray(np.sqrt(np.diag(belief.covariance)) / wanted_errors(belief))


def wanted_chart(case: Case) -> RowChart | None:
    """The accuracy of each coefficient beside what a controller needs; None if it is unknown."""
    ratio = beside_wanted(case)
    rows = _rows(case.model, ratio) if ratio is not None else []
    if not rows:
        return None
    beyond = [row.name for row in rows if row.dots[0][1] is not None and row.dots[0][1] > 1]
    return RowChart(
        title="Standard errors relative to the target",
        x_label="standard error / target",
        rows=tuple(rows),
        reading="A dot right of the line is a coefficient that another flight should improve; far left of it nothing "
        "is gained. The line is the target of a controller: 2 % of the gain, 5 % of the damping, 5 ms.",
        summary=f"{len(beyond)} of {len(rows)} coefficients miss the target"
        f"{': ' if beyond else ''}{', '.join(beyond)}.",
        x_log=True,
        level=(1.0, "target"),
    )


def _rows(model: Model, ratio: Array) -> list[ChartRow]:
    rows = []
    for a, axis in enumerate(AXES):
        if model.axes[axis].predictor is None:
            continue
        for i, name in enumerate(COEFFICIENTS):
            value = float(ratio[3 * a + i])
            if np.isfinite(value) and value > 0:
                role = "vague" if value > 1 else "model"
                text = f"{axis} {name}: standard error {figure(value)} times the target"
                rows.append(ChartRow(f"{axis} {name}", ((role, value),), text))
    return rows
