"""Schema: plain types of a file -> frozen dataclasses, as specified by their annotations.

Only known keys, only the annotated types, only finite numbers; an error names its location inside the file,
`axes.x.ci95.input[1]: must be a finite number, not 'a'`. The classes are those of the core, which no schema library
could use as they stand: msgspec ignores unknown keys of dataclasses and does not name the key of a mapping.
"""

import functools
import re
from collections.abc import Mapping
from dataclasses import MISSING, fields, is_dataclass
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from rotorfit.core.errors import nearest
from rotorfit.core.finding import Finding
from rotorfit.core.flight_data import Note
from rotorfit.core.plain import is_number, place_of, shown

MOST = 1_000_000
"""Most items of one list or section."""

LONGEST = 100_000
"""Most characters of a text."""

_KEY = re.compile(r"[A-Za-z0-9_.]{1,64}")
"""Names of axes, coefficients, horizons: no character that is special in the language of an export."""

_NAMED = {"Note": Note, "Finding": Finding}
"""Annotation names that modules import for type checking only."""

Place = tuple[str | int, ...]


def structured(raw: Any, kind: Any, place: Place = ()) -> Any:
    """Converts plain types to a value of the annotated type.

    Args:
        raw: As parsed from JSON.
        kind: A frozen dataclass, or an annotation of its fields: mappings from names, tuples, unions with None,
            literals, numbers, texts, Any.
        place: Location in the file.

    Returns:
        The value; dataclasses are constructed, everything else is checked.

    Raises:
        ValueError: In one line, with the location inside the file.
    """
    if kind is Any:
        return raw
    if is_dataclass(kind):
        return _record(raw, kind, place)
    origin, parts = get_origin(kind), get_args(kind)
    if origin in (Union, UnionType):
        if raw is None and NoneType in parts:
            return None
        (kind,) = (part for part in parts if part is not NoneType)
        return structured(raw, kind, place)
    if origin is Mapping:
        return _mapping(raw, parts, place)
    if origin is tuple:
        return _tuple(raw, parts, place)
    if origin is Literal:
        return _require(raw in parts, raw, f"one of {', '.join(map(str, parts))}", place)
    right, what = _PLAIN[kind]
    return _require(right(raw), raw, what, place)


_PLAIN: Mapping[Any, Any] = {
    float: (is_number, "a finite number"),
    int: (lambda raw: isinstance(raw, int) and not isinstance(raw, bool) and abs(raw) < 2**63, "a whole number"),
    bool: (lambda raw: isinstance(raw, bool), "true or false"),
    str: (lambda raw: isinstance(raw, str) and len(raw) <= LONGEST, "a text"),
}


def _require(right: bool, raw: Any, what: str, place: Place) -> Any:
    if not right:
        raise ValueError(f"{place_of(place)}: must be {what}, not {shown(raw)}")
    return raw


def _section(raw: Any, place: Place) -> Mapping[str, Any]:
    _require(isinstance(raw, dict) and len(raw) <= MOST, raw, "a section", place)
    return raw  # type: ignore[no-any-return]


def _record(raw: Any, kind: Any, place: Place) -> Any:
    known, needed = _fields_of(kind)
    for key in _section(raw, place):
        if key not in known:
            raise ValueError(f"{place_of((*place, key))}: unknown key{nearest(key, known)}")
    for key in needed:
        if key not in raw:
            raise ValueError(f"{place_of((*place, key))}: is missing")
    return kind(**{key: structured(part, known[key], (*place, key)) for key, part in raw.items()})


@functools.cache
def _fields_of(kind: Any) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Types of the fields by name, and the names of the required ones."""
    hints = get_type_hints(kind, localns=_NAMED)
    own = fields(kind)
    needed = tuple(one.name for one in own if one.default is MISSING and one.default_factory is MISSING)
    return {one.name: hints[one.name] for one in own}, needed


def _mapping(raw: Any, parts: tuple[Any, ...], place: Place) -> Mapping[str, Any]:
    for key in _section(raw, place):
        if not _KEY.fullmatch(key):
            raise ValueError(f"{place_of((*place, key))}: unknown key")
    return {key: structured(part, parts[1], (*place, key)) for key, part in raw.items()}


def _tuple(raw: Any, parts: tuple[Any, ...], place: Place) -> tuple[Any, ...]:
    _require(isinstance(raw, list | tuple) and len(raw) <= MOST, raw, "a list", place)
    kinds = parts[:1] * len(raw) if parts[-1] is Ellipsis else parts
    _require(len(raw) == len(kinds), raw, f"a list of {len(kinds)}", place)
    return tuple(structured(part, kind, (*place, i)) for i, (part, kind) in enumerate(zip(raw, kinds, strict=True)))
