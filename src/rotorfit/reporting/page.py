"""Evidence -> one self-contained HTML page: nothing in it is fetched, and everything that is not ours is escaped."""

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from importlib import resources
from typing import Any

from rotorfit.assessment.case import Case
from rotorfit.assessment.evidence import Evidence
from rotorfit.assessment.whiteness import narrows_intervals
from rotorfit.core.finding import Finding, by_gravity
from rotorfit.core.flight_data import Note
from rotorfit.core.frames import AXES
from rotorfit.estimation.methods import label_of
from rotorfit.reporting.charts import horizon_charts, profile_charts, residual_charts
from rotorfit.reporting.drawing import draw_chart, drawn_rows
from rotorfit.reporting.next_steps import next_steps, wanted_chart
from rotorfit.reporting.panels import FlightPanels, Panel, flight_panels, series, speeds_of
from rotorfit.reporting.reproduce import recipe_of
from rotorfit.reporting.side_by_side import coefficients_side_by_side, flights_side_by_side, leads, names_of
from rotorfit.reporting.tables import (
    ahead_rows,
    coefficient_table,
    laws_of,
    mode_rows,
    paired_rows,
    physics_text,
    pooled_rows,
    residual_rows,
    score_rows,
)
from rotorfit.reporting.verdict import USEFUL, USELESS, Verdict, over, verdict_of
from rotorfit.reporting.views import READING, Chart, RowChart, look_of, overlaid
from rotorfit.reporting.words import AXIS, TERMS, slug
from rotorfit.version import __version__

SECTIONS = (
    ("verdict", "Verdict"),
    ("validation", "Measured and predicted"),
    ("delay", "Why this delay"),
    ("horizon", "How far ahead"),
    ("residuals", "Residuals"),
    ("next", "What to fly next"),
    ("coefficients", "Coefficients"),
    ("findings", "Findings"),
    ("repairs", "Repairs"),
    ("reproduce", "Reproduce"),
)
"""Anchor and title, in the order of the page."""


@dataclass(frozen=True)
class Repairs:
    """The notes of one flight."""

    role: str
    path: str
    notes: tuple[Note, ...]


def page(evidences: Sequence[Evidence]) -> str:
    """The whole page, of one model or of several on the same flights.

    Args:
        evidences: Of the models.
    """
    from jinja2 import Environment, FunctionLoader, StrictUndefined
    from markupsafe import Markup

    environment = Environment(
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        loader=FunctionLoader(lambda name: _file(f"templates/{name}")),
    )
    cases = [evidence.case for evidence in evidences]
    names = names_of(cases)
    tested, fitted = flight_panels(evidences, names)
    # Our own files and JSON without "<" may stand in <style> and <script> as they are; everything else is escaped.
    raw = {
        "style": Markup(_file("uplot/uPlot.min.css") + _file("templates/page.css")),
        "plot_library": Markup(_plot_library()),
        "script": Markup(_file("templates/figures.js") + _file("templates/zoom.js")),
        "series": Markup(_json(series(flight) for flight in (*tested, *fitted))),
    }
    verdicts = [_verdict(evidence, tested) for evidence in evidences]
    text = environment.get_template("page.html.j2").render(
        **raw,
        **_charts(evidences, names, verdicts[0].horizon),
        **_proofs(evidences),
        **_numbers(evidences, names),
        version=__version__,
        names=names,
        cases=cases,
        several=len(cases) > 1,
        roles=_roles(cases, names),
        origins=[_origin(case) for case in cases],
        sections=SECTIONS,
        terms=TERMS,
        slug=slug,
        axis_words=AXIS,
        verdicts=verdicts,
        ahead=[ahead_rows(verdict) for verdict in verdicts],
        leads=leads(evidences, verdicts[0].horizon) if len(cases) > 1 else (),
        over=over,
        useful=USEFUL,
        useless=USELESS,
        reading=READING,
        validation_flights=tested,
        training_flights=fitted,
        steps=[next_steps(case, verdict) for case, verdict in zip(cases, verdicts, strict=True)],
    )
    return text.lstrip() + "\n"


def _roles(cases: Sequence[Case], names: Sequence[str]) -> list[tuple[str, str]]:
    """Roles of the lines that predict, and their names, for the legends."""
    if len(cases) > 1:
        return [(look_of(k), name) for k, name in enumerate(names)]
    return [("model", "this model"), *([("paper", "paper's coefficients")] if cases[0].model.method != "paper" else [])]


def _verdict(evidence: Evidence, tested: Sequence[FlightPanels]) -> Verdict:
    model, validation = evidence.case.model, evidence.case.validation
    fresh = [view for view in tested if not view.fitted]
    return verdict_of(model, evidence.scores, validation.paired, validation.residuals, speeds_of(fresh))


def _file(name: str) -> str:
    return resources.files(__name__.rpartition(".")[0]).joinpath(*name.split("/")).read_text(encoding="utf-8")


def _plot_library() -> str:
    """uPlot with its licence in front; its banner, an address, is left out."""
    code = _file("uplot/uPlot.iife.min.js")
    banner, _, rest = code.partition("\n")
    version = banner[banner.find("(") : banner.find(")") + 1]
    return f"/* uPlot {version}\n{_file('uplot/LICENSE')}*/\n{rest}"


def _json(parts: Iterable[Any]) -> str:
    """JSON that may stand inside a script element, whatever text it holds."""
    text = json.dumps(list(parts), separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _origin(case: Case) -> str:
    """What was fitted to what, and tested on what."""
    model = case.model
    fitted = sum(end - start for start, end in (source.span for source in model.flights))
    first = f"Fitted by {label_of(model.method)} ({model.method}) to {_count(len(model.flights))}, {fitted:.0f} s"
    spans = [scores.span for scores in case.validation.flights if not scores.fitted]
    if not spans:
        return f"{first}; not validated."
    return f"{first}; validated on {_count(len(spans))} that were not fitted, {sum(b - a for a, b in spans):.0f} s."


def _count(flights: int) -> str:
    return f"{flights} flight" if flights == 1 else f"{flights} flights"


def _panels(charts: Iterable[Chart | RowChart], width: int = 300) -> list[Panel]:
    return [
        Panel(chart, draw_chart(chart, width, 215) if isinstance(chart, Chart) else drawn_rows(chart, width))
        for chart in charts
    ]


def _charts(evidences: Sequence[Evidence], names: Sequence[str], horizon: float) -> dict[str, Any]:
    """The small charts."""
    cases = [evidence.case for evidence in evidences]
    horizons = [horizon_charts(each.scores, each.case.validation.paired) for each in evidences]
    profiles = [profile_charts(case.model) for case in cases]
    residual = [residual_charts(each.autocorrelation, each.command_correlation) for each in evidences]
    one = len(cases) == 1
    ahead = horizons[0] if one else overlaid(horizons, names)
    wanted = [wanted_chart(case) for case in cases]
    return {
        "horizons": {
            "velocity": _panels(chart for chart in ahead if chart.kind == "horizon_velocity"),
            "position": _panels(chart for chart in ahead if chart.kind == "horizon_position"),
        },
        "profiles": _panels(profiles[0] if one else overlaid(profiles, names)),
        "correlations": [_panels(c for c in every if c.y_label == "autocorrelation") for every in residual],
        "followings": [_panels(c for c in every if c.y_label != "autocorrelation") for every in residual],
        "flight_by_flight": _panels(flights_side_by_side(cases, names, horizon), 420),
        "wanted": [panel for chart in wanted if chart for panel in _panels([chart], 420)],
    }


def _proofs(evidences: Sequence[Evidence]) -> dict[str, Any]:
    """The tables behind the pictures, model by model."""
    cases = [evidence.case for evidence in evidences]
    return {
        "score_rows": [
            [*score_rows(case.validation), *(pooled_rows(each.scores) if len(case.validation.flights) > 1 else [])]
            for case, each in zip(cases, evidences, strict=True)
        ],
        "paired_rows": [paired_rows(case.validation) for case in cases],
        "mode_rows": [mode_rows(case.model) for case in cases],
        "rivals": any(len(axis.modes) > 1 for case in cases for axis in case.model.axes.values()),
        "residual_rows": [residual_rows(each.tested_on, each.tests) for each in evidences],
        "coloured": [
            [a for a in AXES if any(a in axes and narrows_intervals(axes[a]) for axes in each.tests)]
            for each in evidences
        ],
        "tested_on": "validation" if cases[0].flights else "training",
        "heading_measured": any(f.heading == "measured" for case in cases for f in case.validation.flights),
    }


def _numbers(evidences: Sequence[Evidence], names: Sequence[str]) -> dict[str, Any]:
    """Coefficients, findings, repairs, how to reproduce."""
    cases = [evidence.case for evidence in evidences]
    findings: list[tuple[str, Finding]] = []
    for name, case in zip(names, cases, strict=True):
        findings += [(name, finding) for finding in by_gravity(case.model.findings)]
    return {
        "coefficients": [coefficient_table(evidence.coefficients) for evidence in evidences],
        "coefficient_charts": _panels(coefficients_side_by_side(evidences, names)) if len(cases) > 1 else [],
        "physics": [physics_text(evidence) for evidence in evidences],
        "laws": [laws_of(case.model) for case in cases],
        "findings": sorted(findings, key=lambda pair: ("error", "warning", "info").index(pair[1].severity)),
        "repairs": _repairs(cases),
        "recipes": [recipe_of(case.model, case.flights) for case in cases],
    }


def _repairs(cases: Sequence[Case]) -> list[Repairs]:
    """Notes of the training flights, as the models keep them, and of the validation flights; each flight once."""
    every = [
        *(Repairs("training", source.path, source.notes) for case in cases for source in case.model.flights),
        *(Repairs("validation", flight.path, flight.notes) for flight in cases[0].flights),
    ]
    return [repairs for k, repairs in enumerate(every) if repairs not in every[:k]]
