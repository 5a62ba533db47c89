"""Untrusted texts in TOML and JSON, parsed to plain types; values formatted as TOML.

Input that no card, model or plan contains (unlimited nesting, integers beyond 64 bits, names of book length) raises a
ValueError of one line. The reader of each kind of file turns it into its own error.
"""

import json
import math
import re
import sys
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

DEEPEST = 32
"""Maximum nesting of sections and lists."""

LARGEST_TOML = 4 << 20
"""Maximum bytes of a TOML text: enough for a draft with the names of 40,000 columns in its comments."""

LARGEST_JSON = 64 << 20
"""Maximum bytes of a JSON text: fifty times the largest model."""

LONGEST_NAME = 1000
"""Maximum characters of a name, or of a value shown in an error."""

_INTEGERS = range(-(1 << 63), 1 << 63)

_BETWEEN_NAMES = re.compile(r"[^\w.\-\"' \t]+")

_CONTROL = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")


def is_file(path: Path) -> bool:
    """Whether a file exists; a text that cannot be a path (too long, or with a null byte) is no file."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def plain_toml(text: str) -> dict[str, Any]:
    """Parses a TOML text into its sections and keys.

    Raises:
        ValueError: Not TOML, or beyond what a card or plan contains: nesting deeper than `DEEPEST`, an integer of more
            than 64 bits, a text longer than `LARGEST_TOML`.
    """
    _check_length(text, LARGEST_TOML)
    if max(run.count(".") for run in _BETWEEN_NAMES.split(text)) > LONGEST_NAME:  # tomllib takes squares of that time
        raise ValueError(f"a name of more than {LONGEST_NAME} parts")
    try:
        raw = tomllib.loads(text)
    except RecursionError:
        raise ValueError(_TOO_DEEP) from None
    except ValueError as error:
        raise ValueError(_message(error)) from None
    _check(raw)
    return raw


def plain_json(text: str | bytes) -> Any:
    """Parses a JSON text.

    Raises:
        ValueError: Not JSON, or beyond what a model contains, as in `plain_toml`; NaN and infinities, which are not
            JSON.
    """
    _check_length(text, LARGEST_JSON)
    try:
        raw = json.loads(text, parse_constant=_no_constant, parse_float=_finite)
    except RecursionError:
        raise ValueError(_TOO_DEEP) from None
    except UnicodeDecodeError as error:
        raise ValueError(f"not UTF-8 (byte {error.start})") from None
    except ValueError as error:
        raise ValueError(_message(error)) from None
    _check(raw)
    return raw


_TOO_DEEP = f"nested deeper than {DEEPEST} levels"

_TOO_LARGE = "an integer of more than 64 bits"


def _message(error: ValueError) -> str:
    """The message of a parsing error; Python's own limit on the digits of an integer is reported like ours."""
    return _TOO_LARGE if "integer string conversion" in str(error) else line_of(error)


def _no_constant(name: str) -> Any:
    raise ValueError(f"{name} is not a number")


def _finite(digits: str) -> float:
    if (value := float(digits)) in (math.inf, -math.inf):
        raise ValueError(f"{line_of(digits, 40)} is more than a float holds")
    return value


def _check_length(text: str | bytes, most: int) -> None:
    if len(text) > most:
        raise ValueError(f"more than {most >> 20} MiB of text")


def _check(raw: Any) -> None:
    """Raises ValueError on a value that our files never contain; iterative, so that deep nesting cannot recurse."""
    level = [raw] if isinstance(raw, dict | list) else [[raw]]
    for _ in range(DEEPEST + 1):
        names = [name for one in level if isinstance(one, dict) for name in one]
        if any(len(name) > LONGEST_NAME for name in names):
            raise ValueError(f"a name of more than {LONGEST_NAME} characters")
        parts = [part for one in level for part in (one.values() if isinstance(one, dict) else one)]
        if any(type(part) is int and part not in _INTEGERS for part in parts):
            raise ValueError(_TOO_LARGE)
        level = [part for part in parts if isinstance(part, dict | list)]
        if not level:
            return
    raise ValueError(_TOO_DEEP)


def toml_text(text: str) -> str:
    """A text as a quoted TOML string; lone surrogates (from file names) become replacement characters."""
    quoted = json.dumps(re.sub("[\ud800-\udfff]", "\ufffd", text), ensure_ascii=False)
    return quoted.replace("\x7f", "\\u007f")


def visible(text: str) -> str:
    """A text with escapes for control, bidirectional-override and surrogate characters."""
    return _CONTROL.sub(lambda found: found[0].encode("unicode_escape").decode("ascii"), text)


def line_of(error: object, most: int = LONGEST_NAME) -> str:
    """An error, or any text, as one line of bounded length without control characters."""
    line = visible(" ".join(str(error).split()))
    return line if len(line) <= most else f"{line[: most - 1]}…"


def text_of(path: Path) -> str:
    """Reads a small text file; reading stops at the size of the largest model.

    Raises:
        OSError: The file cannot be read.
        ValueError: It is not UTF-8 text, or too large.
    """
    with path.open("rb") as file:
        data = file.read(LARGEST_JSON + 1)
    _check_length(data, LARGEST_JSON)
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError:
        raise ValueError("not a text file") from None


def is_number(value: Any) -> bool:
    """Whether a value is a finite number and not a bool; an integer must fit a float."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= sys.float_info.max


def shown(value: Any) -> str:
    """A value for an error message: one short line."""
    if isinstance(value, dict | list | tuple) and value:
        return f"{'a section' if isinstance(value, dict) else 'a list'} of {len(value)}"
    if isinstance(value, int) and value not in _INTEGERS:
        return _TOO_LARGE
    return line_of(repr(value), 80)


def listed(names: Sequence[str], last: str = "and") -> str:
    """Names as in a sentence: `x`, `x and y`, `x, y and z`."""
    return f" {last} ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def by_reason(reasons: Mapping[str, str]) -> str:
    """What holds for each name, once for all names for which it is the same: `x and y: no command; z: too short`."""
    names_of: dict[str, list[str]] = {}
    for name, why in reasons.items():
        names_of.setdefault(why, []).append(name)
    return "; ".join(f"{listed(names)}: {why}" for why, names in names_of.items())


def place_of(keys: tuple[str | int, ...]) -> str:
    """A location inside a file: `axes.x.ci95.input[1]`; a key that is not a plain word is quoted."""
    parts = []
    for key in keys:
        plain = isinstance(key, str) and key.isascii() and key.replace("_", "").isalnum()
        parts.append(f"[{key}]" if isinstance(key, int) else f".{key}" if plain else f".{shown(key)}")
    return "".join(parts).removeprefix(".")


def check_finite(raw: Any) -> None:
    """Raises ValueError, with the location, on a number in plain types that is not finite, or on too deep nesting."""
    waiting: list[tuple[Any, tuple[str | int, ...]]] = [(raw, ())]
    while waiting:
        value, place = waiting.pop()
        if len(place) > DEEPEST:
            raise ValueError(_TOO_DEEP)
        if isinstance(value, dict | list | tuple):
            parts = value.items() if isinstance(value, dict) else enumerate(value)
            waiting += [(part, (*place, key)) for key, part in parts]
        elif isinstance(value, int | float) and not isinstance(value, bool) and not is_number(value):
            raise ValueError(f"{place_of(place)}: must be a finite number, not {shown(value)}")
