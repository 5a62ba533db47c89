"""Size and load time of the report and of pages of plotly and bokeh with the same charts, in headless Chromium.

    python bench/bench_report.py [RUNS] [--chromium PATH] [-o FILE]

The content is one flight of ten minutes, poses at 120 Hz, all four axes (set B, seed 2), scored by a model that was
fitted to another of 60 s (seed 1): measured against predicted velocity and acceleration of each axis, errors over the
horizon, delay profiles, correlations of the residuals. All three pages get the same series, as reduced for drawing, as
binary float32, and contain their plotting library. The report contains all its text and tables in addition, and a
static picture of every chart for readers without scripts; it builds an interactive chart when the chart comes near the
window, the other pages build all charts at once.

RUNS (default 15) loads of each page, in turn, each in a fresh browser context: time to the first contentful paint, to
the load event, work of the main thread until 2 s after that, and the same after the page was scrolled to its end, when
every chart is built; medians and quartiles. Needs the extra `bench` and a Chromium. Results: bench/report.json.
"""

import argparse
import json
import shutil
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from bokeh.embed import file_html
from bokeh.layouts import column
from bokeh.plotting import figure
from bokeh.resources import INLINE
from playwright.sync_api import Browser, CDPSession, sync_playwright
from plotly import graph_objects

from rotorfit.assessment.case import Case
from rotorfit.assessment.evidence import evidence_of
from rotorfit.assessment.validation import validate
from rotorfit.core.flight_data import Flight
from rotorfit.core.results import CURVE
from rotorfit.estimation.fitting import fit, with_delay_profiles
from rotorfit.files.cards import load_card
from rotorfit.flights.assemble import flight_from_log
from rotorfit.planning.signals import two_sines
from rotorfit.reporting import write_report
from rotorfit.reporting.charts import horizon_charts, profile_charts, residual_charts
from rotorfit.reporting.panels import flight_panels
from rotorfit.reporting.views import Chart
from rotorfit.simulation.paper_vehicle import Truth, as_log, simulate_flight

LOOK = {"measured": "#7a8593", "model": "#0b57b7", "paper": "#b4470b", "hold": "#6f42c1", "residual": "#0b57b7"}
SCROLL = """(async () => {
  document.querySelectorAll("details").forEach(d => { d.open = true; });
  for (let y = 0; y < document.documentElement.scrollHeight; y += 800) {
    scrollTo(0, y);
    await new Promise(done => setTimeout(done, 50));
  }
})()"""
"""Unfolds everything and goes through the page."""

AFTER_LOAD = 2.0
"""How long the main thread is watched after the load event [s]."""


def flown(seconds: float, seed: int) -> Flight:
    return flight_from_log(as_log(simulate_flight(Truth(), two_sines, seconds, seed)), load_card("rotorfit-demo"))


def content() -> tuple[Case, list[Chart]]:
    """The model with its proof, and the charts that its report draws."""
    fitted = with_delay_profiles(fit([flown(60.0, 1)]))
    flights = (flown(600.0, 2),)
    case = Case("model.json", fitted.model, (), validate(fitted.model, flights, CURVE), flights)
    (evidence,) = evidence_of([case])
    (motion,), _ = flight_panels([evidence], ["model"])
    charts = [panel.chart for panel in motion.panels if isinstance(panel.chart, Chart)]
    charts += horizon_charts(evidence.scores, case.validation.paired)
    residuals = residual_charts(evidence.autocorrelation, evidence.command_correlation)
    return case, [*charts, *profile_charts(case.model), *residuals]


def plotly_page(charts: Sequence[Chart]) -> str:
    parts = []
    for number, chart in enumerate(charts):
        drawing = graph_objects.Figure(layout={"title": chart.title, "height": 300})
        for line in chart.lines:
            x, y = chart.x.astype("f4"), line.y.astype("f4")
            drawing.add_trace(
                graph_objects.Scatter(x=x, y=y, name=line.name, line_color=LOOK.get(line.role, "#57606b"))
            )
        drawing.update_xaxes(title=chart.x_label)
        drawing.update_yaxes(title=chart.y_label, type="log" if chart.y_log else "linear")
        parts.append(drawing.to_html(full_html=False, include_plotlyjs=number == 0))
    return f"<!doctype html><html><head><meta charset=utf-8></head><body>{''.join(parts)}</body></html>"


def bokeh_page(charts: Sequence[Chart]) -> str:
    figures = []
    for chart in charts:
        scale = "log" if chart.y_log else "linear"
        drawing = figure(title=chart.title, height=300, width=900, y_axis_type=scale,
                         x_axis_label=chart.x_label, y_axis_label=chart.y_label)  # fmt: skip
        for line in chart.lines:
            x, y = chart.x.astype("f4"), line.y.astype("f4")
            drawing.line(x, y, legend_label=line.name, color=LOOK.get(line.role, "#57606b"))
        figures.append(drawing)
    return file_html(column(figures), INLINE, "charts")


def loaded(browser: Browser, page: Path) -> dict[str, float]:
    """One load in a fresh context: seconds to paint and to the load event, and work of the main thread."""
    context = browser.new_context(viewport={"width": 1280, "height": 900})
    tab = context.new_page()
    session = context.new_cdp_session(tab)
    session.send("Performance.enable")
    tab.goto(page.as_uri(), wait_until="load", timeout=180_000)
    tab.wait_for_function("performance.getEntriesByName('first-contentful-paint').length > 0")
    tab.wait_for_timeout(1000 * AFTER_LOAD)
    paint, load = tab.evaluate(
        "[performance.getEntriesByName('first-contentful-paint')[0].startTime, "
        "performance.getEntriesByType('navigation')[0].loadEventEnd]"
    )
    work = worked(session)
    tab.evaluate(SCROLL)
    tab.wait_for_timeout(1000)
    whole = worked(session)
    context.close()
    return {"paint": paint / 1000, "load": load / 1000, "work": work, "whole": whole}


def worked(session: CDPSession) -> float:
    """What the main thread has worked since the tab was opened [s]."""
    metrics = session.send("Performance.getMetrics")["metrics"]
    return float(next(each["value"] for each in metrics if each["name"] == "TaskDuration"))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", nargs="?", type=int, default=15)
    parser.add_argument("--chromium", default=shutil.which("chromium") or shutil.which("google-chrome"))
    parser.add_argument("-o", type=Path, default=Path(__file__).with_name("report.json"))
    arguments = parser.parse_args()
    case, charts = content()
    with tempfile.TemporaryDirectory() as name, sync_playwright() as playwright:
        pages = {each: Path(name) / f"{each}.html" for each in ("rotorfit", "plotly", "bokeh")}
        write_report(evidence_of([case]), pages["rotorfit"])
        makers: dict[str, Callable[[Sequence[Chart]], str]] = {"plotly": plotly_page, "bokeh": bokeh_page}
        for each, make in makers.items():
            pages[each].write_text(make(charts), encoding="utf-8")
        browser = playwright.chromium.launch(executable_path=arguments.chromium, args=["--no-sandbox"])
        found: dict[str, list[dict[str, float]]] = {each: [] for each in pages}
        for run in range(arguments.runs + 1):
            for each, page in pages.items():
                measured = loaded(browser, page)
                if run:  # the first warms the disk
                    found[each].append(measured)
        version = browser.version
        browser.close()
        table = {each: {"bytes": pages[each].stat().st_size, **quartiles(found[each])} for each in pages}
    values = sum(line.y.size for chart in charts for line in chart.lines)
    result = {"chromium": version, "runs": arguments.runs, "charts": len(charts), "values": values, "pages": table}
    arguments.o.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    for each, row in table.items():
        times = ", ".join(
            f"{key} {row[key][1]:.2f} s ({row[key][0]:.2f} to {row[key][2]:.2f})"
            for key in ("paint", "load", "work", "whole")
        )
        print(f"{each:9} {row['bytes'] / 1e6:.2f} MB, {times}")


def quartiles(runs: Sequence[dict[str, float]]) -> dict[str, list[float]]:
    return {
        key: [round(float(q), 4) for q in np.percentile([run[key] for run in runs], [25, 50, 75])] for key in runs[0]
    }


if __name__ == "__main__":
    main()
