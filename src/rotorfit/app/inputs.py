"""Arguments of the public functions: paths, flights, models and cards in any form are converted, or one error raised.

Each raises a TypeError for an argument of the wrong type, and a RotorfitError for a value that is not possible.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from os import PathLike, fspath

import numpy as np

from rotorfit.core.card import Card
from rotorfit.core.errors import ModelError, RotorfitError
from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES, Array
from rotorfit.core.log import Log
from rotorfit.core.model import Model
from rotorfit.core.results import HORIZONS, Fit
from rotorfit.files.cards import load_card
from rotorfit.files.log_span import LogSpan, Span, parse_log
from rotorfit.files.models import load

FilePath = str | PathLike[str]

Flights = FilePath | Flight | Iterable[FilePath | Flight]
"""One or several: flights as they are, and logs to be read, `LOG`, `LOG@T0:T1` or `A+B`."""

ModelLike = Model | Fit | FilePath
"""A model, the fit that holds it, or its file."""

CardLike = Card | FilePath
"""A card, the name of a built-in one, or its file."""


def path_text(path: object) -> str:
    """A path as text."""
    if not isinstance(path, str | PathLike):
        raise TypeError(f"expected a path, got {named(path)}")
    return str(fspath(path))


def named(value: object) -> str:
    """Type and value of an argument, for an error message."""
    try:
        return f"{type(value).__name__} {value!r:.60}"
    except ValueError:  # an integer of more digits than Python writes
        return type(value).__name__


def as_card(card: CardLike | None) -> Card | None:
    """The given card, or the one loaded by name or path."""
    return card if card is None or isinstance(card, Card) else load_card(path_text(card))


def as_model(model: ModelLike) -> Model:
    """The given model, that of a fit, or the one loaded from a file."""
    if isinstance(model, Fit):
        return model.model
    if isinstance(model, Model):
        return model
    if isinstance(model, str | PathLike):
        return load(path_text(model))
    raise TypeError(f"expected a model, a fit or the path of a model file, got {named(model)}")


def as_models(models: Iterable[ModelLike]) -> tuple[list[str], list[Model]]:
    """Names and models; a model in memory has no file and is named by its number."""
    if isinstance(models, str | PathLike | Model | Fit | Mapping) or not isinstance(models, Iterable):
        raise TypeError(f"expected a sequence of models, fits or model files, got {named(models)}")
    given = list(models)
    if not given:
        raise ModelError("no model: give at least one")
    names = [path_text(one) if isinstance(one, str | PathLike) else f"model {n}" for n, one in enumerate(given, 1)]
    return names, [as_model(one) for one in given]


def as_logs(flights: Flights) -> list[LogSpan | Flight]:
    """Flights as they are, paths with their spans."""
    many = [flights] if isinstance(flights, str | PathLike | Flight | Log) else flights
    wanted = "expected a flight, the path of a log, or a sequence of them"
    if isinstance(many, Mapping) or not isinstance(many, Iterable):
        raise TypeError(f"{wanted}, got {named(flights)}")
    given = list(many)
    for one in given:
        if isinstance(one, Log):
            raise TypeError(f"{wanted}, got {named(one)}: make a flight of it with rotorfit.flight(log, card)")
        if not isinstance(one, str | PathLike | Flight):
            raise TypeError(f"{wanted}, got {named(one)}")
    return [one if isinstance(one, Flight) else parse_log(path_text(one)) for one in given]


def as_axes(axes: object) -> tuple[str, ...]:
    """Names of axes, from a sequence or a text with commas."""
    if not isinstance(axes, Iterable) or not all(isinstance(axis, str) for axis in axes):
        raise TypeError(f"expected names of axes, got {named(axes)}")
    wanted = tuple(part.strip() for part in axes.split(",")) if isinstance(axes, str) else tuple(axes)
    if not wanted:
        raise RotorfitError(f"no axis: give at least one of {', '.join(AXES)}")
    if unknown := [axis for axis in wanted if axis not in AXES]:
        raise RotorfitError(f"no such axis: {', '.join(map(repr, unknown))}; axes are {', '.join(AXES)}")
    return wanted


def as_word(word: object, what: str) -> str:
    """A name; `what` says of what."""
    if not isinstance(word, str):
        raise TypeError(f"expected the name of a {what}, got {named(word)}")
    return word


def as_span(span: object) -> Span:
    """Start and end of a span, each in seconds, or None for open."""
    if not isinstance(span, Sequence) or isinstance(span, str | bytes) or len(span) != 2:
        raise TypeError(f"a span is a start and an end in seconds, not {named(span)}")
    low, high = (None if end is None else as_number(end, "an end of a span") for end in span)
    return low, high


def as_horizons(horizons: object) -> tuple[float, ...]:
    """Horizons [s]; those of the protocol if none are given."""
    if horizons is None:
        return HORIZONS
    if not isinstance(horizons, Iterable) or isinstance(horizons, str | bytes):
        raise TypeError(f"horizons are a sequence of seconds, not {named(horizons)}")
    return tuple(dict.fromkeys(as_number(each, "a horizon") for each in horizons))


def as_number(value: object, what: str) -> float:
    """A finite number, of Python or of numpy."""
    if isinstance(value, bool) or not isinstance(value, int | float | np.integer | np.floating):
        raise TypeError(f"{what} is a number, not {named(value)}")
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise RotorfitError(f"{what} is a finite number, not {named(value)}")
    return number


def as_whole(value: object, what: str) -> int:
    """A whole number, 0 or more, of Python or of numpy."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer):
        raise TypeError(f"{what} is a whole number, not {named(value)}")
    if not 0 <= value < 1 << 63:
        raise RotorfitError(f"{what} is a whole number of 0 or more, and of less than 64 bits")
    return int(value)


def as_array(values: object, shape: tuple[int | None, ...], what: str) -> Array:
    """Numbers as a float64 array of a given shape, in which None stands for any length."""
    try:
        array = np.asarray(values, float)
    except (TypeError, ValueError, OverflowError):
        raise TypeError(f"{what}: expected an array of numbers, got {named(values)}") from None
    if len(array.shape) != len(shape) or any(n not in (None, m) for n, m in zip(shape, array.shape, strict=True)):
        wanted = ", ".join("N" if n is None else str(n) for n in shape)
        raise TypeError(f"{what}: expected an array of shape ({wanted}), got {array.shape}")
    return array


def joined(sizes: object, by: str) -> str | None:
    """Sizes as the command line has them: numbers [m] joined by `by`."""
    if sizes is None or isinstance(sizes, str):
        return sizes
    if not isinstance(sizes, Sequence) or not sizes:
        raise TypeError(f"expected lengths in metres, got {named(sizes)}")
    return by.join(str(as_number(size, "a length")) for size in sizes)
