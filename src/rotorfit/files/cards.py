"""TOML -> Card: every key is checked; for an unknown one the nearest known name is suggested."""

import functools
import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from shlex import quote
from typing import Any, TypeVar

from rotorfit.core.card import (
    ANGLE_UNITS,
    LIMIT_UNITS,
    STAMP_UNITS,
    UNITS_OF_POSE,
    UNITS_OF_VELOCITY,
    Card,
    Channel,
    Condition,
    Prior,
)
from rotorfit.core.errors import CardError, nearest
from rotorfit.core.frames import AXES, UNIT_SCALE
from rotorfit.core.plain import is_file, is_number, line_of, plain_toml, shown, text_of
from rotorfit.files.mistaken import mistaken

Choice = TypeVar("Choice", bound=str | bool)

_MEANINGS = ("tilt", "velocity", "vertical_speed", "yaw_rate")

_ANY = tuple(UNIT_SCALE)

_OF_COMMANDS, _OF_CLOCKS = ("meaning", "full_scale"), ("error",)
"""Keys that only channels of commands, and the times of commands and poses, have."""

_LIMITS = tuple(LIMIT_UNITS)

_SECTIONS: Mapping[str, tuple[str, ...]] = {
    "command": ("frame", "hold", "time", *AXES),
    "pose": ("time", *AXES, "quaternion", "heading_offset", "resets"),
    "velocity": ("frame", "time", "independent", *AXES),
    "attitude": ("time", "yaw", "quaternion"),
    "reference": AXES,
    "window": ("when", "equals", "above", "opens", "closes", "optional"),
    "limits": _LIMITS,
    "prior": AXES,
}


def load_card(name_or_path: str | Path) -> Card:
    """Loads a built-in card by its name, or a card from a TOML file.

    Args:
        name_or_path: Name as listed by `builtin_cards`, or path of a TOML file.

    Returns:
        The card, checked.

    Raises:
        CardError: Neither a known name nor a file; not TOML; or refused by `card_from_mapping`.
    """
    built_in, name_or_path = _builtin_files(), str(name_or_path)
    if name_or_path in built_in:
        return _builtin_card(name_or_path)
    path = Path(name_or_path)
    if not is_file(path):
        raise CardError(
            f"no card {name_or_path[:200]!r}: neither a file nor a built-in name"
            f"{'' if path.suffix else nearest(name_or_path, built_in)} "
            "(`rotorfit cards` lists them)"
        )
    if told := mistaken(path, "card"):
        raise CardError(told)
    try:
        raw = plain_toml(text_of(path))
    except (OSError, ValueError) as err:
        raise CardError(f"card {name_or_path}: not readable as TOML: {line_of(err)}") from err
    return card_from_mapping(raw, name_or_path)


def builtin_cards() -> dict[str, Card]:
    """All cards that ship with rotorfit, by name, sorted."""
    return {name: _builtin_card(name) for name in _builtin_files()}


@functools.cache
def _builtin_card(name: str) -> Card:
    """A built-in card, parsed once: every log that is read is compared with all of them."""
    return card_from_mapping(plain_toml(_builtin_files()[name].read_text(encoding="utf-8")), name)


@functools.cache
def _builtin_files() -> dict[str, Traversable]:
    """Files of the built-in cards by name, sorted."""
    folder = resources.files("rotorfit.files").joinpath("builtin_cards")
    files = {entry.name.removesuffix(".toml"): entry for entry in folder.iterdir() if entry.name.endswith(".toml")}
    return dict(sorted(files.items()))


def builtin_card_text(name: str) -> str:
    """The TOML text of a built-in card.

    Raises:
        CardError: No card has this name; the nearest is suggested.
    """
    known = _builtin_files()
    if name not in known and Path(name).is_file():
        raise CardError(
            f"{name} is a file, not the name of a built-in card: a card of your own is given by --card {quote(name)}"
        )
    if name not in known:
        raise CardError(f"no built-in card {name!r}{nearest(name, known)} (`rotorfit cards` lists them)")
    return known[name].read_text(encoding="utf-8")


def card_from_mapping(raw: Mapping[str, Any], where: str) -> Card:
    """Checks a card as parsed from TOML or stored in a model file.

    Args:
        raw: The sections and keys of a card.
        where: File or name, for the error's text.

    Returns:
        The card; its `raw` is the argument.

    Raises:
        CardError: An unknown key (the nearest is suggested), a wrong type, an unknown unit or meaning, or a missing
            `[command]` or `[pose]`, or one of their essential keys.
    """
    place = f"card {where}"
    _check_keys(raw, ("name", "frame", "clock", "fail_safe", "over", *_SECTIONS), place)
    sections = {key: _section(raw, key, place) for key in _SECTIONS if key != "window"}
    missing = [key for key in ("command", "pose") if key not in raw]
    if missing:
        raise CardError(f"{place}: section [{missing[0]}] is missing")
    command, pose, velocity, attitude = (sections[key] for key in ("command", "pose", "velocity", "attitude"))
    in_command, in_pose = f"{place}, [command]", f"{place}, [pose]"
    commands = {
        axis: _channel(command[axis], f"{in_command} {axis}", _ANY, _OF_COMMANDS) for axis in AXES if axis in command
    }
    if not commands:
        raise CardError(f"{in_command}: no axis is commanded; name a column for at least one of x, y, z, yaw")
    card = Card(
        name=_text(raw.get("name", where), f"{place}, name"),
        frame=_choice(raw.get("frame", "ENU"), ("ENU", "NED"), f"{place}, frame"),
        command_frame=_choice(command.get("frame", "heading"), ("heading", "world"), f"{in_command} frame"),
        hold=_positive(command["hold"], f"{in_command} hold") if "hold" in command else None,
        command_time=_recorded(command, "time", STAMP_UNITS, in_command, _OF_CLOCKS),
        command=commands,
        pose_time=_recorded(pose, "time", STAMP_UNITS, in_pose, _OF_CLOCKS),
        pose=_pose(pose, velocity, in_pose),
        velocity=_channels(velocity, UNITS_OF_VELOCITY, f"{place}, [velocity]"),
        velocity_frame=_choice(velocity.get("frame", "world"), ("heading", "world"), f"{place}, [velocity] frame"),
        velocity_independent=_yes_or_no(velocity.get("independent", False), f"{place}, [velocity] independent"),
        reference=_channels(sections["reference"], dict.fromkeys(AXES, _ANY), f"{place}, [reference]"),
        window=_window(raw.get("window", []), place),
        resets=_resets(pose.get("resets", []), in_pose),
        limits={key: _limit(key, value, f"{place}, [limits] {key}") for key, value in sections["limits"].items()},
        prior={axis: _priors(value, f"{place}, [prior] {axis}") for axis, value in sections["prior"].items()},
        raw=raw,
        velocity_time=_recorded(velocity, "time", STAMP_UNITS, f"{place}, [velocity]") if "time" in velocity else None,
        attitude=_heading(attitude, f"{place}, [attitude]") if attitude else {},
        attitude_time=_recorded(attitude, "time", STAMP_UNITS, f"{place}, [attitude]") if "time" in attitude else None,
        clock=_choice(raw.get("clock", "own"), ("own", "one"), f"{place}, clock"),
        fail_safe=_text(raw["fail_safe"], f"{place}, fail_safe") if "fail_safe" in raw else "",
        over=_names(raw.get("over", []), f"{place}, over"),
        heading_offset=_heading_offset(pose, in_pose),
    )
    refuse_shared({"time": card.command_time, **card.command}, in_command)
    refuse_shared({"time": card.pose_time, **card.pose}, in_pose)
    refuse_shared(card.velocity, f"{place}, [velocity]")
    return card


def refuse_shared(roles: Mapping[str, Channel], place: str) -> None:
    """Refuses one column in two roles: one of them certainly reads what is another's.

    Raises:
        CardError: Two channels name the same column.
    """
    role_of: dict[str, str] = {}
    for role, channel in roles.items():
        if not isinstance(channel.source, str):  # constants may be alike
            continue
        first = role_of.setdefault(channel.source, role)
        if first != role:
            raise CardError(f"{place}: {first} and {role} both read {channel.source!r}; each needs a column of its own")


def _check_keys(raw: Mapping[str, Any], known: Iterable[str], place: str) -> None:
    for key in raw:
        if key not in known:
            raise CardError(f"{place}: unknown key {shown(key)}{nearest(key, known)}")


def _section(raw: Mapping[str, Any], key: str, place: str) -> Mapping[str, Any]:
    return _checked(raw.get(key, {}), key, place)


def _checked(section: Any, key: str, place: str) -> Mapping[str, Any]:
    if not isinstance(section, Mapping):
        raise CardError(f"{place}, {key}: must be a section [{key}], not {shown(section)}")
    _check_keys(section, _SECTIONS[key], f"{place}, [{key}]")
    return section


def _text(value: Any, place: str) -> str:
    if not isinstance(value, str) or not value:
        raise CardError(f"{place}: must be a text, not {shown(value)}")
    return value


def _names(value: Any, place: str) -> tuple[str, ...]:
    if not isinstance(value, list):
        raise CardError(f"{place}: must be a list of names, not {shown(value)}")
    return tuple(_text(name, place) for name in value)


def _number(value: Any, place: str) -> float:
    if not is_number(value):
        raise CardError(f"{place}: must be a finite number, not {shown(value)}")
    return float(value)


def _positive(value: Any, place: str) -> float:
    if _number(value, place) <= 0:
        raise CardError(f"{place}: must be positive, not {shown(value)}")
    return float(value)


def _yes_or_no(value: Any, place: str) -> bool:
    if not isinstance(value, bool):
        raise CardError(f"{place}: must be true or false, not {shown(value)}")
    return value


def _choice(value: Any, known: tuple[Choice, ...], place: str) -> Choice:
    for option in known:
        if value == option:
            return option
    near = nearest(value, [str(option) for option in known]) if isinstance(value, str) else ""
    raise CardError(f"{place}: {shown(value)} is not one of {', '.join(str(option) for option in known)}{near}")


def _channel(value: Any, place: str, units: tuple[str, ...], more: tuple[str, ...] = ()) -> Channel:
    """A channel from a string, a number, `{ from, scale, offset, unit }` and the keys of `more`, or a list."""
    if isinstance(value, list):  # alternative names in different versions of a format
        if not value:
            raise CardError(f"{place}: an empty list names no column")
        first, *others = (_channel(one, place, units, more) for one in value)
        return replace(first, others=tuple(others))
    if not isinstance(value, Mapping):
        return Channel(_source(value, place))
    _check_keys(value, ("from", "scale", "offset", "unit", *more), place)
    if "from" not in value:
        raise CardError(f"{place}: from is missing: which column?")
    if value.get("scale") == 0:
        raise CardError(f"{place}.scale: must not be 0, which would make a constant of the column")
    return Channel(
        source=_source(value["from"], f"{place}.from"),
        scale=_number(value.get("scale", 1.0), f"{place}.scale"),
        offset=_number(value.get("offset", 0.0), f"{place}.offset"),
        unit=_choice(value["unit"], units, f"{place}.unit") if "unit" in value else None,
        meaning=_choice(value["meaning"], _MEANINGS, f"{place}.meaning") if "meaning" in value else None,
        full_scale=_choice(value["full_scale"], _LIMITS, f"{place}.full_scale") if "full_scale" in value else None,
        error=_positive(value["error"], f"{place}.error") if "error" in value else 0.0,
    )


def _source(value: Any, place: str) -> str | float:
    if isinstance(value, str) and value:
        return value
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise CardError(f"{place}: must be a column's name or a number, not {shown(value)}")
    return _number(value, place)


def _channels(raw: Mapping[str, Any], units: Mapping[str, tuple[str, ...]], place: str) -> dict[str, Channel]:
    return {axis: _channel(raw[axis], f"{place} {axis}", units[axis]) for axis in AXES if axis in raw}


def _recorded(
    section: Mapping[str, Any], key: str, units: tuple[str, ...], place: str, more: tuple[str, ...] = ()
) -> Channel:
    """A required channel that must not be a constant, such as a clock or the window."""
    if key not in section:
        raise CardError(f"{place}: {key} is missing: which column?")
    channel = _channel(section[key], f"{place} {key}", units, more)
    if not isinstance(channel.source, str):
        raise CardError(f"{place} {key}: must be a column, not the constant {channel.source:g}")
    return channel


def _window(value: Any, place: str) -> tuple[Condition, ...]:
    """The conditions of `[window]`, or of several `[[window]]`."""
    parts = value if isinstance(value, list) else [value]
    return tuple(_condition(_checked(part, "window", place), f"{place}, [window]") for part in parts)


def _condition(section: Mapping[str, Any], place: str) -> Condition:
    condition = Condition(
        channel=_recorded(section, "when", _ANY, place),
        equals=_numbers(section.get("equals", []), f"{place} equals"),
        above=_number(section["above"], f"{place} above") if "above" in section else None,
        opens=_numbers(section.get("opens", []), f"{place} opens"),
        closes=_numbers(section.get("closes", []), f"{place} closes"),
        optional=_choice(section.get("optional", False), (True, False), f"{place} optional"),
    )
    asked = (bool(condition.equals), condition.above is not None, bool(condition.opens or condition.closes))
    if sum(asked) > 1:
        raise CardError(f"{place}: give one of equals, above, and opens with closes; write a [[window]] for each")
    if bool(condition.opens) != bool(condition.closes):
        raise CardError(f"{place}: opens and closes go together: which events begin the flight, and which end it?")
    return condition


def _numbers(value: Any, place: str) -> tuple[float, ...]:
    return tuple(_number(one, place) for one in (value if isinstance(value, list) else [value]))


def _resets(value: Any, place: str) -> tuple[Channel, ...]:
    names = value if isinstance(value, list) else [value]
    return tuple(_recorded({"resets": name}, "resets", (), place) for name in names)


def _pose(section: Mapping[str, Any], velocity: Mapping[str, Any], place: str) -> dict[str, Channel]:
    """x, y, z, and yaw or qw, qx, qy, qz; x together with y, or z, may be missing where their velocity is given."""
    heading = _heading(section, place)
    missing = [axis for axis in ("x", "y", "z") if axis not in section]
    unknown = [axis for axis in missing if axis not in velocity]
    if unknown:
        raise CardError(
            f"{place}: {unknown[0]} is missing; name its column, or a constant where it was not measured, or its "
            "velocity in [velocity]"
        )
    if ("x" in section) != ("y" in section):
        raise CardError(f"{place}: {missing[0]} is missing; x and y go together: name both, or neither")
    return _channels(section, UNITS_OF_POSE, place) | heading


def _heading_offset(section: Mapping[str, Any], place: str) -> float:
    """What is added to the heading of a quaternion [rad]: an angle, or `{ value, unit }`."""
    value = section.get("heading_offset", 0.0)
    if "heading_offset" in section and "quaternion" not in section:
        raise CardError(f"{place}: heading_offset is for a quaternion; give yaw an offset: yaw = {{ from, offset }}")
    if not isinstance(value, Mapping):
        return _number(value, f"{place} heading_offset")
    _check_keys(value, ("value", "unit"), f"{place} heading_offset")
    unit = _choice(value.get("unit", "rad"), ANGLE_UNITS, f"{place} heading_offset.unit")
    return _number(value.get("value"), f"{place} heading_offset.value") * UNIT_SCALE[unit]


def _heading(section: Mapping[str, Any], place: str) -> dict[str, Channel]:
    """yaw, or qw, qx, qy, qz."""
    if not section.keys() & {"yaw", "quaternion"}:
        raise CardError(
            f"{place}: yaw is missing; name its column, or a quaternion, or a constant where it stayed the same"
        )
    if {"yaw", "quaternion"} <= section.keys():
        raise CardError(f"{place}: name either yaw or quaternion, and not both")
    if "yaw" in section:
        return {"yaw": _channel(section["yaw"], f"{place} yaw", ANGLE_UNITS)}
    value = section["quaternion"]
    names = [f"{value}.{part}" for part in "wxyz"] if isinstance(value, str) else value
    if not isinstance(names, list) or len(names) != 4:
        raise CardError(
            f"{place} quaternion: must be a prefix or four names in the order w, x, y, z, not {shown(value)}"
        )
    parts = zip("wxyz", names, strict=True)
    return {f"q{part}": Channel(_text(name, f"{place} quaternion")) for part, name in parts}


def _limit(key: str, value: Any, place: str) -> float:
    """A limit in SI, from a number or `{ value, unit }`."""
    limit = _limit_in_si(key, value, place)
    if key == "tilt" and limit >= math.pi / 2:
        raise CardError(
            f"{place}: {shown(value)} is no tilt below 90 deg; a number alone is rad, unit = 'deg' says degrees"
        )
    return limit


def _limit_in_si(key: str, value: Any, place: str) -> float:
    if not isinstance(value, Mapping):
        return _positive(value, place)
    _check_keys(value, ("value", "unit"), place)
    if "value" not in value:
        raise CardError(f"{place}: key 'value' is missing")
    unit = _choice(value.get("unit", LIMIT_UNITS[key][0]), LIMIT_UNITS[key], f"{place}.unit")
    return _positive(value["value"], f"{place}.value") * UNIT_SCALE[unit]


def _priors(value: Any, place: str) -> dict[str, Prior]:
    """The priors of one axis."""
    if not isinstance(value, Mapping):
        raise CardError(
            f"{place}: must be coefficients, as in {{ input = {{ mean = 4.0, sd = 0.5 }} }}, not {shown(value)}"
        )
    _check_keys(value, ("input", "damping", "delay"), place)
    return {name: _prior(name, one, f"{place}.{name}") for name, one in value.items()}


def _prior(name: str, value: Any, place: str) -> Prior:
    if not isinstance(value, Mapping):
        raise CardError(f"{place}: must be {{ mean = ..., sd = ... }}, not {shown(value)}")
    _check_keys(value, ("mean", "sd"), place)
    missing = [key for key in ("mean", "sd") if key not in value]
    if missing:
        raise CardError(f"{place}: key {missing[0]!r} is missing")
    number = _positive if name == "damping" else _number
    return Prior(number(value["mean"], f"{place}.mean"), _positive(value["sd"], f"{place}.sd"))
