"""Workflows from logs to flights, fits and validations, shared by the command line, the studio and the library.

Model files and logs also become Cases: each model with the evidence for and against it.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from rotorfit.app.first_use import FITTING, VALIDATION, compile_beforehand
from rotorfit.assessment.advice import with_advice
from rotorfit.assessment.case import UNPROVEN, Case, reservations
from rotorfit.assessment.innovations import placed
from rotorfit.assessment.leave_one_out import LeaveOneOut, leave_one_out, leave_one_out_mapping
from rotorfit.assessment.method_comparison import Ladder, ladder
from rotorfit.assessment.mismatch import beginning
from rotorfit.assessment.prior_influence import with_influence
from rotorfit.assessment.uncertainty import with_uncertainty
from rotorfit.assessment.validation import check_validation, dynamics_from_model, validate_chosen
from rotorfit.core.card import Card
from rotorfit.core.errors import CardError, LogError, RotorfitError
from rotorfit.core.flight_data import Flight, Note
from rotorfit.core.frames import AXES
from rotorfit.core.laws import AVERAGED
from rotorfit.core.limits import disagreement
from rotorfit.core.log import Log
from rotorfit.core.model import Model
from rotorfit.core.plain import line_of
from rotorfit.core.progress import Progress, part_of
from rotorfit.core.results import CURVE, HORIZONS, Fit, Validation
from rotorfit.core.writing import check_place
from rotorfit.diagnosis.card_choice import another_card, card_of, joined_by_plus, proposal
from rotorfit.diagnosis.doctor import findings_of_flight
from rotorfit.estimation.excitation import without_idle_axes
from rotorfit.estimation.fitting import check_fit, fit, with_delay_profiles
from rotorfit.estimation.methods import BEST
from rotorfit.files.cards import card_from_mapping, load_card
from rotorfit.files.kinds import KINDS
from rotorfit.files.log_span import LogSpan, parse_log
from rotorfit.files.logs import read
from rotorfit.files.mistaken import kind_of
from rotorfit.files.models import is_model_file, load
from rotorfit.flights.assemble import flight_from_log
from rotorfit.flights.columns import fits, tables_of
from rotorfit.flights.distinct import check_distinct
from rotorfit.flights.several_files import flights_of


def load_flight(log: LogSpan, card: str | Card | None = None, raw: Log | None = None) -> Flight:
    """Makes a flight from a log, with the findings about its data.

    Args:
        log: The log, with its span.
        card: Name, file or card; None for the log's own card, or the built-in card that fits.
        raw: The log, if it has been read already.

    Raises:
        LogError, CardError, FlightError: The log, or the card for it, cannot be used.
    """
    chosen = load_card(card) if isinstance(card, str) else card
    return _diagnosed(*_flown(log, raw or _read(log, chosen), chosen))


def load_flights(
    logs: Sequence[LogSpan | Flight],
    card: str | Card | None = None,
    otherwise: Card | None = None,
    progress: Progress | None = None,
) -> tuple[Flight, ...]:
    """Reads logs and applies a card to each; logs that only together have the columns of the card are one flight.

    Args:
        logs: The logs, with their spans; a flight among them is taken as it is.
        card: Name, file or card, for all logs.
        otherwise: Without `card`: the card for logs that carry none.
        progress: As in `read`.

    Raises:
        LogError, CardError, FlightError: A log, or the card for it, cannot be used.
    """
    chosen = load_card(card) if isinstance(card, str) else card
    return tuple(flight for _, flight in _all_flown(logs, chosen, otherwise, progress))


def _diagnosed(raw: Log | None, flight: Flight) -> Flight:
    """The flight with the findings about its log; a flight that was given as such keeps its own."""
    return flight if raw is None else replace(flight, findings=findings_of_flight(raw, flight))


def _with_errors(raw: Log | None, flight: Flight) -> Flight:
    """The flight with the findings about its beginning: enough to tell that it was read with a wrong card."""
    return flight if raw is None else replace(flight, findings=findings_of_flight(raw, beginning(flight)))


def _flown(log: LogSpan, raw: Log, card: Card | None) -> tuple[Log, Flight]:
    """A log, and the flight made from it by a card, or by the built-in one that fits."""
    if card is not None:
        flight = flight_from_log(raw, card, log.span)
        told = another_card(raw, card)
        return raw, replace(flight, notes=(*([Note("card_given", told, 1)] if told else ()), *flight.notes))
    proposed = proposal(raw)
    flight = flight_from_log(raw, proposed.card, log.span)
    if proposed.name:
        told = f"read with the built-in card {proposed.name}, {proposed.why}"
        note = Note("card_proposed", told, max(1, len(proposed.rivals)))
        flight = replace(flight, notes=(note, *flight.notes))
    return raw, flight


def _read(log: LogSpan, card: Card | None, progress: Progress | None = None) -> Log:
    """A log, with the tables that a card names; with all tables if there is no card."""
    return read(log.path, tables_of(card) if card else None, progress)


def _carried(raw: Log, otherwise: Card) -> Card:
    """The card that a log carries, or else the other one.

    Raises:
        CardError: The log's card gives the commands another meaning, or other limits.
    """
    if "card" not in raw.attached:
        return otherwise
    card = card_of(raw)
    if trouble := disagreement(card, otherwise, ("the log's card", "the model's")):
        raise CardError(f"{raw.path}: {trouble}; convert the model (rotorfit convert), or name a card with --card")
    return card


def _all_flown(
    given: Sequence[LogSpan | Flight],
    card: Card | None,
    otherwise: Card | None = None,
    progress: Progress | None = None,
) -> list[tuple[Log | None, Flight]]:
    """Every flight of the given logs, in the order of its first log; a given flight is returned without a log."""
    flown: dict[int, tuple[Log | None, Flight]] = {
        number: (None, one) for number, one in enumerate(given) if isinstance(one, Flight)
    }
    logs = {number: one for number, one in enumerate(given) if isinstance(one, LogSpan)}
    parts: dict[int, Log] = {}
    for number, log in logs.items():
        raw, applied = _read(log, card or otherwise, part_of(progress, number, len(given))), card
        if card is None and otherwise:
            applied = _carried(raw, otherwise)
            raw = raw if applied is otherwise else _read(log, applied)
        if applied is None and len(logs) > 1:
            flown[number] = _flown_alone(log, raw, list(logs.values()))
        elif applied is None or len(logs) == 1 or raw.file_of or fits(raw, applied):
            flown[number] = _flown(log, raw, applied)  # at once, so that only one log is in memory
        else:
            parts[number] = read(log.path)
    apart, shared = list(parts), card or otherwise
    for place, raw in flights_of(list(parts.values()), shared):
        flown[apart[place]] = _flown(logs[apart[place]], raw, shared)
    return [flown[number] for number in sorted(flown)]


def _flown_alone(log: LogSpan, raw: Log, logs: Sequence[LogSpan]) -> tuple[Log, Flight]:
    """`_flown` for one of several logs without a card; if two are halves of one flight, the error says so."""
    try:
        return _flown(log, raw, None)
    except CardError as error:
        if apart := joined_by_plus([raw if one is log else read(one.path) for one in logs]):
            raise CardError(apart) from error
        raise


def fit_logs(
    logs: Sequence[LogSpan | Flight],
    card: str | Card | None = None,
    method: str = BEST,
    axes: Sequence[str] = AXES,
    progress: Progress | None = None,
    structure: str = AVERAGED,
    uncertainty: bool = False,
    prior: bool = False,
) -> Fit:
    """Reads logs and fits them together; the model gets its findings, and the accuracy table and priors if wanted."""
    chosen = load_card(card) if isinstance(card, str) else card
    flown = _all_flown(logs, chosen, progress=progress)
    check_fit([flight for _, flight in flown], method, axes, structure, prior)
    compile_beforehand(FITTING, progress)  # once what was given is known to be of use
    flights = [_diagnosed(*one) for one in flown]
    result = with_delay_profiles(fit(flights, method, axes, progress, structure, prior))
    if prior:
        result = with_influence(result)
    if uncertainty:
        result = with_uncertainty(result, progress)
    return with_advice(result, flights, axes)


def leave_one_out_logs(
    fit: Fit, axes: Sequence[str] = AXES, progress: Progress | None = None, structure: str = AVERAGED
) -> tuple[Fit, LeaveOneOut]:
    """Leaves out each flight of a fit in turn; the result is stored in the model."""
    result = leave_one_out(fit.flights, fit.model.method, axes, progress=progress, structure=structure)
    return replace(fit, model=replace(fit.model, leave_one_out=leave_one_out_mapping(result))), result


def ladder_logs(
    logs: Sequence[LogSpan | Flight],
    card: str | Card | None = None,
    axes: Sequence[str] = AXES,
    progress: Progress | None = None,
) -> Ladder:
    """Reads logs and fits every rung of the ladder to them together."""
    chosen = load_card(card) if isinstance(card, str) else card
    return ladder([_diagnosed(*one) for one in _all_flown(logs, chosen, progress=progress)], axes, progress)


def validate_logs(
    model: Model,
    logs: Sequence[LogSpan | Flight],
    card: str | Card | None = None,
    horizons: Sequence[float] = HORIZONS,
    progress: Progress | None = None,
    beside: Sequence[Flight] = (),
) -> tuple[Validation, tuple[Flight, ...]]:
    """Reads logs with the given card, or their own, or the model's, and scores the model on them.

    An axis that a log merely holds is left out if another log, or a flight of `beside`, moves it.
    """
    own = card_from_mapping(model.card.raw, "the model's card")
    chosen = load_card(card) if isinstance(card, str) else card
    read_logs = _all_flown(logs, chosen, own, progress)
    check_validation(model, [flight for _, flight in read_logs], horizons)
    compile_beforehand(VALIDATION, progress)  # once what was given is known to be of use
    flown = [_with_errors(*one) for one in read_logs]
    flights = tuple(placed(model, flight) for flight in without_idle_axes(flown, beside))
    return validate_chosen(model, flights, horizons, progress, assumed=card is None), flights


def usable_logs(
    models: Sequence[Model], logs: Sequence[LogSpan], card: str | Card | None = None
) -> tuple[list[LogSpan], list[str]]:
    """The logs on which all models can be scored together, and one line about each of the others.

    Logs that fail alone are tried once more together, as parts of one flight.
    """
    kept: list[list[Flight]] = [[] for _ in models]

    def trouble(group: Sequence[LogSpan]) -> str:
        """Keeps the flights of some logs, or tells in one line why not; empty if kept."""
        try:
            new = [load_flights(group, card, card_from_mapping(each.card.raw, "the model's card")) for each in models]
            for model, flights, more in zip(models, kept, new, strict=True):
                check_distinct((*flights, *more))
                for flight in more:
                    dynamics_from_model(model, flight)
        except RotorfitError as error:
            return line_of(error)
        for flights, more in zip(kept, new, strict=True):
            flights += more
        return ""

    told = {number: line for number, log in enumerate(logs) if (line := trouble([log]))}
    if len(told) > 1 and not trouble([logs[number] for number in told]):
        told = {}
    lines = [line if logs[n].path in line else f"{logs[n].path}: {line}" for n, line in told.items()]
    return [log for number, log in enumerate(logs) if number not in told], lines


def training_flights(model: Model) -> tuple[tuple[Flight, ...], tuple[str, ...]]:
    """The flights that a model was fitted to, if their logs are still in place and unchanged.

    Returns:
        The flights; and one line about each that is left out, with the reason.
    """
    if model.conversion:  # its card no longer has the limits of which their commands were fractions
        return (), ("training flights left out: the model was converted to limits that they were not flown under",)
    flights, left_out = [], []
    for source in model.flights:
        try:
            (flight,) = load_flights([LogSpan(source.path, source.span)], None, model.card)
        except RotorfitError as error:
            left_out.append(f"training flight left out: {error}")
            continue
        if flight.sha256 == source.sha256:
            flights.append(placed(model, flight))
        else:
            left_out.append(f"training flight left out: {source.path} is not the file that the model was fitted to")
    return tuple(flights), tuple(left_out)


MODEL_MARK, REPORT_MARK = b'"rotorfit-model"', b"<!doctype html"
"""Text in the first bytes of a model file and of a report, in lower case."""


def check_destination(path: Path, mark: bytes) -> None:
    """Refuses to overwrite anything but an earlier result of the same kind; a log is never overwritten.

    Args:
        path: Path that will be written; a terminal, a pipe or an empty file takes anything.
        mark: Text in the first 4096 bytes of an earlier result, in lower case.

    Raises:
        LogError: The path is taken by something else, or its folder is missing or takes no file.
    """
    if path.exists() and not path.is_file() and not path.is_dir():
        return  # a terminal or a pipe, which would be read for ever
    if path.is_dir() or (path.exists() and path.stat().st_size and mark not in _head(path)):
        found = kind_of(path)
        told = KINDS[found].text if found else "no earlier result of this kind"
        raise LogError(f"{path}: exists and is {told}: not overwritten; choose another name")
    check_place(path)


def check_page(path: Path) -> None:
    """As `check_destination`, for a page, whose name must say so: a browser and a user go by it.

    Raises:
        LogError: Likewise, or the name has another suffix.
    """
    check_destination(path, REPORT_MARK)
    if path.suffix.lower() not in (".html", ".htm"):
        raise LogError(f"{path}: a report is a page; name it {path.stem or 'report'}.html")


def _head(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(4096).lower()


def cases_of(
    paths: Sequence[str], card: str | None = None, progress: Progress | None = None
) -> tuple[tuple[Case, ...], tuple[str, ...]]:
    """Scores every model on every log.

    Args:
        paths: A model file, then logs and further models in any order, told apart by content; a log may be
            `LOG@T0:T1`. Without a log nothing is validated.
        card: Card that reads the logs; None for each model's own.
        progress: Called with a fraction and a text; raising in it cancels.

    Returns:
        The cases, and one line about each training flight that could not be read again, and about what models are told
        differently.

    Raises:
        ModelError: The first path is not a model.
        LogError: A log cannot be read.
    """
    files = [path for k, path in enumerate(paths) if k == 0 or (Path(path).is_file() and is_model_file(path))]
    models = [load(path) for path in files]
    logs = [parse_log(path) for path in paths if path not in files]
    return cases_of_models(files, models, logs, card, progress)


def cases_of_models(
    names: Sequence[str],
    models: Sequence[Model],
    logs: Sequence[LogSpan | Flight],
    card: str | Card | None = None,
    progress: Progress | None = None,
) -> tuple[tuple[Case, ...], tuple[str, ...]]:
    """As `cases_of`, for models in memory; `names` are those of their files or others."""
    cases: list[Case] = []
    notes: list[str] = []
    for number, (name, model) in enumerate(zip(names, models, strict=True)):
        training, left_out = training_flights(model)
        part = part_of_model(progress, number, names)
        scored = validate_logs(model, logs, card, CURVE, part, training) if logs else (UNPROVEN, ())
        cases.append(Case(name, model, training, *scored))
        notes += left_out
    notes += reservations(names, models, [case.validation for case in cases])
    return tuple(cases), tuple(dict.fromkeys(notes))


def part_of_model(progress: Progress | None, number: int, names: Sequence[str]) -> Progress | None:
    """Progress for one of several models, whose name it adds."""
    part = part_of(progress, number, len(names))
    return part and (lambda fraction, text: part(fraction, f"{names[number]} on {text}"))
