"""The wire: nouns as plain JSON for the page. Nothing is computed here that the library does not compute."""

import base64
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from rotorfit.app.comparison import Comparison
from rotorfit.app.web.card_lines import QUANTITIES, card_from_text, parsed
from rotorfit.app.web.workspace import LARGEST_LOG, MOST_LOGS, Running, Session
from rotorfit.assessment.evidence import Evidence
from rotorfit.assessment.summary import summary_of_model
from rotorfit.core.card import Card
from rotorfit.core.errors import CardError
from rotorfit.core.finding import told_together
from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES, Array
from rotorfit.core.limits import meaning_of
from rotorfit.core.log import Log
from rotorfit.core.model import Model
from rotorfit.core.results import HORIZONS
from rotorfit.diagnosis.survey import excitation
from rotorfit.estimation.methods import METHODS
from rotorfit.exports.formats import FORMATS
from rotorfit.flights.columns import clock_of, sample_count, series_of, source_of
from rotorfit.flights.stamps import rate, stamps_of
from rotorfit.reporting.charts import horizon_charts, profile_charts
from rotorfit.reporting.tables import coefficient_table, flight_names, pooled_rows, residual_rows, score_rows
from rotorfit.reporting.verdict import verdict_on
from rotorfit.reporting.views import Chart, FlightView, flight_view
from rotorfit.version import __version__

MOST_POINTS = 6000
"""Largest number of points of a line in a result; the report has more."""

PREDICTOR = "also axes that are not identifiable"
"""The page's words for `--predictor` of an export."""


def session_mapping(session: Session, running: Running | None) -> dict[str, Any]:
    """The session as every page shows it."""
    return {
        **asdict(session),
        "fits": [{**asdict(fit), "changed": session.changed_since(fit)} for fit in session.fits],
        "running": None if running is None else asdict(running),
        "problem": problem_of(session.card),
        "raw": raw_of(session.card),
    }


def constants_mapping() -> dict[str, Any]:
    """Constants of a run of the studio."""
    from rotorfit.core.card import LIMIT_UNITS
    from rotorfit.core.laws import AVERAGED, STRUCTURES
    from rotorfit.files.cards import builtin_cards
    from rotorfit.files.logs.formats import FORMATS as LOG_FORMATS

    return {
        "version": __version__,
        "axes": AXES,
        "quantities": [
            {"section": section, "key": key, "words": words, "units": units}
            for section, key, words, units in QUANTITIES
        ],
        "limits": LIMIT_UNITS,
        "cards": {name: card.name for name, card in builtin_cards().items()},
        "structures": [AVERAGED, "auto", *STRUCTURES],
        "formats": [form.label for form in LOG_FORMATS.values()],
        "exports": {name: form.text for name, form in FORMATS.items()},
        "untold": PREDICTOR,
        "methods": {name: f"{method.label} ({name})" for name, method in METHODS.items()},
        "largest_log": LARGEST_LOG,
        "most_logs": MOST_LOGS,
    }


def problem_of(card: str) -> str | None:
    """What is wrong with a card's text, independently of a log, in one line; None if nothing is."""
    if not card:
        return None
    try:
        card_from_text(card)
    except CardError as error:
        return str(error)
    return None


def raw_of(card: str) -> dict[str, Any] | None:
    """The keys of a card's text; None if it cannot be parsed."""
    try:
        return parsed(card)
    except CardError:
        return None


def log_mapping(log: Log) -> dict[str, Any]:
    """Tables, columns, clocks, what was lost."""
    tables = []
    for table in log.tables.values():
        count = sample_count(table)
        clock = clock_of(log, table, count)
        regular = None if clock is None else asdict(rate(stamps_of(log, clock)))
        columns = [{"name": name, "source": source_of(log, table, name)} for name in series_of(table)]
        tables.append(
            {
                "name": table.name,
                "count": count,
                "clock": None if clock is None else str(clock.source).removeprefix(f"{table.name}:"),
                "rate": regular,
                "columns": columns,
            }
        )
    return {
        "format": log.format,
        "sha256": log.sha256,
        "tables": tables,
        "skipped": log.skipped,
        "notes": log.notes,
        "recording": {key: text for key, text in log.attached.items() if key not in ("plan", "card")},
        "carries_card": "card" in log.attached,
    }


def flight_mapping(flight: Flight) -> dict[str, Any]:
    """A flight as the page shows it."""
    return {
        "span": flight.span,
        "duration": flight.duration,
        "axes": flight.axes,
        "commands_in": {axis: command_unit(flight.card, axis) for axis in flight.axes},
        "poses": int(flight.pose_time.size),
        "commands": int(flight.command_time.size),
        "segments": [(part.start, part.end) for part in flight.segments],
        "notes": [note.text for note in flight.notes],
        "excitation": [asdict(one) for one in excitation(flight)],
    }


def command_unit(card: Card, axis: str) -> str:
    """The unit of an axis' command, for the user."""
    meaning = meaning_of(card, axis)
    if meaning.limit:
        return f"share of the {meaning.limit.replace('_', ' ')} limit"
    units = {"tilt": "rad", "velocity": "m/s", "vertical_speed": "m/s", "yaw_rate": "rad/s"}
    if meaning.asked:
        return units[meaning.asked]
    scale = card.command[axis].scale if axis in card.command else 1.0
    return {1.0: "as sent", -1.0: "as sent, turned"}.get(scale, f"as sent, times {scale:g}")


def result_mapping(evidence: Evidence) -> dict[str, Any]:
    """The result of a fit as the page shows it."""
    model, validation, scores = evidence.case.model, evidence.case.validation, evidence.scores
    verdict = verdict_on(evidence)
    roles = ["training" if flight.fitted else "validation" for flight in validation.flights]
    return {
        "headline": verdict.headline,
        "whole": verdict.whole,
        "horizon": verdict.horizon,
        "summary": summary_of_model(model, validated=any(not flight.fitted for flight in validation.flights)),
        "lights": [asdict(light) for light in verdict.lights],
        "coefficients": [
            {"axis": axis, "rows": [asdict(row) for row in rows]}
            for axis, rows in coefficient_table(evidence.coefficients)
        ],
        "findings": [asdict(finding) for finding in told_together((*validation.misread, *model.findings))],
        "pooled": pooled_rows(scores),
        "scores": score_rows(validation) if len(validation.flights) > 1 else [],
        "residuals": residual_rows(flight_names(validation), validation.residuals),
        "horizons": [chart_mapping(chart) for chart in horizon_charts(scores, validation.paired)],
        "profiles": [chart_mapping(chart) for chart in profile_charts(model)],
        "flights": [
            _view_mapping(flight_view(motion, role, MOST_POINTS))
            for role, motion in (
                *zip(roles, evidence.validation, strict=False),
                *(("training", motion) for motion in evidence.training),
            )
        ],
        "notes": [
            {"path": source.path, "span": source.span, "texts": [note.text for note in source.notes]}
            for source in model.flights
        ],
    }


def _view_mapping(view: FlightView) -> dict[str, Any]:
    """The velocity charts of a flight; the report has those of the acceleration."""
    return {
        "path": view.path,
        "role": view.role,
        "duration": view.duration,
        "missing": view.missing,
        "drawn": view.drawn,
        "charts": [chart_mapping(chart) for chart in view.charts if chart.kind == "velocity"],
    }


def chart_mapping(chart: Chart) -> dict[str, Any]:
    """A chart with its numbers as base64 of little-endian float32."""
    return {
        "kind": chart.kind,
        "axis": chart.axis,
        "title": chart.title,
        "x_label": chart.x_label,
        "y_label": chart.y_label,
        "x": _numbers(chart.x),
        "lines": [{"name": line.name, "role": line.role, "y": _numbers(line.y)} for line in chart.lines],
        "reading": chart.reading,
        "summary": chart.summary,
        "levels": chart.levels,
        "span": None if chart.span is None else [end if np.isfinite(end) else None for end in chart.span],
        "y_range": chart.y_range,
        "y_log": chart.y_log,
    }


def _numbers(values: Array) -> str:
    return base64.b64encode(values.astype("<f4").tobytes()).decode("ascii")


def compared_mapping(
    comparison: Comparison, fits: Sequence[str], models: Sequence[Model], whole: Mapping[str, Any]
) -> dict[str, Any]:
    """Errors of several models and of the baselines, flight by flight, and whether the differences are significant."""
    columns = {
        **{f"fit {fit}": each.flights for fit, each in zip(fits, comparison.validations, strict=True)},
        **{name: comparison.baselines[name] for name in ("paper", "coast", "hold")},
    }
    rows = []
    for number, flight in enumerate(comparison.validations[0].flights):
        for axis in AXES:
            for horizon in (f"{h:g}" for h in HORIZONS):
                cells = [scores[number].axes[axis].horizons.get(horizon) for scores in columns.values()]
                if any(cell is not None and cell.velocity_rmse is not None for cell in cells[: len(fits)]):
                    rows.append(
                        {
                            "path": flight.path,
                            "span": flight.span,
                            "axis": axis,
                            "horizon": float(horizon),
                            "velocity": [None if cell is None else cell.velocity_rmse for cell in cells],
                            "position": [None if cell is None else cell.position_rmse for cell in cells],
                            "fitted": _fitted(number, (each.flights for each in comparison.validations)),
                            "n": max((cell.n for cell in cells if cell is not None), default=0),
                        }
                    )
    named = {f"model {number}": f"fit {fit}" for number, fit in enumerate(fits, 1)}
    paired = [
        {**test, "first": named[test["first"]], "second": named.get(test["second"], test["second"])}
        for test in whole["paired"]
    ]
    alike = [f"fit {fit}" for fit, model in zip(fits, models, strict=True) if model.method == "paper"]
    notes = [re.sub(r"\bmodel \d+\b", lambda found: named[found[0]], note) for note in whole["notes"]]
    return {
        "columns": list(columns),
        "rows": rows,
        "paired": [test for test in paired if test["second"] != "paper" or test["first"] not in alike],
        "notes": [*notes, *(f"{name} against paper is left out: they are the same predictions" for name in alike)],
    }


def _fitted(number: int, models: Iterable[Sequence[Any]]) -> list[bool]:
    """Which models were fitted to a part of this flight, so that their scores there are no validation."""
    return [flights[number].fitted for flights in models]
