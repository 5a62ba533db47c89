"""Plausibility: findings from a model against the card's limits, symmetry and published values."""

import math
from collections.abc import Iterator

from rotorfit.core.finding import Finding
from rotorfit.core.frames import AXES
from rotorfit.core.limits import GRAVITY, Meaning, Quantity, limit_text, meaning_of
from rotorfit.core.model import NORMAL, Interval, Model
from rotorfit.core.physics import compared, mapped, people
from rotorfit.simulation.published import PublishedSet, sets_for, vehicle_of

LIMIT_MARGIN = 1.2
"""Factor by which the whole interval must miss the value expected from the card."""

ABOVE = 1.02
"""Factor above the speed commanded from which on the whole interval of a final speed is that of no velocity loop; below
1 / `ABOVE` it is not that of a loop with an integral part."""

LIKE_GRAVITY = 1.05
"""Factor by which an input may differ from gravity where gravity is used as a check."""

GAIN_SYMMETRY = 1.2
"""Ratio of the gains of x and y that a multirotor may have: 9.81 tan(t) does not depend on direction."""

DAMPING_SYMMETRY = 2.5
"""Ratio of the dampings of x and y that a multirotor may have: bodies are longer than wide; published, up to 2.1."""

ALIKE = 1.25
"""Factor by which a coefficient must lie outside the range of the published sets."""

LAGGING = (
    "; if they are right, the gain is too small because a pure delay stands for the lag of the attitude loop: "
    "compare a structure with a lag"
)
"""The usual cause of a tilt that has less effect than it should, if the card is right."""


OVERSHOOT = (
    "; if they are right, the law may take the overshoot of an integral part for the final speed: hold some commands "
    "for 9 s or more"
)
"""The usual cause of a final speed above the one commanded, if the card is right."""


def findings_of_settings(model: Model) -> tuple[Finding, ...]:
    """Where a model contradicts its card's limits, the symmetry of x and y, or published values.

    Args:
        model: From any method. Axes without numbers are skipped.
    """
    limits = (
        finding
        for axis in AXES
        for check in (_against_limits, _above_command, _below_command, _by_gravity)
        for finding in check(model, axis)
    )
    return (*limits, *_against_symmetry(model), *_against_published(model))


def _against_limits(model: Model, axis: str) -> Iterator[Finding]:
    """The whole interval of the full-scale quantity lies away from the value expected from the limits."""
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
        f"{_reached(axis, meaning, quantity)}, {ratio.value:.2f} times what the card leads one to expect "
        f"({quantity.expected:.3g}); {_explained(meaning, quantity)}",
        f"gains of {axis} that are converted to other limits or compared with other flights are off by this factor; "
        "predictions under the settings of these flights are not",
        f"check [limits] of the card against the settings in these flights, unit and scale of the {axis} command"
        + (LAGGING if meaning.asked == "tilt" and ratio.value < 1 else "")
        + (OVERSHOOT if meaning.asked != "tilt" and ratio.value > 1 else ""),
        axis,
    )


def _speed_ratio(model: Model, axis: str) -> tuple[float, float, float] | None:
    """Final speed over the one commanded, with the ends of its interval; None for tilts and where it is open."""
    ratio = compared(model, axis).ratio
    if meaning_of(model.card, axis).asked == "tilt" or ratio is None or ratio.value is None:
        return None
    low, high = ratio.ci95
    return None if low is None or high is None else (ratio.value, low, high)


def _above_command(model: Model, axis: str) -> Iterator[Finding]:
    """A final speed above the one commanded: a proportional loop stays below it, an integral part ends at it."""
    ratio = _speed_ratio(model, axis)
    if ratio is None or not ABOVE < ratio[1] <= LIMIT_MARGIN:  # beyond that the card is in doubt
        return
    value, low, high = ratio
    yield Finding(
        "final_speed_above_command",
        "warning",
        f"the law of {axis} ends at {value:.3g} times what is commanded (95 %: {low:.3g} to {high:.3g}), where a "
        "velocity loop ends at it or below",
        f"final speed and slow motion of {axis} are extrapolated from short commands: a loop with an integral part "
        "overshoots, and then ends at what is commanded; motion like that flown is not concerned",
        f"hold some commands of {axis} until the speed is steady, for 9 s or more; and check the unit of the command",
        axis,
    )


def _below_command(model: Model, axis: str) -> Iterator[Finding]:
    """A final speed below the one commanded in SI, which a loop with an integral part reaches later."""
    ratio = None if meaning_of(model.card, axis).limit else _speed_ratio(model, axis)
    if ratio is None or not 1 / LIMIT_MARGIN <= ratio[2] < 1 / ABOVE:  # below that the card is in doubt
        return
    value, low, high = ratio
    yield Finding(
        "final_speed_below_command",
        "info",
        f"the law of {axis} ends at {value:.3g} times what is commanded (95 %: {low:.3g} to {high:.3g})",
        "little for a velocity loop without an integral part, which falls short by drag / (gain + drag); one with an "
        "integral part creeps up to what is commanded, over more seconds than commands lasted: then final speed and "
        f"total lag of {axis} are wrong for slow motion, and motion like that flown is not concerned",
        f"look at the speed at the end of a command of {axis} that is held for 30 s",
        axis,
    )


def _by_gravity(model: Model, axis: str) -> Iterator[Finding]:
    """Gravity as a check of the law: with a lag the input of a tilt is 9.81 tan(tilt), with only a delay it is not."""
    meaning, expected, known = meaning_of(model.card, axis), compared(model, axis).expected, model.axes[axis]
    if meaning.asked != "tilt" or not expected or known.plain is None or known.input is None:
        return
    with_lag, without = known.ci95["input"], known.plain.ci95["input"]
    if not _holds(with_lag, expected, LIKE_GRAVITY) or _holds(without, expected, 1.0) or known.plain.input is None:
        return
    yield Finding(
        "gravity_supports_lag",
        "info",
        f"with a lag beside the delay a full command accelerates {axis} by {known.input / expected:.2f} times what "
        f"gravity gives it, with a delay alone by {known.plain.input / expected:.2f} times",
        f"the attitude loop of {axis} has a lag; coefficients of the delay alone depend on what was flown",
        "keep the default laws for this vehicle",
        axis,
    )


def _holds(ends: Interval, value: float, margin: float) -> bool:
    """Whether a closed interval contains a positive value to within a factor."""
    low, high = ends
    return low is not None and high is not None and low <= margin * value and high >= value / margin


def _reached(axis: str, meaning: Meaning, quantity: Quantity) -> str:
    assert quantity.measured is not None
    value, (low, high) = quantity.measured.value, quantity.measured.ci95
    command = "full command" if meaning.limit else "a command of 1"
    verb = "accelerates" if meaning.asked == "tilt" else "ends"
    by = "by" if meaning.asked == "tilt" else "at"
    return f"{command} {verb} {axis} {by} {value:.3g} {quantity.unit} (95 %: {low:.3g} to {high:.3g})"


def _explained(meaning: Meaning, quantity: Quantity) -> str:
    """Which setting, or which scale, would explain it."""
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
    """Coefficients of a model outside the range of the published sets of its vehicle."""
    vehicle = vehicle_of(model.card.name)
    sets = [_theirs(known) for known in sets_for(vehicle)] if vehicle else []
    told = []
    for name, value in ((name, value) for axis in AXES for name, value in _own(model, axis).items()):
        known = [each[name] for each in sets if name in each]
        if known and not min(known) / ALIKE <= value <= max(known) * ALIKE:
            ends = " to ".join(f"{end:.3g}" for end in sorted({min(known), max(known)}))
            unit = " 1/s" if name.endswith("damping") else " times what the card leads one to expect"
            told.append(f"{name} {value:.3g}{unit} (published: {ends})")
    if told:
        yield Finding(
            "published_sets_disagree",
            "info",
            f"outside the published values for the {vehicle}: {', '.join(told)}",
            "either this vehicle, its settings or its flights differ from theirs, or the coefficient is wrong",
            "look at its interval and at the other findings of its axis; if they are clean, trust your own",
        )


_GAIN = {axis: f"{axis} gain" if axis in ("x", "y") else f"{axis} steady gain" for axis in AXES}
"""What is compared with published sets beside the damping: of x and y the acceleration, of z and yaw the speed."""


def _own(model: Model, axis: str) -> dict[str, float]:
    """Values of an axis to compare with published sets: damping, and gain where the card gives an expected one."""
    damping, ratio = model.axes[axis].damping, compared(model, axis).ratio
    parts = {f"{axis} damping": damping, _GAIN[axis]: ratio.value if ratio else None}
    return {name: value for name, value in parts.items() if value is not None and value > 0}


def _theirs(known: PublishedSet) -> dict[str, float]:
    """The same for a published set; only gains of commands in SI, relative to the expected gain, signs ignored."""
    parts: dict[str, float] = {}
    for k, axis in enumerate(AXES):
        gain, damping = known.gamma[2 * k : 2 * k + 2]
        if damping is None or gain is None or damping <= 0:
            continue
        parts[f"{axis} damping"] = damping
        if known.command == "si":
            parts[_GAIN[axis]] = abs(gain) / (GRAVITY if axis in ("x", "y") else damping)
    return parts
