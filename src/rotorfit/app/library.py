"""The public functions from a log to a validated model: those of the command line, with values in place of files.

They take paths, flights, models and fits, and return nouns of `core` and results of the packages. No logic is here:
each function calls what the verb of the same name calls, and imports it on first use.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Sequence
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rotorfit.app.inputs import (
    CardLike,
    FilePath,
    Flights,
    ModelLike,
    as_axes,
    as_card,
    as_horizons,
    as_logs,
    as_model,
    as_models,
    as_number,
    as_span,
    as_word,
    named,
    path_text,
)
from rotorfit.core.errors import RotorfitError
from rotorfit.core.flight_data import Flight
from rotorfit.core.flight_plan import Plan
from rotorfit.core.frames import AXES
from rotorfit.core.laws import AVERAGED
from rotorfit.core.log import Log
from rotorfit.core.model import Model
from rotorfit.core.progress import Progress
from rotorfit.core.results import Fit, Validation

if TYPE_CHECKING:
    from rotorfit.app.comparison import Comparison
    from rotorfit.assessment.method_comparison import Ladder
    from rotorfit.core.tracked import Track, Tracked
    from rotorfit.diagnosis.survey import Survey


def flight(
    log: Log | FilePath, card: CardLike | None = None, span: tuple[float | None, float | None] = (None, None)
) -> Flight:
    """Makes a flight from a log: commands and poses on one clock in SI units, repaired, with findings about the data.

    Args:
        log: A log, or its path: `LOG`, `LOG@T0:T1`, or `A+B` for two files of one flight.
        card: What each column means; None for the log's own card, or the built-in card that fits.
        span: Start and end [s], from the start of the common window of commands and poses; None for its ends.

    Returns:
        The flight; every repair is a note in it.

    Raises:
        TypeError: An argument has the wrong type.
        LogError: The log cannot be read.
        CardError: The card is wrong, does not fit the log, or none fits.
        FlightError: The log holds no usable flight.
    """
    from rotorfit.app import workflows
    from rotorfit.files.log_span import LogSpan, parse_log

    part = as_span(span)
    if isinstance(log, Log):
        return workflows.load_flight(LogSpan(str(log.path), part), as_card(card), log)
    return workflows.load_flight(parse_log(path_text(log), part), as_card(card))


flight_from_log = flight
"""Its name in version 0.1."""


def diagnose(
    log: Log | FilePath, card: CardLike | None = None, span: tuple[float | None, float | None] = (None, None)
) -> Survey:
    """Surveys a log before any fit: tables, rates, gaps, which card fits, what each command excites, findings.

    Args:
        log: A log, or its path as in `flight`.
        card: As in `flight`.
        span: As in `flight`.

    Returns:
        The survey; if no card fits or there is no usable flight, its `problem` says why.

    Raises:
        TypeError: An argument has the wrong type.
        LogError: The log cannot be read.
        CardError: The given card is wrong, or does not fit.
    """
    from rotorfit.diagnosis.survey import survey
    from rotorfit.files.log_span import parse_log
    from rotorfit.files.logs import read

    chosen, part = as_card(card), as_span(span)
    if isinstance(log, Log):
        return survey(log, chosen, part)
    asked = parse_log(path_text(log), part)
    return survey(read(asked.path), chosen, asked.span)


def fit(
    flights: Flights,
    method: str = "ml",
    axes: str | Sequence[str] = AXES,
    *,
    card: CardLike | None = None,
    structure: str = AVERAGED,
    uncertainty: bool = False,
    prior: bool = False,
    leave_one_out: bool = False,
    progress: Progress | None = None,
) -> Fit:
    """Estimates the coefficients from one or several flights, as `rotorfit fit` does.

    Args:
        flights: Paths of logs, flights, or a sequence of them; they are fitted together.
        method: `ml`, `robust`, `paper`, `svf`, `weak`, `iv` or `oe`.
        axes: Axes to fit: a sequence, or names separated by commas.
        card: Card for the logs that are read; None for each log's own card, or the built-in card that fits.
        structure: Name of the law of every axis, `averaged`, or `auto` to select the law of each axis by the data.
        uncertainty: Add the accuracy table.
        prior: Use the priors of the card.
        leave_one_out: Also score each flight with a model fitted to the others.
        progress: Called with a fraction and a text; raising in it cancels.

    Returns:
        The fit. Its `model` has the coefficients, intervals, profiles and findings; what is not identifiable has a
        status, never a number.

    Raises:
        TypeError: `flights` are neither paths nor flights, or another argument has the wrong type.
        LogError, CardError, FlightError: As in `flight`; there is no flight; the cards differ.
        ModelError: There is no such structure, or the method does not support it.
        RotorfitError: There is no such method or axis, or the method does not have an option.
    """
    from rotorfit.app import workflows
    from rotorfit.assessment.leave_one_out import require_two
    from rotorfit.estimation.methods import METHODS, maximises_likelihood

    if as_word(method, "method") not in METHODS:
        raise RotorfitError(f"no such method: {method!r}; methods are {', '.join(METHODS)}")
    if uncertainty and not maximises_likelihood(method):
        raise RotorfitError(f"the accuracy table is of the likelihood: {method} has its own standard errors")
    logs, wanted, chosen, law = as_logs(flights), as_axes(axes), as_card(card), as_word(structure, "structure")
    if leave_one_out:
        require_two(len(logs))
    known: Any = method
    result = workflows.fit_logs(logs, chosen, known, wanted, progress, law, uncertainty, prior)
    return workflows.leave_one_out_logs(result, wanted, progress, law)[0] if leave_one_out else result


def track(
    flight: Flight | Log | FilePath,
    card: CardLike | None = None,
    *,
    structure: str = AVERAGED,
    false_alarms_per_hour: float = 0.1,
    after: ModelLike | None = None,
    progress: Progress | None = None,
) -> Track:
    """Tracks the model through a recorded flight as if it were live, as `rotorfit track` does.

    Args:
        flight: A flight, a log, or the path of a log as in `flight`; each second sees only what had arrived by then.
        card: Card for a log; None for its own card, or the built-in card that fits.
        structure: As in `fit`.
        false_alarms_per_hour: Bound on the expected number of false alarms [1/h], above 0 and at most 60.
        after: The model of an earlier flight: reported until this flight tells as much, and compared with it.
        progress: Called with a fraction and a text; raising in it cancels.

    Returns:
        What was known at each second, the alarms, and the regimes of the vehicle, each with a model.

    Raises:
        TypeError: `flight` is neither a path, nor a log, nor a flight, or another argument has the wrong type.
        LogError, CardError, FlightError: As in `flight`; the commands of the earlier model have another meaning.
        ModelError: There is no such structure, or the earlier model cannot be used.
        RotorfitError: `false_alarms_per_hour` is out of range.
    """
    from rotorfit.core.laws import structure_named
    from rotorfit.tracking.earlier import earlier_of
    from rotorfit.tracking.replayed import tracked

    law = as_word(structure, "structure")
    if law not in (AVERAGED, "auto"):
        structure_named(law)
    most = as_number(false_alarms_per_hour, "the number of false alarms an hour")
    if not 0 < most <= 60:
        raise RotorfitError(f"false alarms an hour are above 0 and at most 60, not {most:g}")
    if not isinstance(flight, Flight | Log | str | PathLike):
        raise TypeError(f"expected a flight, a log or the path of a log, got {named(flight)}")
    earlier = None if after is None else earlier_of(after)
    chosen = as_card(card)
    given = flight if isinstance(flight, Flight) else flight_from_log(flight, chosen)
    end = given.segments[-1].end

    def report(state: Tracked) -> None:
        if progress:
            progress(min(state.time / end, 1.0), f"tracked to {state.time:.0f} s")

    return tracked(given, law, most, report, earlier)


def ladder(
    flights: Flights,
    axes: str | Sequence[str] = AXES,
    *,
    card: CardLike | None = None,
    progress: Progress | None = None,
) -> Ladder:
    """Fits by every method, side by side, and tests each against the likelihood.

    Args:
        flights: As in `fit`.
        axes: As in `fit`.
        card: As in `fit`.
        progress: Called with a fraction and a text; raising in it cancels.

    Returns:
        Coefficients and prediction errors of every method, axis by axis.

    Raises:
        TypeError: `flights` are neither paths nor flights, or another argument has the wrong type.
        LogError, CardError, FlightError: As in `fit`.
        RotorfitError: There is no such axis.
    """
    from rotorfit.app import workflows

    return workflows.ladder_logs(as_logs(flights), as_card(card), as_axes(axes), progress)


def validate(
    model: ModelLike,
    flights: Flights,
    horizons: Sequence[float] | None = None,
    *,
    card: CardLike | None = None,
    progress: Progress | None = None,
) -> Validation:
    """Scores a model on flights that it was not fitted to.

    Args:
        model: A model, a fit, or a model file.
        flights: Paths of logs, flights, or a sequence of them.
        horizons: How far to predict [s]; None for 0.5, 1, 2 and 5.
        card: Card for the logs that are read; None for the log's own card, else the model's.
        progress: Called with a fraction and a text; raising in it cancels.

    Returns:
        Prediction errors of the model and of two baselines, paired tests, tests of the innovations, findings.

    Raises:
        TypeError: `flights` are neither paths nor flights, `model` is not a model, or `horizons` are not numbers.
        LogError, CardError: A log cannot be read, or its card differs from the model's.
        FlightError: No flight is given, or a horizon is not positive.
        ModelError: The model file cannot be used.
    """
    from rotorfit.app import workflows

    far = as_horizons(horizons)
    return workflows.validate_logs(as_model(model), as_logs(flights), as_card(card), far, progress)[0]


def compare(
    models: Iterable[ModelLike],
    flights: Flights,
    horizons: Sequence[float] | None = None,
    *,
    card: CardLike | None = None,
    progress: Progress | None = None,
) -> Comparison:
    """Scores several models on the same flights, and tests them in pairs.

    Args:
        models: Models, fits or model files.
        flights: As in `validate`.
        horizons: As in `validate`.
        card: As in `validate`.
        progress: Called with a fraction and a text; raising in it cancels.

    Returns:
        The validation of each model, and paired tests of each against the first model and against its own baselines.

    Raises:
        TypeError: `flights` are neither paths nor flights, or `models` are not a sequence of models.
        LogError, CardError, FlightError, ModelError: As in `validate`; no model is given.
    """
    from rotorfit.app.comparison import compare_models

    far = as_horizons(horizons)
    names, known = as_models(models)
    return compare_models(names, known, as_logs(flights), as_card(card), far, progress)


def report(
    models: ModelLike | Iterable[ModelLike],
    flights: Flights = (),
    path: FilePath = "report.html",
    *,
    card: CardLike | None = None,
    figures: FilePath | None = None,
    progress: Progress | None = None,
) -> Path:
    """Writes a self-contained page about a model and its validation, or about several side by side.

    Args:
        models: A model, a fit, a model file, or a sequence of them.
        flights: As in `validate`; without any, nothing is validated.
        path: Path of the page. An earlier report is kept with a tilde appended to its name; any other file is refused.
        card: As in `validate`.
        figures: Folder for figures of one model as PNG and PDF; None for none.
        progress: Called with a fraction and a text; raising in it cancels.

    Returns:
        The path of the page.

    Raises:
        TypeError: `flights` are neither paths nor flights, or `models` are not models.
        LogError: The path is taken by something else or has another suffix than .html, or a log cannot be read.
        CardError, FlightError, ModelError: As in `validate`.
        RotorfitError: Figures are requested for several models.
    """
    from rotorfit.app import workflows
    from rotorfit.assessment.evidence import evidence_of
    from rotorfit.reporting import write_figures, write_report

    page = Path(path)
    names, known = as_models([models] if isinstance(models, Model | Fit | str | PathLike) else models)
    if figures is not None and len(known) > 1:
        raise RotorfitError("figures are drawn of one model: give one, or leave them out")
    workflows.check_page(page)
    cases, left_out = workflows.cases_of_models(names, known, as_logs(flights), as_card(card), progress)
    for note in left_out:
        warnings.warn(note, stacklevel=2)
    evidences = evidence_of(cases)
    write_report(evidences, page)
    if figures is not None:
        write_figures(evidences[0], Path(figures))
    return page


def save(result: Model | Fit | Plan, path: FilePath) -> None:
    """Writes a model file (JSON) or a plan file (TOML).

    Args:
        result: A model, the fit that holds it, or a plan.
        path: Path of the file. An existing file is kept with a tilde appended to its name; a plan replaces only an
            unedited plan.

    Raises:
        TypeError: `result` is neither a model nor a plan.
        PlanError: The path of a plan is taken by something else, such as an edited plan, or its folder does not exist.
    """
    from rotorfit.files import models, plans

    if isinstance(result, Plan):
        plans.check_plan_destination(Path(path))
        plans.save_plan(result, path_text(path))
        return
    if not isinstance(result, Model | Fit):
        raise TypeError(f"a model, a fit or a plan can be saved, not {named(result)}")
    kept = models.save(model := as_model(result), path_text(path))
    if lost := models.lost_axes(kept, model):
        warnings.warn(f"{path}: the earlier model knew {', '.join(lost)}, too; it is kept as {kept}", stacklevel=2)
