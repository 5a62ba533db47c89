"""Charts with their pictures, and the data for zooming the charts of flights, within the size budget of the page."""

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from rotorfit.assessment.evidence import Evidence, FlightMotion
from rotorfit.core.frames import AXES, Array
from rotorfit.reporting.drawing import COLUMNS, Drawing, draw_chart
from rotorfit.reporting.views import MOST_POINTS, Chart, FlightView, RowChart, flight_view, overlaid

MOST_VALUES = 200_000
"""Largest number of values in all charts that zoom: 1.1 MB of the page."""

MOST_STRETCHES = 7_000
"""Largest number of stretches in all pictures of long flights: a few hundred kB of the page."""

OPEN_FLIGHTS = 6
"""Number of validation flights that are unfolded initially, and have charts of the acceleration."""


@dataclass(frozen=True)
class Panel:
    """A chart with its picture; `number` is its place among the charts of its flight."""

    chart: Chart | RowChart
    drawing: Drawing
    number: int = 0


@dataclass(frozen=True)
class FlightPanels:
    """The charts of one flight.

    Attributes:
        number: Its place among the flights of the page.
        view: The data of the charts.
        velocity: Measured against predicted velocities.
        acceleration: Measured against modelled accelerations.
        open: Whether it is unfolded initially.
        fitted: Whether the model was fitted to it although it is given for validation.
    """

    number: int
    view: FlightView
    velocity: tuple[Panel, ...]
    acceleration: tuple[Panel, ...]
    open: bool
    fitted: bool = False

    @property
    def panels(self) -> tuple[Panel, ...]:
        """All panels, in the order of their numbers."""
        return (*self.velocity, *self.acceleration)


def flight_panels(evidences: Sequence[Evidence], names: Sequence[str]) -> tuple[list[FlightPanels], list[FlightPanels]]:
    """Charts of the validation flights and of the training flights; for several models only the former, overlaid.

    Args:
        evidences: Evidence of the models on the same flights.
        names: Names of the models.
    """
    first = evidences[0]
    fitted = [scores.fitted for scores in first.case.validation.flights] or [False] * len(first.validation)
    every = [(motion, "validation", known) for motion, known in zip(first.validation, fitted, strict=False)]
    every += [(motion, "training", False) for motion in first.training]
    lines = [_values_per_second(motion, len(evidences)) for motion, _, _ in every]
    demand = sum(motion.duration * each for (motion, _, _), each in zip(every, lines, strict=True))
    columns = int(np.clip(MOST_STRETCHES / max(sum(lines), 1), 40, COLUMNS))
    out = []
    for number, (motion, role, known) in enumerate(every):
        points = int(min(MOST_POINTS, max(200, MOST_VALUES * motion.duration / max(demand, 1e-9))))
        view = _view(evidences, names, number, motion, role, points)
        ordered = sorted(view.charts, key=lambda chart: AXES.index(chart.axis))
        velocity = [chart for chart in ordered if chart.kind == "velocity"]
        other = [chart for chart in ordered if chart.kind != "velocity" and number < OPEN_FLIGHTS]
        panels = [Panel(chart, draw_chart(chart, 440, 190, columns), k) for k, chart in enumerate([*velocity, *other])]
        parts = tuple(panels[: len(velocity)]), tuple(panels[len(velocity) :])
        out.append(FlightPanels(number, view, *parts, role == "validation" and number < OPEN_FLIGHTS, known))
    return out[: len(first.validation)], out[len(first.validation) :]


def _values_per_second(motion: FlightMotion, models: int) -> int:
    """Values per second of time that the charts of a flight hold: the number of its lines, with the stamps."""
    each = 4 + ("paper" in motion.velocity) if models == 1 else 1 + models
    return 1 + len(motion.moved) * each


def _view(
    evidences: Sequence[Evidence], names: Sequence[str], number: int, motion: FlightMotion, role: str, points: int
) -> FlightView:
    """The view of a flight for one model, or the velocities that several models predict."""
    if len(evidences) == 1:
        return flight_view(motion, role, points)
    views = [flight_view(evidence.validation[number], role, points) for evidence in evidences]
    velocities = [[chart for chart in view.charts if chart.kind == "velocity"] for view in views]
    charts = overlaid(velocities, names)
    return FlightView(motion.path, role, motion.duration, charts, (), views[0].drawn)


def speeds_of(flights: Sequence[FlightPanels]) -> dict[str, float]:
    """Axis to the 99 % quantile of the measured speeds of all flights [m/s or rad/s]."""
    measured: dict[str, list[Array]] = {}
    for flight in flights:
        for panel in flight.velocity:
            assert isinstance(panel.chart, Chart)
            lines = [line.y for line in panel.chart.lines if line.role == "measured"]
            measured.setdefault(panel.chart.axis, []).extend(lines)
    joined = {axis: np.abs(np.concatenate(lines)) for axis, lines in measured.items() if lines}
    return {axis: float(np.nanpercentile(speed, 99)) for axis, speed in joined.items() if np.isfinite(speed).any()}


def series(flight: FlightPanels) -> dict[str, Any]:
    """The data for zooming the charts of a flight."""
    charts = []
    for panel in flight.panels:
        assert isinstance(panel.chart, Chart)
        lines = [{"name": line.name, "role": line.role, "y": packed(line.y)} for line in panel.chart.lines]
        charts.append({"unit": panel.chart.y_label, "lines": lines})
    stamps = flight.panels[0].chart.x if flight.panels and isinstance(flight.panels[0].chart, Chart) else None
    return {"t": "" if stamps is None else packed(stamps), "charts": charts}


def packed(values: Array) -> str:
    """Numbers as base64 of little-endian float32; what is beyond its range, far outside any chart, as its end.

    Args:
        values: Shape (N,).
    """
    largest = float(np.finfo(np.float32).max)
    values = np.clip(values, -largest, largest)
    return base64.b64encode(values.astype("<f4").tobytes()).decode("ascii")
