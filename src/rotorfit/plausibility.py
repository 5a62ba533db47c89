"""Plausibility: findings from what the card's limits, symmetry and the literature say of a model."""

import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from rotorfit.finding import Finding
from rotorfit.frames import AXES
from rotorfit.model import Model
from rotorfit.physics import compared, mapped, people
from rotorfit.published import PublishedSet, sets_for, vehicle_of
from rotorfit.settings import GRAVITY, Meaning, Quantity, limit_text, meaning_of

LIMIT_MARGIN = 1.2
"""Factor by which the whole interval must miss what the card makes one expect."""

GAIN_SYMMETRY = 1.2
"""Ratio of the gains of x and y that a multirotor may have: 9.81 tan(t) knows no direction."""

DAMPING_SYMMETRY = 2.5
"""Ratio of the dampings of x and y that a multirotor may have: bodies are longer than wide; published, up to 2.1."""

ALIKE = 1.25
"""Ratio up to which two sets of coefficients are called alike."""

LAGGING = (
    "; if they are right, the gain is too small because a pure delay stands for the lag of the attitude loop: "
    "compare a structure with a lag"
)
"""The usual cause of a tilt that does less than it should, where the card is right."""

NORMAL = 1.96
"""97.5 % point of the normal distribution."""


def findings_of_settings(model: Model) -> tuple[Finding, ...]:
    """Where a model contradicts its card's limits, the symmetry of x and y, or what others published.

    Args:
        model: Of any method. Axes without numbers are passed over.
    """
    limits = (finding for axis in AXES for finding in _against_limits(model, axis))
    return (*limits, *_against_symmetry(model), *_against_published(model))


def _against_limits(model: Model, axis: str) -> Iterator[Finding]:
    """The measured full-scale quantity lies, with its whole interval, away from what the limits make one expect."""
    meaning, quantity = meaning_of(model.card, axis), compared(model, axis)
    ratio = quantity.ratio
    if ratio is None or ratio.value is None or quantity.measured is None or quantity.expected is None:
        return
    low, high = ratio.ci95
    if low is None or high is None or low <= 0 or (low <= LIMIT_MARGIN and high >= 1 / LIMIT_MARGIN):
        return
    yield Finding(
        "gain_contradicts_limit",
        "warning",
        f"{_reached(axis, meaning, quantity)}, {ratio.value:.2f} times what the card makes one expect "
        f"({quantity.expected:.3g}); {_explained(meaning, quantity)}",
        f"gains of {axis} that are converted to other limits or compared with other flights are off by this factor; "
        "predictions under the settings of these flights are not",
        f"check [limits] of the card against the settings in these flights, unit and scale of the {axis} command"
        + (LAGGING if meaning.asked == "tilt" and ratio.value < 1 else ""),
        axis,
    )


def _reached(axis: str, meaning: Meaning, quantity: Quantity) -> str:
    assert quantity.measured is not None
    value, (low, high) = quantity.measured.value, quantity.measured.ci95
    command = "full command" if meaning.limit else "a command of 1"
    verb = "accelerates" if meaning.asked == "tilt" else "ends"
    by = "by" if meaning.asked == "tilt" else "at"
    return f"{command} {verb} {axis} {by} {value:.3g} {quantity.unit} (95 %: {low:.3g} to {high:.3g})"


def _explained(meaning: Meaning, quantity: Quantity) -> str:
    """Which setting, or which scale, would make it fit."""
    assert quantity.measured is not None
    assert quantity.ratio is not None
    if meaning.limit and quantity.implied_limit and meaning.setting is not None:
        word, said = meaning.limit.replace("_", " "), limit_text(meaning.limit, meaning.setting)
        return f"as if the {word} limit were {people(quantity.implied_limit, meaning.limit)} and not {said}"
    told = f"as if the command were {quantity.ratio.value:.2f} times what was logged"
    if meaning.asked == "tilt":
        tilt = mapped(quantity.measured, lambda reached: math.atan(reached / GRAVITY))
        told += f", or a fraction of a tilt limit of {people(tilt, 'tilt')}"
    return told


def _against_symmetry(model: Model) -> Iterator[Finding]:
    """x and y differ, beyond the 95 % interval of their ratio, by more than a multirotor's shape explains."""
    x, y = (meaning_of(model.card, axis) for axis in ("x", "y"))
    if (x.asked, x.limit) != (y.asked, y.limit) or not (model.axes["x"].predictor and model.axes["y"].predictor):
        return
    tests = {"damping": DAMPING_SYMMETRY}
    if x.asked == "tilt":
        tests = {"input": GAIN_SYMMETRY, **tests}
    told = []
    for name, allowed in tests.items():
        ratio = _ratio(model, name)
        if ratio and max(ratio[1], 1 / ratio[2]) > allowed:
            word = {"input": "input gains", "damping": "dampings"}[name]
            pair = " and ".join(f"{getattr(model.axes[axis], name):.3g}" for axis in ("x", "y"))
            told.append(f"{word} {pair}, ratio {ratio[0]:.2f} (95 %: {ratio[1]:.2f} to {ratio[2]:.2f})")
    if told:
        yield Finding(
            "axes_differ",
            "warning",
            f"x and y differ more than the shape of a multirotor explains: {'; '.join(told)}",
            "one of the two is likely wrong: a channel with another scale or unit, or coefficients bent by a feedback "
            "loop or by too little motion",
            "compare scale and unit of the x and y channels of [command], and fly both with the same excitation",
        )


def _ratio(model: Model, name: str) -> tuple[float, float, float] | None:
    """A coefficient of x over that of y, with the 95 % interval from both standard errors and their covariance."""
    parts = [(getattr(axis, name), axis.stderr[name]) for axis in (model.axes["x"], model.axes["y"])]
    if any(value is None or value <= 0 or not error for value, error in parts):
        return None
    (a, sa), (b, sb) = parts
    names = [f"x.{name}", f"y.{name}"]
    both = all(each in model.covariance_names for each in names)
    shared = float(model.covariance[tuple(model.covariance_names.index(each) for each in names)]) if both else 0.0
    spread = math.sqrt(max((sa / a) ** 2 + (sb / b) ** 2 - 2 * shared / (a * b), 0.0))
    return a / b, a / b * math.exp(-NORMAL * spread), a / b * math.exp(NORMAL * spread)


def _against_published(model: Model) -> Iterator[Finding]:
    """How the model stands to the published sets of its vehicle, where these or it disagree."""
    vehicle = vehicle_of(model.card.name)
    sets = sets_for(vehicle) if vehicle else ()
    own = {name: value for axis in AXES for name, value in _own(model, axis).items()}
    gaps = {known: gap for known in sets if (gap := _gap(own, _theirs(known))) is not None}
    if not gaps:
        return
    between = [gap for one in sets for other in sets if (gap := _gap(_theirs(one), _theirs(other))) is not None]
    nearest, farthest = min(gaps, key=lambda known: gaps[known]), max(gaps, key=lambda known: gaps[known])
    if max(gaps[farthest], *between) <= ALIKE:
        return
    shared = [name for name in own if name in _theirs(nearest)]
    themselves = f"; among themselves they differ by up to {max(between):.3g}" if len(sets) > 1 else ""
    yield Finding(
        "published_sets_disagree",
        "info",
        f"nearest of the published sets of the {vehicle} is {nearest.name} ({nearest.source}): compared by "
        f"{', '.join(shared)} it differs by a factor of {gaps[nearest]:.3g} in the mean"
        + (f", set {farthest.name} by {gaps[farthest]:.3g}" if farthest != nearest else "")
        + themselves
        + _tilts(model, sets),
        "published coefficients hold for the limits and the measurement of their flights, most without the delay",
        "use your own; before gains are compared, convert them to the same limits",
    )


def _own(model: Model, axis: str) -> dict[str, float]:
    """What of an axis compares with published sets: its damping, and its gain where the card says what it should be."""
    damping, ratio = model.axes[axis].damping, compared(model, axis).ratio
    parts = {f"{axis} damping": damping, f"{axis} gain": ratio.value if ratio else None}
    return {name: value for name, value in parts.items() if value is not None and value > 0}


def _theirs(known: PublishedSet) -> dict[str, float]:
    """The same of a published set; gains of commands in SI only, over what they should be, signs aside."""
    parts: dict[str, float] = {}
    for k, axis in enumerate(AXES):
        gain, damping = known.gamma[2 * k : 2 * k + 2]
        if damping is None or gain is None or damping <= 0:
            continue
        parts[f"{axis} damping"] = damping
        if known.command == "si":
            parts[f"{axis} gain"] = abs(gain) / (GRAVITY if axis in ("x", "y") else damping)
    return parts


def _gap(one: Mapping[str, float], other: Mapping[str, float]) -> float | None:
    """Mean factor (root mean square of the logarithms) between what two sets share; None where that is nothing."""
    logs = [math.log(one[name] / other[name]) for name in one if name in other]
    return math.exp(float(np.sqrt(np.mean(np.square(logs))))) if logs else None


def _tilts(model: Model, sets: Sequence[PublishedSet]) -> str:
    """Which tilt limits the gains of x and y equal, where a command of 1 is all of a tilt limit; in degrees."""

    def limit(gain: float) -> float:
        return math.degrees(math.atan(abs(gain) / GRAVITY))

    implied = {axis: compared(model, axis).implied_limit for axis in ("x", "y")}
    tilted = [axis for axis in ("x", "y") if meaning_of(model.card, axis).limit == "tilt"]
    own = [f"{axis} {math.degrees(part.value):.3g}" for axis in tilted if (part := implied[axis]) and part.value]
    theirs = [limit(gain) for known in sets if known.command == "fraction" for gain in known.gamma[:3:2] if gain]
    if not own or not theirs:
        return ""
    ends = f"{min(theirs):.3g} to {max(theirs):.3g}" if len(theirs) > 1 else f"{theirs[0]:.3g}"
    return f"; their x and y gains equal tilt limits of {ends} deg, here {', '.join(own)} deg"
