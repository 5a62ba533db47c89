"""What the public functions take: paths, flights, models and cards in any of their forms, or one clear error."""

from collections.abc import Iterable, Sequence
from os import PathLike, fspath

from rotorfit.core.card import Card
from rotorfit.core.errors import RotorfitError
from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES
from rotorfit.core.log import Log
from rotorfit.core.model import Model
from rotorfit.core.results import Fit
from rotorfit.files.cards import load_card
from rotorfit.files.log_span import LogSpan, parse_log
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
        raise TypeError(f"a path is wanted, not {named(path)}")
    return str(fspath(path))


def named(value: object) -> str:
    """What a value is, for an error."""
    return f"{type(value).__name__} {value!r:.60}"


def as_card(card: CardLike | None) -> Card | None:
    """A card that was given, or loaded."""
    return card if card is None or isinstance(card, Card) else load_card(path_text(card))


def as_model(model: ModelLike) -> Model:
    """A model that was given, of a fit, or loaded."""
    if isinstance(model, Fit):
        return model.model
    if isinstance(model, Model):
        return model
    if isinstance(model, str | PathLike):
        return load(path_text(model))
    raise TypeError(f"a model, a fit or the path of a model file is wanted, not {named(model)}")


def as_models(models: Iterable[ModelLike]) -> tuple[list[str], list[Model]]:
    """Names and models; one that is in memory has no file and is called by its number."""
    if isinstance(models, str | PathLike | Model | Fit) or not isinstance(models, Iterable):
        raise TypeError(f"a sequence of models, fits or model files is wanted, not {named(models)}")
    given = list(models)
    names = [path_text(one) if isinstance(one, str | PathLike) else f"model {n}" for n, one in enumerate(given, 1)]
    return names, [as_model(one) for one in given]


def as_logs(flights: Flights) -> list[LogSpan | Flight]:
    """Flights as they are, paths with their spans."""
    many = [flights] if isinstance(flights, str | PathLike | Flight | Log) else flights
    wanted = "a flight, the path of a log, or a sequence of them is wanted"
    if not isinstance(many, Iterable):
        raise TypeError(f"{wanted}, not {named(flights)}")
    given = list(many)
    for one in given:
        if isinstance(one, Log):
            raise TypeError(f"{wanted}, not {named(one)}: make a flight of it with rotorfit.flight(log, card)")
        if not isinstance(one, str | PathLike | Flight):
            raise TypeError(f"{wanted}, not {named(one)}")
    return [one if isinstance(one, Flight) else parse_log(path_text(one)) for one in given]


def as_axes(axes: str | Sequence[str]) -> tuple[str, ...]:
    """Names of axes, from a sequence or a text with commas."""
    wanted = tuple(part.strip() for part in axes.split(",")) if isinstance(axes, str) else tuple(axes)
    if unknown := [axis for axis in wanted if axis not in AXES]:
        raise RotorfitError(f"no such axis: {', '.join(map(repr, unknown))}; axes are {', '.join(AXES)}")
    return wanted


def joined(sizes: str | Sequence[float] | None, by: str) -> str | None:
    """Sizes as the text of the command line."""
    return sizes if sizes is None or isinstance(sizes, str) else by.join(map(str, sizes))
