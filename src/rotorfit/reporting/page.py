"""From evidence to the page about a model and its validation, or about several side by side."""

from collections.abc import Sequence

from rotorfit.assessment.case import Case
from rotorfit.assessment.evidence import Evidence
from rotorfit.estimation.methods import label_of
from rotorfit.reporting.document import Heading, document
from rotorfit.reporting.panels import flight_panels, series, speeds_of
from rotorfit.reporting.sections import SECTIONS, Contents
from rotorfit.reporting.side_by_side import names_of
from rotorfit.reporting.verdict import verdict_on
from rotorfit.reporting.views import look_of


def page(evidences: Sequence[Evidence]) -> str:
    """The whole page, for one model or for several on the same flights.

    Args:
        evidences: Evidence of each model.
    """
    cases = [evidence.case for evidence in evidences]
    names = names_of(cases)
    tested, fitted = flight_panels(evidences, names)
    speeds = speeds_of([view for view in tested if not view.fitted])
    verdicts = tuple(verdict_on(evidence, speeds) for evidence in evidences)
    contents = Contents(tuple(evidences), names, verdicts, tuple(tested), tuple(fitted))
    shared = {
        "cases": cases,
        "names": names,
        "several": contents.several,
        "roles": _roles(cases, names),
    }
    heading = Heading(
        title="Models compared" if contents.several else "Model report",
        kind=f"comparison of {len(cases)} models" if contents.several else "model report",
        name=cases[0].model.card.name,
        origins=tuple(zip(names if contents.several else ("",), map(_origin, cases), strict=True)),
        first="the verdict",
    )
    sections = {
        anchor: (section.title, f"sections/{anchor}.html.j2", section.content(contents))
        for anchor, section in SECTIONS.items()
    }
    return document(heading, sections, [series(flight) for flight in (*tested, *fitted)], shared)


def _roles(cases: Sequence[Case], names: Sequence[str]) -> list[tuple[str, str]]:
    """Roles and names of the predicted lines, for the legends."""
    if len(cases) > 1:
        return [(look_of(k), name) for k, name in enumerate(names)]
    return [("model", "this model"), *([("paper", "paper's coefficients")] if cases[0].model.method != "paper" else [])]


def _origin(case: Case) -> str:
    """The method, the flights of the fit, and the flights of the validation, in a sentence."""
    model = case.model
    fitted = sum(end - start for start, end in (source.span for source in model.flights))
    first = f"Fitted by {label_of(model.method)} ({model.method}) to {_count(len(model.flights))}, {fitted:.0f} s"
    spans = [scores.span for scores in case.validation.flights if not scores.fitted]
    if not spans:
        return f"{first}; not validated."
    return f"{first}; validated on {_count(len(spans))} outside the fit, {sum(b - a for a, b in spans):.0f} s."


def _count(flights: int) -> str:
    return f"{flights} flight" if flights == 1 else f"{flights} flights"
