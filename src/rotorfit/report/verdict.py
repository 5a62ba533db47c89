"""Can this model be used, and how far ahead does it predict? In plain words, with a traffic light per axis."""

from collections.abc import Sequence
from dataclasses import dataclass

from rotorfit.evidence import LENGTH, SPEED, Score
from rotorfit.frames import AXES
from rotorfit.model import Axis, Model

USEFUL = 2.0
"""How many times better than holding the velocity a model must predict to be called usable."""

USELESS = 1.1
"""Below this it is no better than holding the velocity."""

PLANNING = 1.0
"""Horizon that the verdict is about [s]."""

WORDS = {"green": "use it", "yellow": "with care", "red": "do not use", "grey": "no model"}

STATUS = {
    "not_excited": "its commands explain nothing of the motion",
    "too_short": "there is too little data",
    "diverged": "the estimation found no optimum",
    "not_identifiable": "the data do not separate it from the other coefficients",
}


@dataclass(frozen=True)
class Light:
    """What is said of one axis.

    Attributes:
        axis: Name.
        colour: `green`, `yellow`, `red`, or `grey` where there is no model.
        word: In two words.
        error: Velocity error at the planning horizon, with unit; None where it was not scored.
        sentences: How well it predicts.
        reasons: Why the light is not green.
    """

    axis: str
    colour: str
    word: str
    error: str | None
    sentences: tuple[str, ...]
    reasons: tuple[str, ...]


@dataclass(frozen=True)
class Verdict:
    """The first thing that a reader sees.

    Attributes:
        headline: One sentence.
        horizon: That it is about [s].
        lights: Of x, y, z, yaw.
    """

    headline: str
    horizon: float
    lights: tuple[Light, ...]


def verdict_of(model: Model, scores: Sequence[Score]) -> Verdict:
    """Judges a model by its scores on validation flights, its statuses and its findings.

    Green: scored on flights that command the axis and at least `USEFUL` times better than holding the velocity, all
    coefficients known, no warning. Red: below `USELESS` times, or a finding that forbids its use. Grey: no model.
    Yellow: all else, with the reasons.

    Args:
        model: With its findings.
        scores: As `evidence.scores_of` gives them.
    """
    lights = tuple(_light(model, axis, [score for score in scores if score.axis == axis]) for axis in AXES)
    horizon = _planning(scores).horizon if scores else PLANNING
    return Verdict(_headline(lights, horizon), horizon, lights)


def _planning(scores: Sequence[Score]) -> Score:
    """The score whose horizon is nearest to the one of the verdict."""
    return min(scores, key=lambda score: abs(score.horizon - PLANNING))


def _light(model: Model, axis: str, scores: Sequence[Score]) -> Light:
    known = model.axes[axis]
    if known.predictor is None:
        colour = "red" if known.status["input"] == "diverged" else "grey"
        return Light(axis, colour, "no model", None, (), _sentences([STATUS.get(known.status["input"], "no numbers")]))
    forbidden = [f.evidence for f in model.findings if f.axis in (axis, None) and f.severity == "error"]
    doubts = [f.evidence for f in model.findings if f.axis in (axis, None) and f.severity == "warning"]
    planning = _planning(scores) if scores else None
    error = planning.velocity.get("model") if planning else None
    if planning is None or error is None:
        told = "no validation flight commands this axis for long enough: how well it predicts is not known"
        colour = "red" if forbidden else "yellow"
        return Light(axis, colour, WORDS[colour], None, (), _sentences([*forbidden, told, *doubts]))
    gain = _times(planning.velocity.get("hold"), error)
    weak = []
    if gain is not None and gain < USELESS:
        forbidden.append(f"{planning.horizon:g} s ahead it predicts no better than holding the velocity")
    elif gain is not None and gain < USEFUL:
        weak.append("only a little better than holding the velocity on these flights: they may hardly move this axis")
    reasons = [*forbidden, *weak, *doubts, *_unknown(known, model.method)]
    colour = "red" if forbidden else "yellow" if reasons else "green"
    unit, factor = SPEED[axis]
    said = _sentences([*_said(axis, planning, scores, model.method), *_answers(known)])
    return Light(axis, colour, WORDS[colour], f"{figure(factor * error)} {unit}", said, _sentences(reasons))


def _times(other: float | None, own: float) -> float | None:
    """How many times smaller the own error is."""
    return other / own if other is not None and own > 0 else None


def _unknown(known: Axis, method: str) -> list[str]:
    """Coefficients without numbers."""
    lacking = {name: status for name, status in known.status.items() if status != "ok"}
    told = [f"the {name} alone cannot be told: {STATUS.get(status, status)}" for name, status in lacking.items()]
    if method == "paper" and "delay" in lacking:
        told[list(lacking).index("delay")] = (
            "the paper's method knows no delay: it predicts as if commands acted at once"
        )
    return told


def _answers(known: Axis) -> list[str]:
    """How late the vehicle answers, as far as it is known."""
    if known.delay is not None:
        return [f"a command acts after {known.delay:.2f} s"]
    lag = known.combinations.get("total_lag")
    return [f"the motion trails its command by {lag.value:.2f} s"] if lag is not None and None not in lag.ci95 else []


def _said(axis: str, planning: Score, scores: Sequence[Score], method: str) -> list[str]:
    """How far off the predictions are, against the baselines, and at the longest horizon."""
    unit, factor = SPEED[axis]
    error = planning.velocity["model"]
    assert error is not None
    hold, paper = (_times(planning.velocity.get(name), error) for name in ("hold", "paper"))
    ahead, quantity = f"{planning.horizon:g} s ahead", "yaw rate" if axis == "yaw" else f"{axis} velocity"
    said = [f"{ahead} the {quantity} is off by {figure(factor * error)} {unit}{_better(hold, 'holding the velocity')}"]
    if paper is not None and method != "paper":
        said.append(f"beside the paper's coefficients: {_ratio(paper)}")
    last = max(scores, key=lambda score: score.horizon)
    position = last.position.get("model")
    if position is not None and last.horizon > planning.horizon:
        unit, factor = LENGTH[axis]
        other = _times(last.position.get("hold"), position)
        what = "heading" if axis == "yaw" else "position"
        off = f"the {what} is off by {figure(factor * position)} {unit}"
        said.append(f"{last.horizon:g} s ahead {off}{_better(other, 'holding the velocity')}")
    return said


def _better(times: float | None, than: str) -> str:
    if times is None:
        return ""
    return (
        f", {figure(times)} times better than {than}"
        if times >= 1
        else f", {figure(1 / times)} times worse than {than}"
    )


def _ratio(times: float) -> str:
    if abs(times - 1) < 0.03:
        return "as good"
    return f"{figure(times)} times better" if times > 1 else f"{figure(1 / times)} times worse"


def _headline(lights: Sequence[Light], horizon: float) -> str:
    """One sentence for all axes."""
    by = {colour: [light.axis for light in lights if light.colour == colour] for colour in WORDS}
    if len(by["grey"]) == len(lights):
        return "There is no model yet: no axis has numbers."
    parts = []
    if by["green"]:
        parts.append(f"use it for {_and(by['green'])}")
    if by["yellow"]:
        parts.append(
            f"with care for {_and(by['yellow'])}" if by["green"] else f"use it with care for {_and(by['yellow'])}"
        )
    if by["red"]:
        parts.append(f"not for {_and(by['red'])}" if parts else f"do not use it for {_and(by['red'])}")
    missing = f" There is no model of {_and(by['grey'])}." if by["grey"] else ""
    return f"To plan {horizon:g} s ahead, {', '.join(parts)}.{missing}"


def _and(names: Sequence[str]) -> str:
    return " and ".join(part for part in (", ".join(names[:-1]), names[-1]) if part)


def _sentences(texts: Sequence[str]) -> tuple[str, ...]:
    """Each with a capital and a full stop, unless it begins with the name of an axis."""
    return tuple(f"{t if t.split(' ')[0].strip(':') in AXES else t[:1].upper() + t[1:]}." for t in texts)


def figure(value: float) -> str:
    """A positive number with two digits, never in exponents: 0.92, 2.7, 11, 184."""
    if value >= 10:
        return f"{value:.0f}"
    digits = 1 if value >= 0.995 else 2 if value >= 0.0995 else 3
    return f"{value:.{digits}f}"
