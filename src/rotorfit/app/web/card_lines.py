"""Changes one value in the text of a card and leaves everything else as its author wrote it, including comments."""

import json
import re
import tomllib
from collections.abc import Mapping
from typing import Any

from rotorfit.core.card import Card
from rotorfit.core.errors import CardError
from rotorfit.core.frames import AXES, UNIT_SCALE
from rotorfit.core.plain import plain_toml, toml_text
from rotorfit.files.cards import card_from_mapping

_STAMP, _LENGTH, _SPEED = ("s", "ms", "us", "ns"), ("m", "cm", "mm"), ("m/s", "cm/s")

_ANGLE, _RATE = ("rad", "deg"), ("rad/s", "deg/s")

QUANTITIES: tuple[tuple[str, str, str, tuple[str, ...]], ...] = (
    ("command", "time", "time of the commands", _STAMP),
    *(("command", axis, f"command {axis}", tuple(UNIT_SCALE)) for axis in AXES),
    ("pose", "time", "time of the poses", _STAMP),
    *(("pose", axis, f"position {axis}", _LENGTH) for axis in AXES[:3]),
    ("pose", "yaw", "yaw", _ANGLE),
    ("pose", "quaternion", "or a quaternion", ()),
    ("velocity", "time", "time of the velocity", _STAMP),
    *(("velocity", axis, f"velocity {axis}", _RATE if axis == "yaw" else _SPEED) for axis in AXES),
)
"""Section, key, words, units: the rows of the studio's table of a card, in order."""


def parsed(text: str) -> dict[str, Any]:
    """The sections and keys of a card, as plain types.

    Raises:
        CardError: It is not TOML, or has values without a counterpart in JSON.
    """
    try:
        raw = plain_toml(text)
    except ValueError as error:
        raise CardError(f"the card is not readable as TOML: {error}") from None
    try:
        json.dumps(raw, allow_nan=False)
    except (TypeError, ValueError):
        raise CardError("the card holds a date or a number that is not finite; no key of a card takes one") from None
    return raw


def card_from_text(text: str) -> Card:
    """The card of a text.

    Raises:
        CardError: As in `parsed` and `card_from_mapping`.
    """
    return card_from_mapping(parsed(text), "of the studio")


def with_value(text: str, section: str, key: str, value: Any) -> str:
    """A card's text with one value set, or removed.

    The line of the key is changed and keeps its trailing comment; without such a line, one that was commented out takes
    its place. If the text cannot be edited line by line, all of it is written anew.

    Args:
        text: The card as TOML.
        section: Name of a section; empty for the keys on top.
        key: Key in the section.
        value: A string, a number, a boolean, a list or a mapping of these; None removes the key.

    Raises:
        CardError: The text is not TOML, or the section is not a table.
    """
    wanted = parsed(text)
    place = wanted.setdefault(section, {}) if section else wanted
    if not isinstance(place, dict):
        raise CardError(f"the card's {section!r} is not a section; correct it in the text")
    if value is None:
        place.pop(key, None)
        if section and not place:
            del wanted[section]
    else:
        place[key] = value
    changed = _with_line(text.splitlines(), section, key, None if value is None else toml_value(value))
    try:
        kept = plain_toml(changed)
    except ValueError:
        kept = None
    if kept is not None and {k: v for k, v in kept.items() if v != {}} == {k: v for k, v in wanted.items() if v != {}}:
        return changed
    import tomli_w

    return tomli_w.dumps(wanted)


def toml_value(value: Any) -> str:
    """A value as TOML.

    Raises:
        CardError: No card has a value of this type.
    """
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return toml_text(value)
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, list):
        return f"[{', '.join(map(toml_value, value))}]"
    if isinstance(value, Mapping):
        pairs = [f"{_key(name)} = {toml_value(part)}" for name, part in value.items()]
        return f"{{ {', '.join(pairs)} }}"
    raise CardError(f"a card holds no value of the kind {type(value).__name__}")


def _key(name: str) -> str:
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else toml_value(name)


def _with_line(lines: list[str], section: str, key: str, value: str | None) -> str:
    begin, end = _section(lines, section)
    if begin is None:
        lines = [*lines, "", f"[{section}]"]
        begin = end = len(lines)
    named = re.compile(rf"\s*{re.escape(key)}\s*=")
    commented = re.compile(rf"#\s*{re.escape(key)}\s*=")
    own = [i for i in range(begin, end) if named.match(lines[i])]
    if value is None:
        return "\n".join(line for i, line in enumerate(lines) if i not in own[:1]) + "\n"
    if own:
        lines = [*lines[: own[0]], f"{key} = {value}{_comment(lines[own[0]])}", *lines[own[0] + 1 :]]
        return "\n".join(lines) + "\n"
    waiting = [i for i in range(begin, end) if commented.match(lines[i])]
    at = waiting[0] if waiting else _last(lines, begin, end)
    return "\n".join([*lines[:at], f"{key} = {value}", *lines[at + len(waiting[:1]) :]]) + "\n"


def _section(lines: list[str], section: str) -> tuple[int | None, int]:
    """The first line of a section's body and one past its last."""
    heads = [i for i, line in enumerate(lines) if re.match(r"\s*\[", line) and "=" not in line]
    if not section:
        return 0, heads[0] if heads else len(lines)
    own = re.compile(rf"\s*\[\s*{re.escape(section)}\s*\]\s*(#.*)?$")
    for head in heads:
        if own.match(lines[head]):
            return head + 1, next((i for i in heads if i > head), len(lines))
    return None, len(lines)


def _last(lines: list[str], begin: int, end: int) -> int:
    """Index after the last line of a section that is not blank."""
    return max((i + 1 for i in range(begin, end) if lines[i].strip() and not lines[i].startswith("#")), default=begin)


def _comment(line: str) -> str:
    """The comment at the end of a line, with the space before it."""
    for match in re.finditer(r"\s*#", line):  # the first # that leaves a complete value before it
        try:
            tomllib.loads(line[: match.start()])
        except tomllib.TOMLDecodeError:
            continue
        return line[match.start() :]
    return ""
