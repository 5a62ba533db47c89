"""Log -> Flight -> Fit -> Validation: the compositions that the command line and the report share."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from rotorfit.advice import findings_of_fit
from rotorfit.card import Card, card_from_mapping, card_that_fits, load_card
from rotorfit.errors import LogError, ModelError, RotorfitError
from rotorfit.fit import Fit, Method, fit, with_delay_profiles
from rotorfit.flight import Flight, flight_from_log
from rotorfit.forecast import HORIZONS
from rotorfit.frames import AXES
from rotorfit.model import STRUCTURE, Model, is_model_file, load, with_findings
from rotorfit.sources import read
from rotorfit.validation import Validation, to_mapping, validate

Progress = Callable[[float, str], None]
Span = tuple[float | None, float | None]
WHOLE: Span = (None, None)


@dataclass(frozen=True)
class LogSpan:
    """A log and the part of it that is wanted, in seconds of its common window."""

    path: str
    span: Span


def parse_span(text: str) -> Span:
    """`T0:T1` in seconds, either side may be empty.

    Raises:
        LogError: If it is not of that form.
    """
    start, colon, end = text.partition(":")
    try:
        if not colon:
            raise ValueError
        low, high = (float(part) if part.strip() else None for part in (start, end))
    except ValueError:
        raise LogError(f"span {text!r} is not T0:T1 in seconds, such as 10:60 or :84") from None
    if low is not None and high is not None and low >= high:
        raise LogError(f"span {text!r} ends before it starts; give T0:T1 with T0 < T1")
    return low, high


def parse_log(text: str, default: Span = WHOLE) -> LogSpan:
    """`LOG` or `LOG@T0:T1`; a file of that very name wins."""
    name, at, span = text.rpartition("@")
    if at and ":" in span and not Path(text).exists():
        return LogSpan(name, parse_span(span))
    return LogSpan(text, default)


def load_flight(log: LogSpan, card: str | Card | None = None) -> Flight:
    """Reads a log and applies a card: by name or file, as it is, or the one built-in card that fits."""
    chosen = load_card(card) if isinstance(card, str) else card
    raw = read(log.path)
    return flight_from_log(raw, chosen or card_that_fits(raw), log.span)


def fit_logs(
    logs: Sequence[LogSpan],
    card: str | Card | None = None,
    method: Method = "ml",
    axes: Sequence[str] = AXES,
    progress: Progress | None = None,
    structure: str = STRUCTURE,
) -> Fit:
    """Reads logs, fits them together, and says what was noticed."""
    flights = [load_flight(log, card) for log in logs]
    result = with_delay_profiles(fit(flights, method, axes, progress, structure))
    return replace(result, model=with_findings(result.model, findings_of_fit(result)))


def validate_logs(
    model: Model,
    logs: Sequence[LogSpan],
    card: str | Card | None = None,
    horizons: Sequence[float] = HORIZONS,
    progress: Progress | None = None,
) -> tuple[Validation, tuple[Flight, ...]]:
    """Reads logs with the model's own card unless another is given, and scores the model on them."""
    flights = tuple(load_flight(log, card or card_from_mapping(model.card.raw, "the model's card")) for log in logs)
    return validate(model, flights, horizons, progress), flights


@dataclass(frozen=True)
class Comparison:
    """Several models on the same logs.

    Attributes:
        paths: Of the model files.
        validations: One each model, in that order.
    """

    paths: tuple[str, ...]
    validations: tuple[Validation, ...]


def compare_logs(
    paths: Sequence[str], horizons: Sequence[float] = HORIZONS, progress: Progress | None = None
) -> Comparison:
    """Scores several models on the same logs, each by its own card.

    Args:
        paths: Model files and logs in any order, told apart by content; a log may be `LOG@T0:T1`.
        horizons: [s].
        progress: Called with a fraction and a text; raising in it cancels.

    Raises:
        ModelError: No model among the paths.
        FlightError: No log among them.
    """
    files = [path for path in paths if Path(path).is_file() and is_model_file(path)]
    logs = [parse_log(path) for path in paths if path not in files]
    if not files:
        raise ModelError(f"no model among {', '.join(paths)}; give files written by `rotorfit fit -o` before the logs")
    validations = []
    for number, path in enumerate(files):

        def report(fraction: float, text: str, done: int = number) -> None:
            if progress:
                progress((done + fraction) / len(files), f"{files[done]} on {text}")

        validations.append(validate_logs(load(path), logs, horizons=horizons, progress=report)[0])
    return Comparison(tuple(files), tuple(validations))


def comparison_mapping(comparison: Comparison) -> dict[str, Any]:
    """The comparison as plain JSON types; the baselines are those of the first model."""
    mappings = [to_mapping(validation) for validation in comparison.validations]
    pairs = zip(comparison.paths, mappings, strict=True)
    return {
        "models": [{"path": path, "flights": mapping["flights"]} for path, mapping in pairs],
        "baselines": mappings[0]["baselines"],
    }


def training_flights(model: Model) -> tuple[tuple[Flight, ...], tuple[str, ...]]:
    """The flights that a model was fitted to, as far as their logs are still where they were, unchanged.

    Returns:
        The flights; and one line about each that is left out, with the reason.
    """
    flights, left_out = [], []
    for source in model.flights:
        try:
            flight = load_flight(LogSpan(source.path, source.span), model.card)
        except RotorfitError as error:
            left_out.append(f"training flight left out: {error}")
            continue
        if flight.sha256 == source.sha256:
            flights.append(flight)
        else:
            left_out.append(f"training flight left out: {source.path} is not the file that the model was fitted to")
    return tuple(flights), tuple(left_out)


MODEL_MARK, REPORT_MARK = b'"rotorfit-model"', b"<!doctype html"
"""What the first bytes of a model file and of a report hold, in small letters."""


def check_destination(path: Path, mark: bytes) -> None:
    """Refuses to write over what is not an earlier result of the same kind: never over a log.

    Args:
        path: Where something will be written.
        mark: What the first 4096 bytes of an earlier result hold, in small letters.

    Raises:
        LogError: The path is taken by something else, or its folder does not exist.
    """
    if path.is_dir() or (path.exists() and mark not in _head(path)):
        raise LogError(f"{path}: exists and is no earlier result of this kind: not overwritten; choose another name")
    if not path.parent.is_dir():
        raise LogError(f"{path}: there is no folder {path.parent}; make it first")


def _head(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(4096).lower()
