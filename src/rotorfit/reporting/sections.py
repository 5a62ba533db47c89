"""The sections of the page: the values of each for its template in `templates/sections`.

A new section is a function `content(contents) -> dict`, a template and one row in `SECTIONS`.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from rotorfit.assessment.case import Case
from rotorfit.assessment.evidence import Evidence
from rotorfit.assessment.whiteness import narrows_intervals
from rotorfit.core.finding import Finding, by_gravity, told_together
from rotorfit.core.flight_data import Note
from rotorfit.core.frames import AXES
from rotorfit.core.results import pool_lines
from rotorfit.reporting.charts import horizon_charts, profile_charts, residual_charts
from rotorfit.reporting.drawing import draw_chart, drawn_rows
from rotorfit.reporting.frequency import response_charts
from rotorfit.reporting.next_steps import ROOM, next_steps, wanted_chart
from rotorfit.reporting.panels import FlightPanels, Panel
from rotorfit.reporting.reproduce import recipe_of
from rotorfit.reporting.side_by_side import coefficients_side_by_side, flights_side_by_side, leads
from rotorfit.reporting.tables import (
    ahead_rows,
    coefficient_table,
    flight_names,
    laws_of,
    mode_rows,
    paired_rows,
    physics_text,
    pooled_rows,
    residual_rows,
    score_rows,
)
from rotorfit.reporting.verdict import USEFUL, USELESS, Verdict, over
from rotorfit.reporting.views import READING, Chart, RowChart, overlaid


@dataclass(frozen=True)
class Contents:
    """The input of the sections.

    Attributes:
        evidences: Evidence of one model, or of several on the same flights.
        names: Names of the models.
        verdicts: Verdicts on the models.
        tested: Charts of the validation flights.
        fitted: Charts of the training flights.
    """

    evidences: tuple[Evidence, ...]
    names: tuple[str, ...]
    verdicts: tuple[Verdict, ...]
    tested: tuple[FlightPanels, ...]
    fitted: tuple[FlightPanels, ...]

    @property
    def cases(self) -> tuple[Case, ...]:
        """The models with their flights and validations."""
        return tuple(evidence.case for evidence in self.evidences)

    @property
    def several(self) -> bool:
        """Whether models are compared."""
        return len(self.evidences) > 1


@dataclass(frozen=True)
class Section:
    """A section of the page.

    Attributes:
        title: Its title in the list of sections.
        content: Function that gives the values for its template, `templates/sections/ANCHOR.html.j2`.
    """

    title: str
    content: Callable[[Contents], dict[str, Any]]


@dataclass(frozen=True)
class Repairs:
    """The notes of one flight."""

    role: str
    path: str
    notes: tuple[Note, ...]


def _panels(charts: Iterable[Chart | RowChart], width: int = 300) -> list[Panel]:
    return [
        Panel(chart, draw_chart(chart, width, 215) if isinstance(chart, Chart) else drawn_rows(chart, width))
        for chart in charts
    ]


def _verdict(page: Contents) -> dict[str, Any]:
    return {
        "verdicts": page.verdicts,
        "ahead": [ahead_rows(verdict) for verdict in page.verdicts],
        "leads": leads(page.evidences, page.verdicts[0].horizon) if page.several else (),
        "over": over,
        "useful": USEFUL,
        "useless": USELESS,
    }


def _validation(page: Contents) -> dict[str, Any]:
    return {
        "validation_flights": page.tested,
        "training_flights": page.fitted,
        "reading": READING,
        "flight_by_flight": _panels(flights_side_by_side(page.cases, page.names, page.verdicts[0].horizon), 420),
    }


def _delay(page: Contents) -> dict[str, Any]:
    profiles = [profile_charts(case.model) for case in page.cases]
    return {
        "profiles": _panels(overlaid(profiles, page.names) if page.several else profiles[0]),
        "mode_rows": [mode_rows(case.model) for case in page.cases],
        "rivals": any(len(axis.modes) > 1 for case in page.cases for axis in case.model.axes.values()),
    }


def _horizon(page: Contents) -> dict[str, Any]:
    every = [horizon_charts(each.scores, each.case.validation.paired) for each in page.evidences]
    charts = overlaid(every, page.names) if page.several else every[0]
    validations = [case.validation for case in page.cases]
    return {
        "horizons": {
            what: _panels(chart for chart in charts if chart.kind == f"horizon_{what}")
            for what in ("velocity", "position")
        },
        "score_rows": [
            [*score_rows(case.validation), *(pooled_rows(each.scores) if len(case.validation.flights) > 1 else [])]
            for case, each in zip(page.cases, page.evidences, strict=True)
        ],
        "paired_rows": [paired_rows(case.validation) for case in page.cases],
        "pooled": list(dict.fromkeys(line for one in validations for line in pool_lines(one.flights, one.paired))),
        "heading_measured": any(f.heading == "measured" for case in page.cases for f in case.validation.flights),
    }


def _response(page: Contents) -> dict[str, Any]:
    return {
        "responses": [_panels(response_charts(evidence.responses)) for evidence in page.evidences],
        "tested_on": "validation" if page.cases[0].flights else "training",
    }


def _residuals(page: Contents) -> dict[str, Any]:
    charts = [residual_charts(each.autocorrelation, each.command_correlation) for each in page.evidences]
    return {
        "correlations": [_panels(c for c in every if c.y_label == "autocorrelation") for every in charts],
        "followings": [_panels(c for c in every if c.y_label != "autocorrelation") for every in charts],
        "residual_rows": [
            residual_rows(flight_names(each.case.validation) if each.case.flights else each.tested_on, each.tests)
            for each in page.evidences
        ],
        "tested_on": "validation" if page.cases[0].flights else "training",
    }


def _next(page: Contents) -> dict[str, Any]:
    wanted = [wanted_chart(case) for case in page.cases]
    steps = [next_steps(case, verdict) for case, verdict in zip(page.cases, page.verdicts, strict=True)]
    return {
        "steps": steps,
        "room_named": any(ROOM in step.command for mine in steps for step in mine),
        "wanted": [panel for chart in wanted if chart for panel in _panels([chart], 420)],
    }


def _coefficients(page: Contents) -> dict[str, Any]:
    return {
        "coefficients": [coefficient_table(evidence.coefficients) for evidence in page.evidences],
        "coefficient_charts": _panels(coefficients_side_by_side(page.evidences, page.names)) if page.several else [],
        "physics": [physics_text(evidence) for evidence in page.evidences],
        "laws": [laws_of(case.model) for case in page.cases],
        "coloured": [
            [a for a in AXES if any(a in axes and narrows_intervals(axes[a]) for axes in each.tests)]
            for each in page.evidences
        ],
    }


def _findings(page: Contents) -> dict[str, Any]:
    findings: list[tuple[str, Finding]] = []
    for name, case in zip(page.names, page.cases, strict=True):
        told = (*case.validation.misread, *by_gravity(case.model.findings))
        findings += [(name, finding) for finding in told_together(told)]
    return {"findings": sorted(findings, key=lambda pair: ("error", "warning", "info").index(pair[1].severity))}


def _repairs(page: Contents) -> dict[str, Any]:
    """Notes of the training flights, as the models keep them, and of the validation flights; each flight once."""
    every = [
        *(Repairs("training", source.path, source.notes) for case in page.cases for source in case.model.flights),
        *(Repairs("validation", flight.path, flight.notes) for flight in page.cases[0].flights),
    ]
    return {"repairs": [repairs for k, repairs in enumerate(every) if repairs not in every[:k]]}


def _reproduce(page: Contents) -> dict[str, Any]:
    return {"recipes": [recipe_of(case.model, case.flights) for case in page.cases]}


SECTIONS: Mapping[str, Section] = {
    "verdict": Section("Verdict", _verdict),
    "validation": Section("Measured and predicted", _validation),
    "delay": Section("Why this delay", _delay),
    "horizon": Section("How far ahead", _horizon),
    "response": Section("Frequency response", _response),
    "residuals": Section("Residuals", _residuals),
    "next": Section("What to fly next", _next),
    "coefficients": Section("Coefficients", _coefficients),
    "findings": Section("Findings", _findings),
    "repairs": Section("Repairs", _repairs),
    "reproduce": Section("Reproduce", _reproduce),
}
"""Anchor to section, in the order of the page."""
