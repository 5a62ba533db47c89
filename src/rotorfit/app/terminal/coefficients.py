"""Terminal output of a model: coefficients, accuracy, physics, structures, findings."""

from collections.abc import Iterator, Mapping, Sequence

from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from rotorfit.app.terminal.tables import (
    FirstThatFits,
    View,
    bullets,
    finding_view,
    indented,
    table,
    three_digits,
    title,
)
from rotorfit.assessment.rows import LENGTH, coefficient_rows
from rotorfit.assessment.summary import summary_of_model
from rotorfit.core.display import interval_text, number_text
from rotorfit.core.finding import DAMAGED, told_together
from rotorfit.core.frames import AXES
from rotorfit.core.laws import structure_named
from rotorfit.core.model import COEFFICIENTS, Axis, Mode, Model
from rotorfit.core.physics import PhysicsRow, implied_limits, physics_rows
from rotorfit.reporting.accuracy import ERROR_HEADS, PERCENT_HEADS, accuracy_lines, error_rows, percent_rows

_AS_LIKELY, _FAR_LESS_LIKELY = 1.0, 5.0
"""Differences of the log-likelihood: below the first, two optima are equally likely; above the second, one is clear."""

_MOST_OTHERS = 3


def model_view(model: Model, axes: Sequence[str]) -> View:
    """Verdict, coefficients, other optima, repairs of the flights, findings."""
    wanted = [axis for axis in AXES if axis in axes]
    concerned = [finding for finding in model.findings if finding.axis is None or finding.axis in wanted]
    for finding in concerned:
        if finding.code == DAMAGED:
            yield from finding_view(finding)
            yield ""
    yield Text(summary_of_model(model, wanted))
    yield ""
    yield FirstThatFits([_coefficient_table(model, wanted, narrow) for narrow in (False, True)])
    known = {axis: model.axes[axis] for axis in wanted if model.axes[axis].predictor}
    combined = any(axis.combinations for axis in known.values())
    legend = f"; steady gain = input / damping; total lag = delay + 1 / damping{_lags(known)}" if combined else ""
    yield indented(f"input is per command of 1{legend}", 0, "dim")
    yield from bullets(_next_flight_lines(model, wanted))
    yield from bullets(_search_lines(known))
    if model.uncertainty:
        table_of, by_axis = model.uncertainty, model.axes
        parts = ((PERCENT_HEADS, percent_rows(table_of, by_axis)), (ERROR_HEADS, error_rows(table_of)))
        for heads, rows_of in parts:
            yield ""
            out = table(*heads, left=(0, 1), gap=1)
            for cells in rows_of:
                out.add_row(*cells)
            yield out
        yield from bullets(accuracy_lines(table_of, by_axis))
    rows = [row for row in physics_rows(model) if row.axis in wanted]
    if rows:
        yield ""
        yield _physics_table(rows)
        yield from bullets([line for line in implied_limits(model) if line.partition(":")[0] in wanted])
    for axis, one in known.items():
        yield from _structure_view(axis, one)
    for flight in model.flights:
        yield ""
        start, end = flight.span
        yield title(f"{flight.path}, {start:.2f} to {end:.2f} s, commands {', '.join(flight.axes) or 'nothing'}")
        yield from bullets([note.text for note in flight.notes if note.code != "damage"])  # shown first
    for finding in told_together(concerned):
        if finding.code != DAMAGED:
            yield ""
            yield from finding_view(finding)


def _lags(known: Mapping[str, Axis]) -> str:
    """What laws with further parameters add to the total lag, or subtract from it."""
    laws = [structure_named(axis.structure) for axis in known.values()]
    lag = ", with a lag before the velocity + lag" if any(law.order == 1 for law in laws) else ""
    zero = ", with a zero - zero" if any(extra.name == "zero" for law in laws for extra in law.extras) else ""
    return lag + zero


def _coefficient_table(model: Model, axes: Sequence[str], narrow: bool) -> Table:
    """The table of coefficients; a narrow one breaks lines between words, and is without the paper's values."""
    flights = "this flight" if len(model.flights) == 1 else "these flights"
    two = any(model.axes[axis].ci95_flight for axis in axes)
    between = "\n" if narrow else " "
    heads = (f"95 %{between}the vehicle", f"95 %{between}{flights}") if two else ("95 % interval",)
    paper = () if narrow else ("paper",)
    left = (0, 1, 3 + len(heads), 4 + len(heads) + len(paper))
    out = table("axis", "coefficient", "estimate", *heads, "unit", *paper, "status", left=left, gap=1)
    out.columns[-1].no_wrap = True
    for row in coefficient_rows(model):
        first, ends = row.name == COEFFICIENTS[0], (row.low, row.high)
        if row.axis not in axes or not (model.axes[row.axis].predictor or first or row.paper is not None):
            continue
        combined = row.kind == "combination"
        both = (interval_text(ends), interval_text(row.flight or ends)) if two else (interval_text(ends),)
        out.add_row(
            row.axis if first else "",
            _words(row.name),
            "-" if row.value is None else f"{row.value:g}" if row.given else number_text(row.value, ends),
            *(("by the law", "")[: len(both)] if row.given else both),
            row.unit,
            *([] if narrow else ["" if row.paper is None else f"{row.paper:.3g}"]),
            "" if combined else row.status.replace("_", "\n") if narrow else row.status,
        )
    return out


def _next_flight_lines(model: Model, axes: Sequence[str]) -> Iterator[str]:
    """What each axis is on another flight: the interval of the vehicle is that of its mean over flights."""
    rows = [row for row in coefficient_rows(model) if not row.given]
    for axis in axes:
        told = [
            f"{_words(row.name)} {interval_text(row.next_flight)}"
            for row in rows
            if row.axis == axis and row.next_flight
        ]
        if told:
            yield f"{axis} on the next flight, 95 %: {', '.join(told)}"


def _physics_table(rows: Sequence[PhysicsRow]) -> RenderableType:
    """Physical meaning of the coefficients, at full command, beside the values expected from the card."""
    out = table("axis", "in physics", "estimate", "95 % interval", "unit", "expect", "ratio", left=(0, 1, 4), gap=1)
    shown = ""
    for row in rows:
        value, ends = row.measured.value, row.measured.ci95
        ratio = row.ratio if row.ratio and None not in row.ratio.ci95 else None
        out.add_row(
            "" if row.axis == shown else row.axis,
            row.name.replace("_", " "),
            "-" if value is None else number_text(value, ends),
            interval_text(ends),
            row.unit,
            "" if row.expected is None else f"{row.expected:.3g}",
            "" if ratio is None or ratio.value is None
            else f"{ratio.value:.2f} ({ratio.ci95[0]:.2f} to {ratio.ci95[1]:.2f})",
        )  # fmt: skip
        shown = row.axis
    return out


def _words(name: str) -> str:
    return name.replace("_", " ")


def _law_lines(axis: str, known: Axis) -> Iterator[str]:
    """The laws between which the data cannot decide, and how far the lag depends on its prior."""
    if len(known.laws) > 1:
        parts = ", ".join(f"{law.structure} {100 * law.weight:.0f} %" for law in known.laws)
        yield f"{axis}: the data do not decide between laws ({parts}): intervals cover all of them"
    if known.lag_prior is not None:
        yield f"{axis}: {100 * known.lag_prior:.0f} % of what is known of the lag is its prior (0.1 s, 0.014 to 0.71 s)"


def _structure_view(axis: str, known: Axis) -> View:
    """The law of an axis if it is not the default, the default's coefficients, and the alternatives."""
    if known.plain:
        yield ""
        numbers = [
            f"{name} {'-' if value is None else number_text(value, known.plain.ci95[name])}"
            f" ({interval_text(known.plain.ci95[name])})"
            for name in COEFFICIENTS
            for value in (getattr(known.plain, name),)
        ]
        yield title(f"{axis}: structure {known.structure}, {structure_named(known.structure).law}")
        yield indented(f"With a delay alone instead: {', '.join(numbers)}")
    if known.laws:
        yield from bullets(_law_lines(axis, known))
    if not known.candidates:
        return
    yield ""
    yield title(f"{axis}: structures tried")
    unit, scale = LENGTH[axis]
    out = table("structure", "log L", "BIC", f"1 s [{unit}/s]", f"5 s [{unit}]", left=(0,))
    for one in known.candidates:
        errors = ["-" if e is None else three_digits(scale * e) for e in (one.velocity, one.position)]
        mark = " *" if one.chosen else ""
        out.add_row(f"{one.structure}{mark}", f"{one.log_likelihood:+.1f}", f"{one.bic:+.1f}", *errors)
    yield out
    yield from bullets([f"{one.structure}: {one.verdict}" for one in known.candidates if one.rival or not one.chosen])
    yield indented("log L and BIC less the default's; errors of predictions of what was held out; * chosen", 0, "dim")


def _search_lines(known: Mapping[str, Axis]) -> Iterator[str]:
    """Whether other delays explain the flights as well: a line for each axis where some do, and one for the others.

    The report and --json have the likelihood of each, the number of starts that ended there, and its predictions.
    """
    alone: list[str] = []
    for axis, one in known.items():
        chosen = next((mode for mode in one.modes if mode.chosen), None)
        if chosen is None:
            continue
        others = sorted((mode for mode in one.modes if not mode.chosen), key=lambda mode: -mode.log_likelihood)
        near = [said for mode in others if (said := _beside(chosen, mode))]
        if near:
            more = f" and {len(near) - _MOST_OTHERS} more" if len(near) > _MOST_OTHERS else ""
            yield f"{axis}: other delays fit almost as well: {', '.join(near[:_MOST_OTHERS])}{more}"
        else:
            alone.append(axis)
    if alone:
        yield f"{', '.join(alone)}: no other delay was found that fits nearly as well"


def _beside(chosen: Mode, mode: Mode) -> str:
    """How an optimum that was not chosen compares, in words; empty if it is far less likely."""
    above = mode.log_likelihood - chosen.log_likelihood
    if above < -_FAR_LESS_LIKELY:
        return ""
    same = f"{mode.delay:.3f}" == f"{chosen.delay:.3f}"
    where = f"{mode.delay:.3f} s{f' with a damping of {mode.damping:.3g} 1/s' if same else ''}"
    if above <= _AS_LIKELY:
        return f"{where} ({'as' if above >= -_AS_LIKELY else 'less'} likely)"
    worse = mode.prediction / chosen.prediction if mode.prediction and chosen.prediction else 1.0
    return f"{where} (more likely, but predicts {f'{worse:.1f} times worse' if worse >= 1.05 else 'no better'})"
