"""Views -> one self-contained HTML page: nothing in it is fetched, and everything that is not ours is escaped."""

import base64
import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from importlib import resources
from itertools import groupby
from typing import Any

import numpy as np

from rotorfit import __version__
from rotorfit.evidence import (
    SPEED,
    CoefficientRow,
    Score,
    coefficient_rows,
    horizon_charts,
    profile_charts,
    residual_charts,
    scores_of,
)
from rotorfit.flight import Flight, Note
from rotorfit.frames import AXES, Array
from rotorfit.model import STRUCTURE, Model, with_findings
from rotorfit.report.drawing import Drawing, drawn
from rotorfit.report.physics_table import physics_text
from rotorfit.report.reproduce import recipe_of
from rotorfit.report.rows import paired_rows, pooled_rows, residual_rows, score_rows
from rotorfit.report.verdict import USEFUL, USELESS, verdict_of
from rotorfit.report.words import AXIS, TERMS, rounded, term_of
from rotorfit.structure import structure_named
from rotorfit.validation import Validation, residual_tests_of_flight
from rotorfit.views import MOST_POINTS, READING, Chart, FlightView, flight_view, moved_axes
from rotorfit.whiteness import narrows_intervals

MOST_VALUES = 230_000
"""Numbers that all charts that zoom may hold together: 1.2 MB of the page."""

OPEN_FLIGHTS = 6
"""Validation flights that are unfolded from the start."""

SECTIONS = (
    ("verdict", "Verdict"),
    ("coefficients", "Coefficients"),
    ("validation", "Measured and modelled"),
    ("horizon", "How far ahead"),
    ("delay", "Delay"),
    ("residuals", "Residuals"),
    ("findings", "Findings"),
    ("repairs", "Repairs"),
    ("reproduce", "Reproduce"),
)
"""Anchor and title, in the order of the page."""

METHODS = {
    "ml": "grey-box likelihood with delay (ml)",
    "svf": "least squares behind a state-variable filter, with delay (svf)",
    "weak": "least squares on the weak form, with delay (weak)",
    "iv": "refined instrumental variables, with delay (iv)",
    "oe": "output error, with delay (oe)",
    "robust": "grey-box likelihood with delay, outlying poses left out (robust)",
    "paper": "the paper's linear regression, without delay (paper)",
}


@dataclass(frozen=True)
class Panel:
    """A chart with its picture; `number` is its place among the charts of its flight."""

    chart: Chart
    drawing: Drawing
    number: int = 0


@dataclass(frozen=True)
class FlightPanels:
    """The charts of one flight; `number` is its place among the flights of the page."""

    number: int
    view: FlightView
    panels: tuple[Panel, ...]
    open: bool


@dataclass(frozen=True)
class Bar:
    """Places of an interval, its estimate and the paper's value along a bar of 100."""

    low: float
    high: float
    value: float | None
    paper: float | None


@dataclass(frozen=True)
class RowText:
    """A row of the table of coefficients, ready to print; `kind` is `ok`, `missing`, `bad` or `combination`."""

    term: str
    symbol: str
    value: str
    stderr: str
    interval: str
    unit: str
    status: str
    paper: str
    kind: str
    bar: Bar | None
    told: str


@dataclass(frozen=True)
class Repairs:
    """The notes of one flight."""

    role: str
    path: str
    notes: tuple[Note, ...]


def page(model: Model, training: Sequence[Flight], validation: Validation, flights: Sequence[Flight]) -> str:
    """The whole page.

    Args:
        model: With its findings.
        training: The flights that it was fitted to, as far as they are at hand.
        validation: Its scores.
        flights: The flights of the scores, in their order.
    """
    from jinja2 import Environment, StrictUndefined
    from markupsafe import Markup

    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True)
    model = with_findings(model, (*model.findings, *validation.findings))
    tested, fitted = _flights(model, flights, training)
    # Our own files and JSON without "<" may stand in <style> and <script> as they are; everything else is escaped.
    raw = {
        "style": Markup(_file("uplot/uPlot.min.css") + _file("templates/page.css")),
        "plot_library": Markup(_plot_library()),
        "script": Markup(_file("templates/page.js")),
        "series": Markup(_json(_series(view) for view in (*tested, *fitted))),
    }
    scores = scores_of(validation, flights)
    text = environment.from_string(_file("templates/page.html.j2")).render(
        **raw,
        **_evidence(model, training, validation, flights, scores),
        version=__version__,
        model=model,
        origin=_origin(model, flights),
        sections=SECTIONS,
        terms=TERMS,
        axis_words=AXIS,
        verdict=verdict_of(model, scores),
        useful=USEFUL,
        useless=USELESS,
        coefficients=_coefficients(model),
        physics=physics_text(model),
        laws=_laws(model),
        reading=READING,
        validation_flights=tested,
        training_flights=fitted,
        heading_measured=any(flight.heading == "measured" for flight in validation.flights),
        findings=sorted(model.findings, key=lambda f: ("error", "warning", "info").index(f.severity)),
        repairs=_repairs(model, flights),
        recipe=recipe_of(model, flights),
    )
    return text.lstrip() + "\n"


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


def _origin(model: Model, flights: Sequence[Flight]) -> str:
    """What was fitted to what, and tested on what."""
    fitted = sum(end - start for start, end in (source.span for source in model.flights))
    tested = sum(flight.duration for flight in flights)
    first = f"Fitted by {METHODS.get(model.method, model.method)} to {_count(len(model.flights))}, {fitted:.0f} s"
    return f"{first}; validated on {_count(len(flights))}, {tested:.0f} s." if flights else f"{first}; not validated."


def _count(flights: int) -> str:
    return f"{flights} flight" if flights == 1 else f"{flights} flights"


def _flights(
    model: Model, flights: Sequence[Flight], training: Sequence[Flight]
) -> tuple[list[FlightPanels], list[FlightPanels]]:
    """Charts of the validation and of the training flights, all within the budget of the page."""
    every = [(flight, "validation") for flight in flights] + [(flight, "training") for flight in training]
    with_paper = model.method != "paper"
    demand = sum(
        f.duration * (1 + len(moved_axes(f)) * (4 + (with_paper and role == "validation"))) for f, role in every
    )
    out = []
    for number, (flight, role) in enumerate(every):
        points = int(min(MOST_POINTS, max(200, MOST_VALUES * flight.duration / max(demand, 1e-9))))
        view = flight_view(model, flight, role, points, with_paper and role == "validation")
        ordered = sorted(view.charts, key=lambda chart: AXES.index(chart.axis))
        panels = tuple(Panel(chart, drawn(chart, 560, 200), k) for k, chart in enumerate(ordered))
        out.append(FlightPanels(number, view, panels, role == "validation" and number < OPEN_FLIGHTS))
    return out[: len(flights)], out[len(flights) :]


def _series(flight: FlightPanels) -> dict[str, Any]:
    """What the charts of a flight need to zoom."""
    charts = [
        {"lines": [{"name": line.name, "role": line.role, "y": _packed(line.y)} for line in panel.chart.lines]}
        for panel in flight.panels
    ]
    return {"t": _packed(flight.panels[0].chart.x) if flight.panels else "", "charts": charts}


def _packed(values: Array) -> str:
    """Numbers as base64 of little-endian float32."""
    return base64.b64encode(values.astype("<f4").tobytes()).decode("ascii")


def _evidence(
    model: Model,
    training: Sequence[Flight],
    validation: Validation,
    flights: Sequence[Flight],
    scores: Sequence[Score],
) -> dict[str, Any]:
    """Small charts and their tables."""

    def panels(charts: Iterable[Chart]) -> list[Panel]:
        return [Panel(chart, drawn(chart, 280, 205)) for chart in charts]

    horizons = horizon_charts(scores, validation.paired)
    shown = flights or training
    residual = panels(residual_charts(model, shown))
    tests = validation.residuals if flights else tuple(residual_tests_of_flight(model, flight) for flight in training)
    return {
        "horizons": {
            "velocity": panels(chart for chart in horizons if chart.kind == "horizon_velocity"),
            "position": panels(chart for chart in horizons if chart.kind == "horizon_position"),
            "reading": horizons[0].reading if horizons else "",
        },
        "score_rows": score_rows(validation),
        "pooled_rows": pooled_rows(scores) if len(validation.flights) > 1 else [],
        "paired_rows": paired_rows(validation),
        "profiles": panels(profile_charts(model)),
        "modes": _mode_rows(model),
        "rivals": any(len(model.axes[axis].modes) > 1 for axis in AXES),
        "correlations": [panel for panel in residual if panel.chart.y_label == "autocorrelation"],
        "followings": [panel for panel in residual if panel.chart.y_label != "autocorrelation"],
        "residual_rows": residual_rows([flight.path for flight in shown], tests),
        "coloured": [a for a in AXES if any(a in axes and narrows_intervals(axes[a]) for axes in tests)],
        "correlations_of": "validation" if flights else "training",
    }


def _mode_rows(model: Model) -> list[list[str]]:
    """The optima of every axis that has a model, the chosen one first."""
    rows = []
    for name in AXES:
        axis = model.axes[name]
        base = next((mode.log_likelihood for mode in axis.modes if mode.chosen), 0.0)
        unit, factor = SPEED[name]
        for mode in axis.modes if axis.predictor else ():
            error = "—" if mode.prediction is None else f"{factor * mode.prediction:.3g} {unit}"
            likelihood = f"{mode.log_likelihood - base:+.1f}".replace("-", "−")
            word = "chosen" if mode.chosen else "rejected"
            rows.append(
                [
                    name,
                    word,
                    f"{mode.delay:.3f}",
                    f"{mode.damping:.3g}",
                    f"{mode.input:.3g}",
                    likelihood,
                    error,
                    str(mode.starts),
                ]
            )
    return rows


def _coefficients(model: Model) -> list[tuple[str, list[RowText]]]:
    """Rows of the table of coefficients, axis by axis."""
    rows = groupby(coefficient_rows(model), key=lambda row: row.axis)
    return [(axis, [_row_text(row) for row in group]) for axis, group in rows]


def _laws(model: Model) -> list[tuple[str, str]]:
    """Axes that have another structure than the default, and its law."""
    known = {name: axis.structure for name, axis in model.axes.items() if axis.structure != STRUCTURE}
    return [(name, structure_named(structure).law) for name, structure in known.items()]


def _row_text(row: CoefficientRow) -> RowText:
    width = None if row.low is None or row.high is None else (row.high - row.low) / 4
    scale = row.stderr or width
    ends = [rounded(end, scale) if end is not None else "open" for end in (row.low, row.high)]
    known = row.low is not None or row.high is not None
    interval = f"{ends[0]} to {ends[1]}" if known else "—"
    kind = {"ok": "ok", "diverged": "bad"}.get(row.status, "missing")
    if row.name in ("steady_gain", "total_lag"):
        kind = "combination"
    paper = rounded(row.paper, scale)
    told = f"{term_of(row.name)}: estimate {rounded(row.value, scale)}, 95 % interval {interval}, paper's {paper}"
    return RowText(
        term=term_of(row.name),
        symbol=row.symbol,
        value=rounded(row.value, scale),
        stderr=rounded(row.stderr, row.stderr),
        interval=interval,
        unit=row.unit,
        status=row.status.replace("_", " "),
        paper=paper,
        kind=kind,
        bar=_bar(row),
        told=told,
    )


def _bar(row: CoefficientRow) -> Bar | None:
    """Where the interval lies; an open end runs to the border. The paper's value sits at the border if beyond it."""
    if row.low is None and row.high is None:
        return None
    finite = [end for end in (row.low, row.high, row.value) if end is not None]
    low, high = min(finite), max(finite)
    pad = 1.2 * (high - low) or abs(high) or 1.0
    if row.paper is not None:  # as far as twice the interval's width
        low, high = min(low, max(row.paper, low - 2 * pad)), max(high, min(row.paper, high + 2 * pad))
    low, high = low - 0.15 * pad, high + 0.15 * pad

    def place(value: float) -> float:
        return round(float(np.clip(100 * (value - low) / (high - low), 3, 97)), 1)

    return Bar(
        3.0 if row.low is None else place(row.low),
        97.0 if row.high is None else place(row.high),
        None if row.value is None else place(row.value),
        None if row.paper is None else place(row.paper),
    )


def _repairs(model: Model, flights: Sequence[Flight]) -> list[Repairs]:
    """Notes of the training flights, as the model keeps them, and of the validation flights."""
    return [
        *(Repairs("training", source.path, source.notes) for source in model.flights),
        *(Repairs("validation", flight.path, flight.notes) for flight in flights),
    ]
