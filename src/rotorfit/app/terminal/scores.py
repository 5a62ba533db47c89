"""Terminal output of the ladder (every method, axis by axis) and of predictions (errors over horizons, by flight)."""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

from rich.console import RenderableType
from rich.text import Text

from rotorfit.app.terminal.frequency import responses_view
from rotorfit.app.terminal.proof import bands_view, leave_one_out_view, paired_view, residuals_view
from rotorfit.app.terminal.tables import View, bullets, finding_view, indented, table, three_digits, title
from rotorfit.assessment.method_comparison import DIFFERS, Ladder, MethodRow
from rotorfit.assessment.rows import SPEED
from rotorfit.assessment.summary import read_first, spoiled
from rotorfit.core.finding import told_together
from rotorfit.core.frames import AXES
from rotorfit.core.model import COEFFICIENTS, Axis, Interval, Model
from rotorfit.core.results import pool_lines
from rotorfit.reporting.verdict import STATUS

if TYPE_CHECKING:
    from rotorfit.app.comparison import Comparison
    from rotorfit.assessment.leave_one_out import LeaveOneOut
    from rotorfit.core.results import FlightScores, Validation


def ladder_view(ladder: Ladder) -> View:
    """What forbids to use an axis; all rungs of each axis, one below the other, with their remarks; the findings."""
    yield title(f"Every method on {', '.join(ladder.paths)}")
    if bad := spoiled(ladder.findings, {axis: _told_axis(rows) for axis, rows in ladder.axes.items()}):
        yield Text(read_first(bad), style="bold")
    for axis, rows in ladder.axes.items():
        shown = table(axis, *COEFFICIENTS, "1 s", "against ml", left=(0, 5), gap=3)
        scale = SPEED[axis][1]
        for row in rows:
            values = [_coefficient(row, name) for name in COEFFICIENTS]
            error = "-" if row.prediction is None else three_digits(scale * row.prediction)
            shown.add_row(row.method, *values, error, _verdict(row, rows[-1]))
        if (held := ladder.held[axis]) is not None:
            shown.add_row("hold", "", "", "", three_digits(scale * held), "", style="dim")
        yield ""
        yield shown
        yield from bullets([f"{row.method}: {row.remark}" for row in rows if row.remark])
        yield from bullets(_reasons(rows[-1]))
    yield ""
    for line in _LADDER_LEGEND:
        yield indented(line, 0, "dim")
    for finding in told_together(ladder.findings):
        yield ""
        yield from finding_view(finding)


def _told_axis(rows: Sequence[MethodRow]) -> Axis:
    """An axis of the best rung that gives numbers; of the best where none does."""
    return next((row.axis for row in reversed(rows) if row.axis.predictor), rows[-1].axis)


_LADDER_LEGEND = (
    "+-: standard error of the scatter of a method, without its bias (`paper` is biased wherever there is a delay).",
    "( ): ml finds that the law is wrong here, or that the commands explain nothing: not a number of the vehicle.",
    "1 s: RMSE of the velocity, predicted over all steps up to 1 s of these very flights [cm/s, yaw deg/s]; hold "
    "keeps the velocity.",
    f"against ml: the coefficients that both rows give; differs: those that are more than {DIFFERS:.1f} standard "
    "errors apart; agrees: none is, and only those named could be compared; else the status of the row or of ml that "
    "has no number.",
    "All rows fit the law with a delay alone to the same data: they agree on what is wrong in both. `rotorfit fit` "
    "weighs laws with a lag, too.",
)


def _coefficient(row: MethodRow, name: str) -> str:
    """A coefficient of a rung, in brackets where the likelihood denies it."""
    text = _plus_minus(getattr(row.axis, name), row.axis.stderr[name])
    return text if text == "-" or row.status[name] == "ok" else f"({text})"


def _reasons(best: MethodRow) -> Iterator[str]:
    """Why the likelihood gives no number, status by status."""
    for status in dict.fromkeys(best.status[name] for name in COEFFICIENTS if best.status[name] != "ok"):
        lost = [name for name in COEFFICIENTS if best.status[name] == status]
        which = "no number" if len(lost) == len(COEFFICIENTS) else ", ".join(f"no {name}" for name in lost)
        others = ", on every row; `rotorfit fit` weighs other laws" if status == "refuted" else ""
        yield f"{best.method}: {which}: {STATUS[status]}{others}"


def _plus_minus(value: float | None, error: float | None) -> str:
    """A value and its standard error, with two digits of the error."""
    if value is None or error is None:
        return "-"
    decimals = max(0, min(6, 1 - math.floor(math.log10(error)))) if error > 0 else 3
    return f"{value:.{decimals}f} +- {error:.{decimals}f}"


def _verdict(row: MethodRow, best: MethodRow) -> str:
    """The verdict of the agreement test on a rung, or why there is none."""
    known = [name for name in COEFFICIENTS if getattr(row.axis, name) is not None]
    if not known:
        return row.axis.status["input"]
    if not row.agreement:
        why = dict.fromkeys(best.status[name] for name in known)
        return "" if row is best else f"{best.method}: {', '.join(why)}"
    differing = [name for name, test in row.agreement.items() if not test.agrees]
    if differing:
        return f"differs: {', '.join(differing)}"
    compared = [name for name in COEFFICIENTS if name in row.agreement]
    return "agrees" if len(compared) == len(COEFFICIENTS) else f"agrees: {', '.join(compared)}"


_AT_ONCE = 4  # horizons beside each other in 80 columns


def validation_view(validation: "Validation") -> View:
    """What spoils the scores; errors of the model and of the baselines, flight by flight; paired tests; residuals."""
    for finding in told_together(validation.before_scores):
        yield from finding_view(finding)
        yield ""
    yield from _scores_view({"model": validation.flights, **validation.baselines}, ("model",))
    yield ""
    yield from paired_view(
        validation.paired, validation.flights, [("model",) * flight.fitted for flight in validation.flights]
    )
    yield from bullets(pool_lines(validation.flights, validation.paired))
    yield from responses_view(validation.responses, validation.flights)
    yield from bands_view(validation)
    yield from residuals_view(validation)


def left_out_view(result: "LeaveOneOut", model: Model) -> View:
    """Every flight scored by a model of the others, and how far those models differ."""
    yield ""
    yield title("Leave one out: each flight predicted by the model of the others")
    yield ""
    yield from _scores_view({"model": result.flights, **result.baselines}, ("model",))
    yield ""
    stated = {
        name: {**axis.stderr, **{key: _quarter(part.ci95) for key, part in axis.combinations.items()}}
        for name, axis in model.axes.items()
    }
    yield from leave_one_out_view(result, stated)


def _quarter(interval: Interval) -> float | None:
    """About the standard error behind a 95 % interval."""
    low, high = interval
    return None if low is None or high is None else (high - low) / 4


def comparison_view(comparison: "Comparison") -> View:
    """Errors of several models and of the baselines, flight by flight."""
    names = [f"model {number}" for number in range(1, len(comparison.paths) + 1)]
    yield from bullets([f"{name}: {path}" for name, path in zip(names, comparison.paths, strict=True)])
    yield ""
    models = {name: each.flights for name, each in zip(names, comparison.validations, strict=True)}
    yield from _scores_view({**models, **comparison.baselines}, tuple(models))
    yield ""
    fitted = [[name for name in models if models[name][k].fitted] for k in range(len(models[names[0]]))]
    yield from paired_view(comparison.paired, comparison.validations[0].flights, fitted)
    yield from bullets(comparison.notes)


def _scores_view(scores: Mapping[str, Sequence["FlightScores"]], models: Sequence[str]) -> View:
    flights = next(iter(scores.values()))
    for number, flight in enumerate(flights):
        start, end = flight.span
        rows = {name: each[number] for name, each in scores.items()}
        shown = [axis for axis in flight.moved if any(_has_scores(rows[name], axis) for name in models)]
        yield title(f"{flight.path}, {start:.2f} to {end:.2f} s; heading {_headings(rows, models)}")
        if seen := [name for name in models if rows[name].fitted]:
            told = "the model" if models == ("model",) else ", ".join(seen)
            yield indented(f"{told} was fitted to it: proves nothing. Give a flight that was not fitted.")
        horizons = list(flight.axes["x"].horizons)
        for first in range(0, len(horizons), _AT_ONCE):
            some = horizons[first : first + _AT_ONCE]
            if shown:
                yield _score_table(rows, shown, some)
        missing = [axis for axis in flight.moved if axis not in shown]
        if missing:
            yield indented(f"No scores of {', '.join(missing)}: no model of the axis, or fewer than 5 predictions.")
        still = [axis for axis in AXES if axis not in (*flight.moved, *flight.held)]
        if still:
            yield indented(f"Not shown: {', '.join(still)}, not commanded in this stretch (--json has them).")
        if flight.held:
            yield indented(f"Not shown: {', '.join(flight.held)}, merely held in this stretch (--json has them).")
        yield ""
    yield Text(
        "v: RMSE of the predicted velocity over all steps up to the horizon [cm/s, yaw deg/s]; p: RMSE of the position "
        "at its end [cm, yaw deg]; fit: of 1 s velocity predictions; n: predictions. hold keeps the velocity of the "
        "start; paper uses the paper's coefficients with a filter of their own, as a model of that method does; coast "
        "uses them from the state of the model's filter, without trim and disturbance"
        + ("; shown are those of the first model that knows the axis, tested each model's own" * (len(models) > 1))
        + ". heading predicted: x and y are predicted along the heading that the model of yaw gives; measured: along "
        "the recorded one, because the model has no yaw.",
        style="dim",
    )


def _headings(rows: Mapping[str, "FlightScores"], models: Sequence[str]) -> str:
    """Whether the heading is predicted or measured, model by model where that differs."""
    told = {name: rows[name].heading for name in models}
    if len(set(told.values())) == 1:
        return told[models[0]]
    return ", ".join(f"{heading} ({name})" for name, heading in told.items())


def _has_scores(scores: "FlightScores", axis: str) -> bool:
    return any(horizon.velocity_rmse is not None for horizon in scores.axes[axis].horizons.values())


def _score_table(rows: Mapping[str, "FlightScores"], axes: Sequence[str], horizons: Sequence[str]) -> RenderableType:
    heads = [f"{what} {horizon} s" for what in "vp" for horizon in horizons]
    out = table("axis", "", *heads, "fit", left=(0, 1))
    for axis in axes:
        scale = SPEED[axis][1]
        for number, (name, flight) in enumerate(rows.items()):
            errors = [flight.axes[axis].horizons[horizon] for horizon in horizons]
            values = [*(error.velocity_rmse for error in errors), *(error.position_rmse for error in errors)]
            fit = flight.axes[axis].fit_percent
            cells = ["-" if value is None else three_digits(scale * value) for value in values]
            out.add_row("" if number else axis, name, *cells, "-" if fit is None else f"{fit:.0f} %")
        counts = [max(flight.axes[axis].horizons[horizon].n for flight in rows.values()) for horizon in horizons]
        out.add_row("", "n", *(str(n) for n in counts), *[""] * (len(counts) + 1), style="dim")
    return out
