"""What to fly next, with the line to type; and which coefficients are less accurate than a controller needs."""

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from rotorfit.assessment.case import Case
from rotorfit.core.errors import PlanError
from rotorfit.core.finding import OTHER_STAMPS
from rotorfit.core.frames import AXES
from rotorfit.core.frozen import frozen_axes
from rotorfit.core.model import FROZEN, Axis, Model
from rotorfit.estimation.methods import maximises_likelihood
from rotorfit.planning.belief import belief_from_model
from rotorfit.planning.next_flight import wanted_errors, worst_group
from rotorfit.reporting.reproduce import axes_asked, fit_words, structure_asked
from rotorfit.reporting.targets import beside_target
from rotorfit.reporting.verdict import STATUS, Lamp, Use, Verdict, untried
from rotorfit.reporting.views import ChartRow, RowChart
from rotorfit.reporting.words import and_list, figure, sentences, term_of

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
    left_out = [axis for axis in lacking if model.axes[axis].status["input"] == "not_fitted"]
    uses = [use for use in verdict.uses if use.horizon == verdict.horizon and use.axis in commanded]
    told = [finding for finding in model.findings if finding.code == FROZEN]
    frozen = frozen_axes(told)
    steps = [Step(sentences([f.remedy])[0], sentences([f.evidence])[0], "") for f in told]
    if left_out:
        why = (
            f"The flights command {'it' if len(left_out) == 1 else 'them'}, but the fit left out {and_list(left_out)}."
        )
        steps.append(_fit(f"Fit {and_list(left_out)}, too.", why, model, structure_asked(model), AXES, "whole.json"))
    if unflown := [axis for axis in lacking if axis not in (*frozen, *left_out)]:
        why = f"No flight so far tells how {and_list(unflown)} answer{'s' if len(unflown) == 1 else ''}."
        steps.append(_flight(case, f"Fly to learn {and_list(unflown)}.", why, unflown))
    wrong = [f for f in model.findings if f.severity == "error" and f.axis not in lacking]
    steps += [Step(sentences([f.remedy])[0], sentences([f.evidence])[0], "") for f in wrong[:MOST_REMEDIES]]
    steps += _proof(case, uses)
    short = [use.axis for use in uses if use.answer == "limited"]
    steps += _vague(case, [axis for axis in commanded if axis not in (*lacking, *frozen)], short)
    doubted = [light.axis for light in verdict.lights if any(_not_clean(lamp) for lamp in light.lamps)]
    if any(untried(model, axis) for axis in doubted):
        why = "The residuals are not clean: the vehicle may do more than one gain, one damping and one delay say."
        what = "No flight needed: let a richer law try."
        steps.append(_fit(what, why, model, "auto", axes_asked(model), "richer.json"))
    return tuple(steps) or (_nothing(model, commanded),)


def _not_clean(lamp: Lamp) -> bool:
    return lamp.question == "residuals" and lamp.word == "not clean"


def _nothing(model: Model, commanded: Sequence[str]) -> Step:
    """What is said where there is no step."""
    met = all(share <= 1 for axis in commanded for share in beside_target(model.axes[axis]).values())
    known = f"{'and' if met else 'though not'} every coefficient is known as well as a controller needs"
    why = (
        f"Every axis is proven, {known}. If you will fly faster than these flights, keep one such flight for "
        "another proof."
    )
    return Step("Nothing has to be flown for this.", why, "")


def _proof(case: Case, uses: Sequence[Use]) -> list[Step]:
    """A flight for validation, for axes whose predictions are not proven, or what spoils those that there are."""
    unproven = [use.axis for use in uses if use.answer == "unproven" and not use.remedy]
    short = [use.axis for use in uses if use.answer == "limited"]
    misread = dict.fromkeys((use.remedy, use.reason) for use in uses if use.remedy)
    steps = [Step(sentences([remedy])[0], sentences([why])[0], "") for remedy, why in misread]
    if unproven:
        what = f"Fly {and_list(unproven)} once more, and keep that flight out of the fit."
        why = "Without a flight that was not fitted nothing is proven."
        steps.append(_flight(case, what, why, unproven, "proof"))
    if short:
        what = f"Fly a longer or livelier proof of {and_list(short)}."
        reasons = dict.fromkeys(use.reason for use in uses if use.answer == "limited")
        steps.append(_flight(case, what, " ".join(sentences(list(reasons))), short, "proof"))
    return steps


def _vague(case: Case, known: Sequence[str], planned: Sequence[str]) -> list[Step]:
    """A flight for the axes with a coefficient that misses its target; none where no flight would tell it."""
    if not maximises_likelihood(case.model.method):
        return []
    shares = {axis: _flyable(case.model.axes[axis]) for axis in known}
    missed = [axis for axis in known if max(shares[axis].values(), default=0.0) > 1]
    late = next((finding for finding in case.model.findings if finding.code in OTHER_STAMPS), None)
    if late and missed and all(_only_delays(shares[axis]) for axis in missed):
        return [Step(sentences([late.remedy])[0], f"Delays miss their target: {sentences([late.evidence])[0]}", "")]
    if not missed:
        return []
    group = _worst(case, missed)
    if set(group) & set(planned):
        return []
    share, axis, name = max((share, axis, name) for axis in group for name, share in shares[axis].items())
    why = f"The standard error of the {term_of(name)} of {axis} is {figure(share)} times the target for a controller."
    if not np.isfinite(share):
        status = case.model.axes[axis].status[name]
        why = f"The {term_of(name)} of {axis} is not known: {STATUS.get(status, status.replace('_', ' '))}."
    return [_flight(case, f"Fly {and_list(group)} once more, and fit with it.", why, group)]


def _only_delays(shares: Mapping[str, float]) -> bool:
    """Whether of the coefficients of an axis that miss their target only the delay does, and is known."""
    return all(share <= 1 or (name == "delay" and np.isfinite(share)) for name, share in shares.items())


def _flyable(axis: Axis) -> Mapping[str, float]:
    """`beside_target` of what flights can tell: not the delay of clocks with an unknown offset."""
    hidden = "delay" if "offset_plus_delay" in axis.combinations else ""
    return {name: share for name, share in beside_target(axis).items() if name != hidden}


def _worst(case: Case, missed: Sequence[str]) -> tuple[str, ...]:
    """Of the axes that miss a target, those that `plan --after` would fly first; all where it has nothing to go by."""
    try:
        belief = belief_from_model(case.model, case.path)
    except PlanError:
        return tuple(missed)
    with np.errstate(divide="ignore"):
        return worst_group(np.sqrt(np.diag(belief.covariance)) / wanted_errors(belief), missed)


def _fit(what: str, why: str, model: Model, structure: str, axes: Sequence[str], output: str) -> Step:
    """Another fit to the same flights; its card is at the end of the page."""
    line = shlex.join([*fit_words(model, structure, axes), "-o", output])
    return Step(what, f"{why} The line reads card.toml, which is under Reproduce.", line)


def _flight(case: Case, what: str, why: str, axes: Sequence[str], name: str = "next") -> Step:
    """A flight of some axes, with the line that plans it if it can be planned, and writes a plan of that name."""
    if case.model.card.command_frame != "heading":
        return Step(what, f"{why} Fly it by hand: commands in the world frame cannot be planned.", "")
    output = f"{name}-{'-'.join(axes)}.toml"  # several steps may be followed
    words = ["rotorfit", "plan", "--after", case.path, "--axes", ",".join(axes), "--room", ROOM, "-o", output]
    return Step(what, why, shlex.join(words))


def wanted_chart(case: Case) -> RowChart | None:
    """The accuracy of each coefficient beside what a controller needs; None without a likelihood or a model."""
    if not maximises_likelihood(case.model.method):
        return None
    shares = {
        f"{axis} {term_of(name)}": share
        for axis in AXES
        for name, share in beside_target(case.model.axes[axis]).items()
        if share > 0
    }
    if not shares:
        return None
    missed = [f"{name}{'' if np.isfinite(share) else ' (not known)'}" for name, share in shares.items() if share > 1]
    return RowChart(
        title="Standard errors relative to the target",
        x_label="standard error / target",
        rows=tuple(_row(name, share) for name, share in shares.items()),
        reading="A dot right of the line is a coefficient that misses its target; far left of it nothing is gained. "
        "A bar without a dot is one that is not known. The line is the target of a controller: 2 % of the gain, 5 % "
        "of the damping, 5 ms.",
        summary=f"{len(missed)} of {len(shares)} coefficients miss the target{': ' * bool(missed)}{', '.join(missed)}.",
        x_log=True,
        level=(1.0, "target"),
    )


def _row(name: str, share: float) -> ChartRow:
    if not np.isfinite(share):
        return ChartRow(name, (("vague", None),), f"{name}: not known", low=1.0)
    role = "vague" if share > 1 else "model"
    return ChartRow(name, ((role, share),), f"{name}: standard error {figure(share)} times the target")
