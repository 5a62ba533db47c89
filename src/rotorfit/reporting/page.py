"""Evidence -> one self-contained HTML page: nothing in it is fetched, and everything that is not ours is escaped."""

import json
from collections.abc import Iterable, Sequence
from importlib import resources
from typing import Any

from rotorfit.assessment.case import Case
from rotorfit.assessment.evidence import Evidence
from rotorfit.estimation.methods import label_of
from rotorfit.reporting.panels import FlightPanels, flight_panels, series, speeds_of
from rotorfit.reporting.sections import SECTIONS, Contents
from rotorfit.reporting.side_by_side import names_of
from rotorfit.reporting.verdict import Verdict, verdict_of
from rotorfit.reporting.views import look_of
from rotorfit.reporting.words import AXIS, TERMS, slug
from rotorfit.version import __version__


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
    verdicts = tuple(_verdict(evidence, tested) for evidence in evidences)
    contents = Contents(tuple(evidences), names, verdicts, tuple(tested), tuple(fitted))
    shared = {
        "cases": cases,
        "names": names,
        "several": contents.several,
        "roles": _roles(cases, names),
        "terms": TERMS,
        "slug": slug,
        "axis_words": AXIS,
    }
    # Our own files and JSON without "<" may stand in <style> and <script> as they are; everything else is escaped.
    text = environment.get_template("page.html.j2").render(
        **shared,
        style=Markup(_file("uplot/uPlot.min.css") + _file("templates/page.css")),
        plot_library=Markup(_plot_library()),
        script=Markup(_file("templates/figures.js") + _file("templates/zoom.js")),
        series=Markup(_json(series(flight) for flight in (*tested, *fitted))),
        version=__version__,
        origins=[_origin(case) for case in cases],
        sections=SECTIONS,
        parts=[
            Markup(environment.get_template(f"sections/{anchor}.html.j2").render(**shared, **section.content(contents)))
            for anchor, section in SECTIONS.items()
        ],
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
