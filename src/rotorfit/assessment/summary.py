"""Summary: what a fit did and did not determine, in one paragraph of plain words."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from rotorfit.core.display import interval_text, number_text
from rotorfit.core.finding import WRONG_FRAME, WRONG_PLANE, Finding, told_together
from rotorfit.core.frames import AXES
from rotorfit.core.laws import given_by_law
from rotorfit.core.model import COEFFICIENTS, FROZEN, Axis, Combination, Model
from rotorfit.core.plain import listed
from rotorfit.estimation.identifiability import TOLERABLE, WIDEST_INPUT
from rotorfit.estimation.methods import label_of

_NAMES = {"input": "input gain", "damping": "damping", "delay": "delay"}

_TIMES = ("total_lag", "delay_plus_lag")
"""Combinations that may be near zero: the ratio of the ends of their intervals says nothing."""

_MISREAD, _UNNAMED = "misread", "unnamed"

_REASONS = {
    "not_excited": "no flight excites {}",
    "too_short": "the flights are too short for {}, or command it only once",
    "diverged": "the estimation of {} did not converge",
    "refuted": "the flights deny the law of {}",
    "not_identifiable": "the flights do not tell the input of {} under its law",
    FROZEN: "the pose stands still while {} is commanded",
    _MISREAD: "the card reads {} in a wrong frame",
    _UNNAMED: "the card names no command for {}",
}

BELIEVED = ", with the card's prior"


def summary_of_model(model: Model, axes: Sequence[str] = AXES, validated: bool = False) -> str:
    """What the flights did and did not determine, and what must be read before the numbers are used.

    Args:
        model: The model with its findings.
        axes: The requested axes; the others are not mentioned.
        validated: Whether it has been validated; else the summary asks to.
    """
    wanted = [axis for axis in AXES if axis in axes]
    time = sum(end - start for start, end in (flight.span for flight in model.flights))
    count = len(model.flights)
    flights = f"1 flight of {time:.0f} s" if count == 1 else f"{count} flights, {time:.0f} s in all,"
    coefficients = COEFFICIENTS[:2] if model.method == "paper" else COEFFICIENTS
    sure = [axis for axis in wanted if all(model.axes[axis].status[name] == "ok" for name in coefficients)]
    bad = spoiled(model.findings, {axis: model.axes[axis] for axis in wanted})
    all_told = [axis for axis in sure if not set(given_by_law(model.axes[axis].structure)) & set(coefficients)]
    whole = [axis for axis in all_told if axis not in bad]
    partly = [axis for axis in wanted if axis not in all_told and model.axes[axis].predictor]
    sentences = [f"Fitted to {flights} by {label_of(model.method)}{BELIEVED * bool(model.prior)}."]
    if whole:
        sentences.append(f"Known: {listed([_NAMES[name] for name in coefficients])} of {listed(whole)}.")
    known = {axis: _partly_known(model.axes[axis], axis not in bad) for axis in partly}
    sentences += [
        said.format(listed([a for a in partly if known[a] == said])) for said in dict.fromkeys(known.values())
    ]
    unknown = {axis: model.axes[axis].status["input"] for axis in wanted if not model.axes[axis].predictor}
    unnamed = [axis for axis, why in unknown.items() if why == "not_excited" and axis not in model.card.command]
    unknown |= dict.fromkeys(unnamed, _UNNAMED)
    if any(finding.code in WRONG_FRAME and finding.severity == "error" for finding in model.findings):
        served = {axis for flight in model.flights for axis in flight.axes}
        unknown |= {axis: _MISREAD for axis in ("x", "y") if axis in served and unknown.get(axis) == "not_excited"}
    groups = {why: [axis for axis, status in unknown.items() if status == why] for why in _REASONS}
    told = {why: listed(group, "and" if why == _MISREAD else "or") for why, group in groups.items() if group}
    if reasons := [_REASONS[why].format(names) for why, names in told.items()]:
        sentences.append(f"No numbers: {'; '.join(reasons)}.")
    if set(unknown.values()) == {"not_excited"} and len(unknown) == len(wanted):
        sentences.append("Fly one that does: `rotorfit plan` designs it.")
    sentences += _warnings(model, wanted)
    if not validated and any(model.axes[axis].predictor for axis in wanted):
        sentences.append("Validate it on a flight that was not fitted.")
    return " ".join(sentences)


def spoiled(findings: Sequence[Finding], axes: Mapping[str, Axis]) -> list[str]:
    """Those of some axes that a finding forbids to use."""
    wrong = [finding for finding in findings if finding.severity == "error"]
    errors = {axis for one in wrong for axis in (("x", "y") if one.code in WRONG_PLANE else (one.axis,))}
    return [name for name, axis in axes.items() if name in errors or (None in errors and axis.predictor)]


def read_first(axes: Sequence[str]) -> str:
    """The warning of spoiled axes."""
    return f"Do not use {listed(axes)} before you have read the findings."


def _partly_known(known: Axis, usable: bool) -> str:
    """What is known of an axis, `{}`, if not every coefficient is; combinations only of an axis that may be used."""
    given = given_by_law(known.structure)
    good = [_NAMES[name] for name in COEFFICIENTS if known.status[name] == "ok" and name not in given]
    lost = [_NAMES[name] for name in COEFFICIENTS if known.status[name] not in ("ok", "refuted")]
    refuted = [_NAMES[name] for name in COEFFICIENTS if known.status[name] == "refuted"]
    head = f"Known of {{}}: {listed(good)}; " if good else "Of {}, "
    combined = [
        f"{name.replace('_', ' ')} {_range(part)}"
        for name, part in known.combinations.items()
        if usable and is_told(name, part) and not (refuted and _may_be_refuted(name, part))
    ]
    are = "is" if len(combined) == 1 else "are"
    if refuted:
        head += f"{listed(refuted)} {'is' if len(refuted) == 1 else 'are'} refuted: the flights deny the law"
        if not lost:
            return f"{head}; {listed(combined)} {are} known." if combined else f"{head}."
        head += "; "
    elif not lost:
        return f"{head}its law has no {listed([_NAMES[name] for name in given])}."
    instead = f", but {listed(combined)} {are}" if combined else ""
    return f"{head}{listed(lost)} cannot be identified from these data{instead}."


def is_told(name: str, part: Combination) -> bool:
    """Whether the interval is closed and narrow: of a time, less than twice its value; else as that of a gain."""
    low, high = part.ci95
    if low is None or high is None:
        return False
    return high - low < 2 * abs(part.value) if name in _TIMES else not 0 < WIDEST_INPUT * low < high


def _may_be_refuted(name: str, part: Combination) -> bool:
    """Whether a closed interval is too wide for a wrong law to be good enough: such a quantity may be refuted, too."""
    low, high = part.ci95
    assert low is not None
    assert high is not None
    if name in _TIMES:
        return high - low > 2 * TOLERABLE[False]
    return low <= 0 or bool(np.log(high / low) > 2 * TOLERABLE[True])


def _range(part: Combination) -> str:
    return f"{number_text(part.value, part.ci95)} ({interval_text(part.ci95)})"


def _warnings(model: Model, wanted: Sequence[str]) -> Iterator[str]:
    """What must be read first; empty if there is nothing."""
    concerned = [finding for finding in model.findings if finding.axis is None or finding.axis in wanted]
    bad = spoiled(concerned, {axis: model.axes[axis] for axis in wanted})
    warnings = sum(finding.severity == "warning" for finding in told_together(concerned))
    if bad:
        yield read_first(bad)
    if warnings:
        yield "One finding is a warning." if warnings == 1 else f"{warnings} findings are warnings."
