"""Fit -> findings: evidence against the law of an axis, and the flights that differ from the others."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from rotorfit.assessment.uncertainty import serving_flights
from rotorfit.core.finding import Finding
from rotorfit.core.frames import Array
from rotorfit.core.model import Axis, Predictor, Spread, first_order_beside
from rotorfit.core.results import Fit
from rotorfit.estimation.judgement.omitted_terms import SLOW
from rotorfit.estimation.likelihood.axis_estimate import Estimate
from rotorfit.estimation.likelihood.blocks import Record

DISAGREE = 0.01
"""Probability that flights that agree are reported to disagree, over all axes of a fit."""

STANDS_OUT = 2.5
"""Distance from the other flights, in standard deviations of such a distance, above which a flight is named."""

UNLIKE = 1.5
"""Ratio to the median of the other flights above which a condition counts as different."""

MUCH_LIKELIER = 100.0
"""Decrease of the criterion from which on a law that `auto` rejected is reported.

On recorded flights, whose residuals no law makes quite white, rejected laws reach 65."""

STAMPS_ALONE = (
    "log commands by themselves, each with its own stamp, before you doubt the law: those of rows are late by another "
    "part of a row each time, which alone can look like this; then "
)

SMALLER = (
    "fit flights whose commands all have the size that the model is wanted for: smaller ones where large ones reach a "
    "limit of the vehicle, as of its tilt, which none of the structures has"
)
"""Remedy where small and large commands do not agree: no law that is tried bounds the acceleration."""

LASTING = (
    f"fly commands of the length that the model is wanted for, of {3 * SLOW:.0f} s and more where final speeds matter: "
    "none of the structures has the integral part of a velocity loop behind a lag"
)
"""Remedy where commands that last are answered otherwise than short ones."""

WITHIN_ONE = (
    "if the answer depends on the size or speed of the commands, the flights differ like this, too: a flight with "
    "small and large, slow and fast ones shows it, since the law is tested within flights; "
)
"""Remedy where flights differ that were flown by unlike commands."""

QUANTITIES = 4
"""Number of independent quantities of an axis, for the level of a test of the worst of them."""


def law_findings(name: str, axis: Axis, stamped: bool = True) -> Iterator[Finding]:
    """Findings of the tests of an axis's law, and of the choice among laws.

    The intervals include the doubt, or the law is refuted, or another one was much likelier and was rejected.

    Args:
        name: Name of the axis.
        axis: As fitted.
        stamped: Whether commands bear their own stamps.
    """
    yield from _rejected(name, axis)
    beside = contradicted(axis)
    told = "; ".join(f"{one.strength} (p = {one.p_value:.1g})" for one in axis.evidence)
    if beside:
        under = f"its input is {axis.predictor.input:.3g}" if axis.predictor else f"the {name} command explains nothing"
        against = f"under it {under}; with a delay alone, which is likelier, the input is {beside.input:.3g}"
        yield Finding(
            "law_refuted",
            "warning",
            f"{name} does not obey {axis.structure}: {'; '.join(filter(None, (against, told)))}",
            f"{axis.structure} has no coefficients of {name}; card and excitation are not to blame for it",
            "fit without --structure, or with --structure auto",
            name,
        )
        return
    if not axis.evidence:
        return
    chosen = any(one.chosen for one in axis.candidates)  # by `auto`, which would choose it again
    refuted = [part for part, status in axis.status.items() if status == "refuted"]
    if refuted:
        stated = "its interval says" if len(refuted) == 1 else "their intervals say"
        yield Finding(
            "law_refuted",
            "warning",
            f"{name} does not obey {axis.structure}: {told}",
            f"{', '.join(refuted)} of {name} would differ on another flight by more than {stated}",
            (
                "no law that --structure auto tries does better: "
                if chosen
                else f"fit with --structure {_law(axis)}, or "
            )
            + _flights(axis, "fly commands of the size and speed that the model is wanted for")
            + "; predictions of like motion may still be good: see validate",
            name,
        )
        return
    yield Finding(
        "law_doubted",
        "info",
        f"{name} does not quite obey {axis.structure}: {told}",
        f"the intervals of {name} are that much wider: they allow for what the law leaves out",
        ("" if stamped else STAMPS_ALONE)
        + ("" if chosen else f"fit with --structure {_law(axis)}; ")
        + _flights(axis, "commands of several sizes and speeds in one flight show what is missing"),
        name,
    )


def _law(axis: Axis) -> str:
    """The law to fit next: the one that has what is missing, if it is known."""
    return "quadratic_drag" if any(one.test == "drag" for one in axis.evidence) else "auto"


def _flights(axis: Axis, otherwise: str) -> str:
    """The flights that help: smaller commands, longer ones, or otherwise others."""
    if _by_size(axis):
        return SMALLER
    return LASTING if any(one.test == "slow" for one in axis.evidence) else otherwise


def _by_size(axis: Axis) -> bool:
    """Whether small and large commands give different coefficients, or large ones meet a limit."""
    return any(one.test in ("size", "bound", "jerk") for one in axis.evidence)


def with_size(axis: Axis, remedy: str) -> str:
    """The remedy of another finding for the doubts of a law, after the one for commands of different sizes."""
    return f"{SMALLER}; {remedy}" if _by_size(axis) else remedy


def contradicted(axis: Axis) -> Predictor | None:
    """The first-order law with a delay, where under the axis's own law the commands explain nothing, or the opposite.

    None where its own law does not contradict it, or is not refuted.
    """
    beside = first_order_beside(axis)
    if beside is None or axis.status["input"] != "refuted":
        return None
    return beside if axis.predictor is None or axis.predictor.input * beside.input < 0 else None


def _rejected(name: str, axis: Axis) -> Iterator[Finding]:
    """The likeliest law that `auto` rejected, if it is much likelier than the one that it chose."""
    chosen = next((one for one in axis.candidates if one.chosen), None)
    if chosen is None:
        return
    likeliest = min(axis.candidates, key=lambda one: one.bic)
    if likeliest.bic > chosen.bic - MUCH_LIKELIER:
        return
    yield Finding(
        "likelier_law_rejected",
        "warning",
        f"the data of {name} are much likelier under {likeliest.structure} than under {chosen.structure}, which was "
        f"chosen: the criterion is lower by {chosen.bic - likeliest.bic:.0f}, where 10 is very strong evidence; "
        f"{likeliest.structure} was {likeliest.verdict}",
        f"the intervals of {name} hold as far as {chosen.structure} does; what it leaves out may be in them",
        f"fit with --structure {likeliest.structure}, too, and compare; a longer flight, or several, decides by its "
        "predictions",
        name,
    )


def disagreement_findings(fit: Fit) -> Iterator[Finding]:
    """Axes on which the flights disagree, and the flights that stand out, the furthest first."""
    found = {name: worst for name in fit.estimates if (worst := _most_unlike(fit.model.axes[name].spread))}
    for name, quantity in found.items():
        spread = fit.model.axes[name].spread[quantity]
        if spread.p_value is None or spread.p_value * QUANTITIES > DISAGREE / len(found):
            continue
        values = ", ".join("-" if one is None else f"{_plain(one[0], spread):.3g}" for one in spread.each)
        lines = _standing_out(fit, name, spread)
        flown = _flown_unlike(fit, name, spread)
        yield Finding(
            "flights_disagree",
            "warning" if spread.flights_sd and spread.flights_sd > spread.prior_sd else "info",
            f"the {spread.flights} flights that determine {name} differ by more than their own errors, most in "
            f"{quantity.replace('_', ' ')}: {values} (p = {spread.p_value:.1g})"
            + "".join(f"; {line}" for line in (*lines, *flown)),
            f"the intervals of {name} are of the vehicle's mean over such flights; on the next one "
            f"{quantity.replace('_', ' ')} lies in {_ends(spread)}",
            (WITHIN_ONE if flown else "")
            + "compare the settings, payload, battery and wind of the flights that stand out; what cannot be explained "
            "is in the intervals",
            name,
        )


def _flown_unlike(fit: Fit, name: str, spread: Spread) -> list[str]:
    """In what the commands of the flights differ that determine an axis, in the order of their values."""
    flown = _all_conditions(fit.estimates[name])
    out = []
    for part, word in (("size", "size"), ("quickness", "number of changes a second")):
        values = [getattr(flown[i], part) for i, one in enumerate(spread.each) if one is not None]
        if max(values) > UNLIKE * min(values):
            out.append(f"their commands differ in {word}: {', '.join(f'{value:.2g}' for value in values)}")
    return out


def _most_unlike(spreads: Mapping[str, Spread]) -> str | None:
    told = {name: one.p_value for name, one in spreads.items() if one.p_value is not None}
    return min(told, key=lambda name: told[name]) if told else None


def _plain(value: float, spread: Spread) -> float:
    return float(np.exp(value)) if spread.logarithmic else value


def _ends(spread: Spread) -> str:
    low, high = spread.next_flight
    return " to ".join("open" if end is None else f"{end:.3g}" for end in (low, high))


@dataclass(frozen=True)
class Conditions:
    """Conditions of a flight, for one axis, as far as its log shows them.

    Attributes:
        size: Root mean square of the command about its median.
        quickness: Number of equivalent command events per second.
        disturbance: Root mean square of the innovations at the levels of all flights: wind and noise.
    """

    size: float
    quickness: float
    disturbance: float


def conditions(rec: Record, innovation: Array, k: int) -> Conditions:
    """Conditions of one flight and axis; `innovation` (B,) at the levels of all flights."""
    command = rec.command[:, k]
    change = np.abs(np.diff(command))
    jumps = float(change.sum() ** 2 / np.sum(change**2)) if change.any() else 0.0
    return Conditions(
        size=float(np.sqrt(np.mean((command - np.median(command)) ** 2))),
        quickness=jumps / float(np.ptp(rec.command_time)),
        disturbance=float(np.sqrt(np.mean(innovation**2))),
    )


def _standing_out(fit: Fit, name: str, spread: Spread) -> list[str]:
    """A line for each flight far from the others, the furthest first, with the conditions that differ."""
    estimate, each = fit.estimates[name], spread.each
    told = [i for i, one in enumerate(each) if one is not None]
    if len(told) < 3:
        return []
    known = np.array([each[i] for i in told])
    flown = _all_conditions(estimate)
    places = serving_flights(fit, estimate)
    lines = []
    for row, i in enumerate(told):
        others = np.delete(known, row, axis=0)
        middle = float(np.median(others[:, 0]))
        apart = float(np.median(np.abs(others[:, 0] - middle))) * 1.4826
        distance = abs(known[row, 0] - middle) / float(
            np.sqrt(known[row, 1] ** 2 + apart**2 + np.median(others[:, 1]) ** 2)
        )
        if distance > STANDS_OUT:
            path = fit.flights[places[i]].path.rsplit("/", 1)[-1]
            unlike = _unlike(flown[i], [one for j, one in enumerate(flown) if j != i])
            lines.append((distance, f"{path} stands out ({_plain(known[row, 0], spread):.3g}): {unlike}"))
    return [line for _, line in sorted(lines, reverse=True)]


def _all_conditions(estimate: Estimate) -> list[Conditions]:
    pairs = zip(estimate.records, estimate.optimum.score.innovations, strict=True)
    return [conditions(rec, innovation[:, estimate.place], estimate.place) for rec, innovation in pairs]


_WORDS = {
    "size": ("larger commands", "smaller commands"),
    "quickness": ("smoother commands", "fewer and larger steps"),
    "disturbance": ("more wind or noise", "less wind or noise"),
}


def _unlike(one: Conditions, others: list[Conditions]) -> str:
    """Conditions in which a flight differs from the others, the largest difference first."""
    ratios = {}
    for part in _WORDS:
        middle = float(np.median([getattr(other, part) for other in others]))
        ratios[part] = getattr(one, part) / middle if middle > 0 else 1.0
    ranked = sorted(ratios, key=lambda part: -abs(np.log(max(ratios[part], 1e-9))))
    said = [
        f"{_WORDS[part][ratios[part] < 1]} ({ratios[part]:.1f} times)"
        for part in ranked
        if not 1 / UNLIKE < ratios[part] < UNLIKE
    ]
    return ", ".join(said) or "commands and wind like those of the others: look at settings, payload, battery"
