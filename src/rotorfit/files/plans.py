"""The plan file: TOML that a person can read and edit. A plan survives writing and reading unchanged."""

import hashlib
import math
from collections.abc import Iterable, Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any

from rotorfit.core.errors import CardError, PlanError, nearest
from rotorfit.core.flight_plan import AxisExcitation, Chirp, Feedback, Four, Plan, Signal, Sines, Space, Steps
from rotorfit.core.frames import AXES
from rotorfit.core.plain import check_finite, is_number, plain_toml, shown, text_of
from rotorfit.core.writing import check_place, write_result
from rotorfit.files.cards import card_from_mapping
from rotorfit.files.mistaken import mistaken
from rotorfit.version import __version__

FORMAT = "rotorfit-plan"

VERSION = 1

RATES = (5.0, 500.0)
"""Command rates that can be flown [Hz]: below, autopilots take a pause for a lost link (PX4 after half a second);
above, the period approaches what an ordinary kernel can keep."""

LONGEST = 1800.0
"""Longest plan [s]: no battery of such vehicles lasts longer."""

FASTEST = 30.0
"""Largest speed that a plan may allow, along any axis [m/s]."""

WIDEST, FARTHEST = 500.0, 1e7
"""Longest side of a box, and the largest coordinate of a corner, such as on a map [m]."""

STIFFEST = 100.0
"""Largest stiffness [1/s^2] and damping [1/s] of a feedback; with a delay of 0.1 s a tenth of it already oscillates."""

SLOWEST = 5.0
"""Longest delay and filter [s]."""

LARGEST = 100.0
"""Largest amplitude or level of a signal [unit of the command, m or rad]."""

GAINS = (1e-3, 1e3)
"""Range of a believed input's magnitude [m/s^2 or rad/s^2 per command]; the upper bound also limits damping [1/s]."""

MOST_STEPS, MOST_SAMPLES = 100_000, 2e7
"""Most levels of a signal; most commands of a plan times sines of its signals, all of which are computed before the
flight."""

PLAN_MARK = b'"rotorfit-plan"'
"""Bytes found near the start of every plan file."""

_KEYS = (
    "format", "version", "rotorfit", "name", "design", "seed", "rate", "duration", "ramp", "excitations", "space",
    "feedback", "predicted", "belief", "card",
)  # fmt: skip

_SIGNALS: Mapping[str, tuple[str, ...]] = {
    "sines": ("amplitude", "frequency", "phase"),
    "chirp": ("amplitude", "frequency", "sweep"),
    "steps": ("time", "level"),
}

_SPACE = ("lower", "upper", "start", "speed", "climb")

_FEEDBACK = ("axes", "stiffness", "damping", "filter_time")

SEAL = "# as written: "
"""Start of the last line of a plan file: a checksum of the text above it."""

HEAD = """\
# A flight for `rotorfit fly`. Times in s, lengths in m, angles in rad; axes are forward, left, up, counter-clockwise.
# Commands are in the unit of the card below: fractions of full scale, or SI. What stands under [predicted] is what
# `rotorfit plan` expects of the flight as it was written: after an edit it no longer holds.
"""


def save_plan(plan: Plan, path: str | Path) -> Path | None:
    """Writes a plan file and returns the path where a replaced file is kept, or None.

    Raises:
        LogError: Its folder is missing.
        OSError: The file cannot be written.
    """
    return write_result(path, plan_text(plan))


def plan_text(plan: Plan) -> str:
    """The plan as TOML, with a short header; the checksum on its last line shows whether it was edited since."""
    import tomli_w

    return _sealed(HEAD + tomli_w.dumps(plan_mapping(plan)))


def check_plan_destination(path: Path) -> None:
    """Refuses to overwrite anything but an unedited plan, because plans are made to be edited.

    Raises:
        PlanError: The path holds something else, such as an edited plan.
        LogError: Its folder is missing or takes no file.
    """
    if path.exists() and not _as_written(path):
        raise PlanError(
            f"{path}: exists, and is not as `rotorfit plan` wrote it: not overwritten; choose another name or remove it"
        )
    check_place(path)


def _as_written(path: Path) -> bool:
    """Whether a file is a plan that nobody has edited."""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        return False
    body, mark, _ = text.rpartition(SEAL)
    return bool(mark) and text == _sealed(body)


def _sealed(text: str) -> str:
    return f"{text}{SEAL}{hashlib.sha256(text.encode()).hexdigest()[:16]}\n"


def load_plan(path: str | Path) -> Plan:
    """Reads a plan file.

    Args:
        path: A file written by `save_plan` or `rotorfit plan -o`, edited or not.

    Returns:
        The plan.

    Raises:
        PlanError: Missing, not TOML, of another version, with an unknown key, or with a value that cannot be flown.
    """
    if told := mistaken(path, "plan"):
        raise PlanError(told)
    try:
        text = text_of(Path(path))
    except OSError as error:
        raise PlanError(
            f"plan {path}: cannot be read ({error.strerror}); give a file written by `rotorfit plan -o`"
        ) from None
    except ValueError as error:
        raise PlanError(f"plan {path}: {error}; give one written by `rotorfit plan -o`") from None
    return plan_from_text(text, str(path))


def plan_from_text(text: str, where: str) -> Plan:
    """Parses the text of a plan file; raises as `load_plan` does."""
    try:
        raw = plain_toml(text)
    except ValueError as error:
        raise PlanError(f"plan {where}: not readable as TOML: {error}") from None
    return plan_from_mapping(raw, where)


def plan_mapping(plan: Plan) -> dict[str, Any]:
    """The plan as plain types; without feedback there is no such section."""
    space, feedback = plan.space, plan.feedback
    return {
        "format": FORMAT,
        "version": VERSION,
        "rotorfit": __version__,
        "name": plan.name,
        "design": plan.design,
        "seed": plan.seed,
        "rate": plan.rate,
        "duration": plan.duration,
        "ramp": plan.ramp,
        "space": {
            "lower": list(space.lower), "upper": list(space.upper), "start": list(space.start), "speed": space.speed,
            "climb": space.climb,
        },
        **({"feedback": _feedback_mapping(feedback)} if feedback else {}),
        "excitations": [_excitation_mapping(each) for each in plan.excitations],
        **({"predicted": dict(plan.predicted)} if plan.predicted else {}),
        "card": dict(plan.card),
        **({"belief": dict(plan.belief)} if plan.belief else {}),
    }  # fmt: skip


def _feedback_mapping(feedback: Feedback) -> dict[str, Any]:
    return {
        "axes": list(feedback.axes), "stiffness": list(feedback.stiffness), "damping": list(feedback.damping),
        "filter_time": feedback.filter_time,
    }  # fmt: skip


def _excitation_mapping(excitation: AxisExcitation) -> dict[str, Any]:
    signal = excitation.signal
    head = {"axis": excitation.axis, "target": excitation.target, "start": excitation.start}
    head |= {"duration": excitation.duration}
    if isinstance(signal, Sines):
        parts = {name: list(getattr(signal, name)) for name in _SIGNALS["sines"]}
        return head | {"signal": "sines", **parts}
    if isinstance(signal, Chirp):
        frequency = list(signal.frequency)
        return head | {
            "signal": "chirp",
            "amplitude": signal.amplitude,
            "frequency": frequency,
            "sweep": signal.duration,
        }
    return head | {"signal": "steps", "time": list(signal.time), "level": list(signal.level)}


def plan_from_mapping(raw: Mapping[str, Any], where: str) -> Plan:
    """Checks a plan as parsed from TOML.

    Args:
        raw: The keys of a plan.
        where: Name of the file, for the error message.

    Raises:
        PlanError: As `load_plan`.
    """
    place = f"plan {where}"
    if raw.get("format") != FORMAT:
        raise PlanError(f"{place}: not a rotorfit plan; give a file written by `rotorfit plan -o`")
    if raw.get("version") != VERSION:
        raise PlanError(
            f"{place}: version {shown(raw.get('version'))}, this one reads {VERSION}; use the rotorfit that wrote it"
        )
    _check(raw, _KEYS, place)
    duration = _positive(raw, "duration", place)
    plan = Plan(
        name=_text(raw, "name", place),
        design=_text(raw, "design", place),
        card=_checked_card(_section(raw, "card", place), place),
        rate=_rate(raw, place),
        duration=duration,
        ramp=_not_negative(raw, "ramp", place),
        excitations=_excitations(raw, duration, place),
        feedback=_feedback(_section(raw, "feedback", place), f"{place}, [feedback]") if "feedback" in raw else None,
        space=_space(_section(raw, "space", place), f"{place}, [space]"),
        belief=_section(raw, "belief", place) if "belief" in raw else {},
        predicted=_section(raw, "predicted", place) if "predicted" in raw else {},
        seed=_whole(raw, "seed", place),
    )
    _check_together(plan, place)
    return plan


def _check_together(plan: Plan, place: str) -> None:
    """Checks that the parts fit together."""
    _check_sense(plan, place)
    commanded = card_from_mapping(plan.card, place).command
    acting = plan.feedback.axes if plan.feedback else ()
    for each in plan.excitations:
        if each.axis not in commanded:
            raise PlanError(f"{place}: it excites {each.axis}, for which its card has no command")
        if each.target == "position" and each.axis not in acting:
            raise PlanError(f"{place}: a position on {each.axis} needs [feedback] with that axis in its axes")
    for at in set(acting) - set(commanded):
        raise PlanError(f"{place}, [feedback]: it acts on {at}, for which the card has no command")
    if acting and "gamma" not in plan.belief:
        raise PlanError(f"{place}: feedback needs gamma under [belief]")


def _check_sense(plan: Plan, place: str) -> None:
    """Refuses implausible values before anything of their size is drawn or allocated."""
    space, feedback = plan.space, plan.feedback
    sizes = [high - low for low, high in zip(space.lower, space.upper, strict=True)]
    asked: list[tuple[str, float, float]] = [
        ("duration", plan.duration, LONGEST),
        ("ramp", plan.ramp, plan.duration),
        ("seed", plan.seed, 2.0**63),
        ("[space], speed", space.speed, FASTEST),
        ("[space], climb", space.climb, FASTEST),
        *(("[space], the size of the box", size, WIDEST) for size in sizes),
        *(("[space], a corner", abs(end), FARTHEST) for end in (*space.lower, *space.upper)),
    ]
    if feedback:
        asked += [("[feedback], stiffness", value, STIFFEST) for value in feedback.stiffness]
        asked += [("[feedback], damping", value, STIFFEST) for value in feedback.damping]
        asked.append(("[feedback], filter_time", feedback.filter_time, SLOWEST))
    for number, each in enumerate(plan.excitations, 1):
        asked += [(f"excitation {number}, {name}", *ends) for name, ends in _bounds(each, plan.rate).items()]
    for name, value, most in asked:
        if not value <= most:
            raise PlanError(f"{place}, {name}: {value:g} exceeds the limit {most:g}")
    sines = sum(len(each.signal.amplitude) for each in plan.excitations if isinstance(each.signal, Sines))
    if plan.duration * plan.rate * max(sines, 1) > MOST_SAMPLES:
        raise PlanError(f"{place}: {sines} sines over {plan.duration:g} s at {plan.rate:g} Hz are too many")
    _check_believed(plan, place)


def _bounds(excitation: AxisExcitation, rate: float) -> dict[str, tuple[float, float]]:
    """Each property of a signal with its upper bound; frequencies may not exceed half the command rate (Nyquist)."""
    signal = excitation.signal
    if isinstance(signal, Steps):
        return {"level": (max(map(abs, signal.level)), LARGEST), "time": (len(signal.time), MOST_STEPS)}
    amplitudes = signal.amplitude if isinstance(signal, Sines) else (signal.amplitude,)
    frequencies = [*map(abs, signal.frequency)]
    if isinstance(signal, Chirp):  # past its sweep the frequency keeps growing
        low, high = signal.frequency
        grown = math.log(high / low) * excitation.duration / signal.duration
        frequencies.append(low * math.exp(min(grown, 700.0)))  # which a double still holds
    return {
        "amplitude": (sum(map(abs, amplitudes)), LARGEST),
        "frequency": (max(frequencies), math.pi * rate),
    }


def _check_believed(plan: Plan, place: str) -> None:
    """Checks what feedback, braking and the guard divide by and rely on; `belief_from_mapping` checks the rest."""
    try:
        check_finite([plan.belief, plan.predicted])
    except ValueError as error:
        raise PlanError(f"{place}, [belief] or [predicted]: {error}") from None
    for name in ("leaving", "allowed"):
        if name in plan.predicted:
            value = _number(plan.predicted, name, f"{place}, [predicted]")
            if not 0 <= value <= 1:
                raise PlanError(f"{place}, [predicted], {name}: must be a share from 0 to 1, not {value:g}")
    where = f"{place}, [belief]"
    if "delay" in plan.belief and not all(0 <= delay <= SLOWEST for delay in _numbers(plan.belief, "delay", where, 4)):
        raise PlanError(f"{where}, delay: must be from 0 to {SLOWEST:g} s")
    if "gamma" not in plan.belief:
        return
    gamma = _numbers(plan.belief, "gamma", where, 8)
    for axis, gain, damping in zip(AXES, gamma[::2], gamma[1::2], strict=True):
        if not GAINS[0] <= abs(gain) <= GAINS[1]:
            raise PlanError(f"{where}, gamma: an input of {gain:g} on {axis} is implausible; plan it again")
        if abs(damping) > GAINS[1]:
            raise PlanError(f"{where}, gamma: a damping of {damping:g} on {axis} is implausible; plan it again")


def _checked_card(raw: Mapping[str, Any], place: str) -> Mapping[str, Any]:
    try:
        card_from_mapping(raw, "in it")
    except CardError as error:
        raise PlanError(f"{place}: {error}") from None
    return raw


def _excitations(raw: Mapping[str, Any], duration: float, place: str) -> tuple[AxisExcitation, ...]:
    listed = raw.get("excitations")
    if not isinstance(listed, list) or not all(isinstance(each, Mapping) for each in listed):
        raise PlanError(f"{place}: excitations must be sections [[excitations]], at least one")
    if not listed:
        raise PlanError(f"{place}: no excitation: nothing would be flown")
    return tuple(_excitation(each, duration, f"{place}, excitation {i}") for i, each in enumerate(listed, 1))


def _excitation(raw: Mapping[str, Any], duration: float, place: str) -> AxisExcitation:
    kind = _choice(raw, "signal", tuple(_SIGNALS), place)
    _check(raw, ("axis", "target", "start", "duration", "signal", *_SIGNALS[kind]), place)
    start, length = _not_negative(raw, "start", place), _positive(raw, "duration", place)
    if start + length > duration * (1 + 1e-9):
        raise PlanError(f"{place}: it ends at {start + length:g} s, after the plan, which lasts {duration:g} s")
    target = _choice(raw, "target", ("command", "position"), place)
    if target == "position" and kind == "steps":
        raise PlanError(f"{place}: a position must move smoothly: sines or chirp, not steps")
    return AxisExcitation(
        _choice(raw, "axis", AXES, place), "position" if target == "position" else "command", start, length,
        _signal(kind, raw, place),
    )  # fmt: skip


def _signal(kind: str, raw: Mapping[str, Any], place: str) -> Signal:
    if kind == "chirp":
        low, high = _numbers(raw, "frequency", place, 2)
        if min(low, high) <= 0 or low == high:
            raise PlanError(f"{place}: the frequencies of a chirp must be positive and differ")
        return Chirp(_number(raw, "amplitude", place), (low, high), _positive(raw, "sweep", place))
    if kind == "steps":
        time, level = _numbers(raw, "time", place), _numbers(raw, "level", place)
        if len(time) != len(level) or any(after <= before for before, after in pairwise(time)):
            raise PlanError(
                f"{place}: time must increase and have a level each: {len(time)} times, {len(level)} levels"
            )
        return Steps(time, level)
    parts = [_numbers(raw, name, place) for name in _SIGNALS["sines"]]
    if len({len(part) for part in parts}) != 1:
        raise PlanError(f"{place}: amplitude, frequency and phase must have the same length")
    return Sines(*parts)


def _feedback(raw: Mapping[str, Any], place: str) -> Feedback:
    _check(raw, _FEEDBACK, place)
    axes = raw.get("axes")
    if not isinstance(axes, list) or not all(axis in AXES for axis in axes):
        raise PlanError(f"{place}: axes must be some of {', '.join(AXES)}, not {shown(axes)}")
    stiffness, damping = (_four(raw, name, place) for name in ("stiffness", "damping"))
    if min(stiffness + damping) < 0:
        raise PlanError(f"{place}: a negative stiffness or damping drives the vehicle away")
    return Feedback(tuple(axes), stiffness, damping, _not_negative(raw, "filter_time", place))


def _space(raw: Mapping[str, Any], place: str) -> Space:
    _check(raw, _SPACE, place)
    lower, upper = (_numbers(raw, name, place, 3) for name in ("lower", "upper"))
    start = _four(raw, "start", place)
    for name, low, at, high in zip(AXES, lower, start, upper, strict=False):
        if not low < at < high:
            raise PlanError(f"{place}: the start {name} = {at:g} is not inside {low:g} to {high:g}")
    x0, y0, z0 = lower
    x1, y1, z1 = upper
    return Space((x0, y0, z0), (x1, y1, z1), start, _positive(raw, "speed", place), _positive(raw, "climb", place))


def _check(raw: Mapping[str, Any], known: Iterable[str], place: str) -> None:
    """Refuses an unknown key and suggests the nearest."""
    for key in raw:
        if key not in known:
            raise PlanError(f"{place}: unknown key {shown(key)}{nearest(key, known)}")


def _value(raw: Mapping[str, Any], key: str, place: str) -> Any:
    if key not in raw:
        raise PlanError(f"{place}: key {key!r} is missing")
    return raw[key]


def _section(raw: Mapping[str, Any], key: str, place: str) -> Mapping[str, Any]:
    value = _value(raw, key, place)
    if not isinstance(value, Mapping):
        raise PlanError(f"{place}, {key}: must be a section [{key}], not {shown(value)}")
    return value


def _text(raw: Mapping[str, Any], key: str, place: str) -> str:
    value = _value(raw, key, place)
    if not isinstance(value, str) or not value:
        raise PlanError(f"{place}, {key}: must be a text, not {shown(value)}")
    return value


def _choice(raw: Mapping[str, Any], key: str, known: tuple[str, ...], place: str) -> str:
    value = _text(raw, key, place)
    if value not in known:
        raise PlanError(f"{place}, {key}: {shown(value)} is not one of {', '.join(known)}{nearest(value, known)}")
    return value


def _number(raw: Mapping[str, Any], key: str, place: str) -> float:
    value = _value(raw, key, place)
    if not is_number(value):
        raise PlanError(f"{place}, {key}: must be a finite number, not {shown(value)}")
    return float(value)


def _positive(raw: Mapping[str, Any], key: str, place: str) -> float:
    value = _number(raw, key, place)
    if value <= 0:
        raise PlanError(f"{place}, {key}: must be positive, not {value:g}")
    return value


def _rate(raw: Mapping[str, Any], place: str) -> float:
    value, (low, high) = _number(raw, "rate", place), RATES
    if not low <= value <= high:
        raise PlanError(f"{place}, rate: {value:g} commands a second cannot be flown; give {low:g} to {high:g}")
    return value


def _not_negative(raw: Mapping[str, Any], key: str, place: str) -> float:
    value = _number(raw, key, place)
    if value < 0:
        raise PlanError(f"{place}, {key}: must not be negative, not {value:g}")
    return value


def _whole(raw: Mapping[str, Any], key: str, place: str) -> int:
    value = _value(raw, key, place)
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise PlanError(f"{place}, {key}: must be a whole number, 0 or more, not {shown(value)}")
    return value


def _numbers(raw: Mapping[str, Any], key: str, place: str, count: int | None = None) -> tuple[float, ...]:
    value = _value(raw, key, place)
    if not isinstance(value, list) or not value or not all(map(is_number, value)):
        raise PlanError(f"{place}, {key}: must be a list of finite numbers, not {shown(value)}")
    if count is not None and len(value) != count:
        raise PlanError(f"{place}, {key}: must have {count} numbers, not {len(value)}")
    return tuple(map(float, value))


def _four(raw: Mapping[str, Any], key: str, place: str) -> Four:
    x, y, z, yaw = _numbers(raw, key, place, 4)
    return x, y, z, yaw
