"""From model, validation and verdict to the rows of the page's tables, ready to print.

Among them are the table of coefficients, with suitably rounded numbers and a bar for each interval, and the model in
physical terms: accelerations, speeds and times beside the values expected from the card.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from rotorfit.assessment.evidence import Evidence
from rotorfit.assessment.rows import LENGTH, SPEED, CoefficientRow, HorizonErrors
from rotorfit.core.frames import AXES
from rotorfit.core.laws import structure_named
from rotorfit.core.limits import Figure
from rotorfit.core.model import STRUCTURE, Interval, Model
from rotorfit.core.residuals import ResidualTests, told_p
from rotorfit.core.results import HORIZONS, Difference, FlightScores, Paired, Validation, named_apart
from rotorfit.reporting.verdict import Use, Verdict, better, errors_text
from rotorfit.reporting.words import figure, rounded, sentences, term_of


@dataclass(frozen=True)
class Bar:
    """Places of an interval, its estimate and the paper's value along a bar of length 100."""

    low: float
    high: float
    value: float | None
    paper: float | None


@dataclass(frozen=True)
class RowText:
    """A row of the table of coefficients, ready to print; `kind` is `ok`, `missing`, `bad` or `combination`.

    `interval` is that of the vehicle, `flight` that of the flights alone, empty if it is the same; `next_flight` that
    of another flight, empty where one flight alone was fitted.
    """

    term: str
    symbol: str
    value: str
    stderr: str
    interval: str
    flight: str
    next_flight: str
    unit: str
    status: str
    paper: str
    kind: str
    bar: Bar | None
    tip: str


def coefficient_table(rows: Sequence[CoefficientRow]) -> list[tuple[str, list[RowText]]]:
    """Rows of the table of coefficients, axis by axis."""
    return [(axis, [_row_text(row) for row in group]) for axis, group in groupby(rows, key=lambda row: row.axis)]


def laws_of(model: Model) -> list[tuple[str, str]]:
    """Axes with a structure other than the default, and the law of each."""
    known = {name: axis.structure for name, axis in model.axes.items() if axis.structure != STRUCTURE}
    return [(name, structure_named(structure).law) for name, structure in known.items()]


def unit_text(row: CoefficientRow) -> str:
    """The unit of a row, per command if that applies."""
    if row.unit == "command":
        return row.per
    return f"{row.unit.replace('^2', '²')} per {row.per}" if row.per else row.unit


def _row_text(row: CoefficientRow) -> RowText:
    width = None if row.low is None or row.high is None else (row.high - row.low) / 4
    scale = row.stderr or width
    interval = _ends_text((row.low, row.high), scale)
    kind = {"ok": "ok", "diverged": "bad", "refuted": "bad"}.get(row.status, "missing")
    if row.name in ("steady_gain", "total_lag", "offset_plus_delay"):
        kind = "combination"
    paper = rounded(row.paper, min(scale, abs(row.paper)) if scale and row.paper else scale)
    tip = f"{term_of(row.name)}: estimate {rounded(row.value, scale)}, 95 % interval {interval}, paper's {paper}"
    return RowText(
        term=term_of(row.name),
        symbol=row.symbol,
        value=rounded(row.value, scale),
        stderr=rounded(row.stderr, row.stderr),
        interval=interval,
        flight=_ends_text(row.flight, scale) if row.flight else "",
        next_flight=_ends_text(row.next_flight, scale) if row.next_flight else "",
        unit=unit_text(row),
        status=row.status.replace("_", " "),
        paper=paper,
        kind=kind,
        bar=_bar(row),
        tip=tip,
    )


def _ends_text(ends: Interval, scale: float | None) -> str:
    """An interval; an end that is small compared with its width keeps a significant digit."""
    if ends == (None, None):
        return "—"
    return " to ".join(
        "open" if end is None else rounded(end, min(scale, abs(end)) if scale and end else scale) for end in ends
    )


def _bar(row: CoefficientRow) -> Bar | None:
    """The bar of an interval; an open end extends to the border, and a paper's value beyond it is drawn there."""
    if row.low is None and row.high is None:
        return None
    finite = [end for end in (row.low, row.high, row.value) if end is not None]
    low, high = min(finite), max(finite)
    pad = 1.2 * (high - low) or abs(high) or 1.0
    if row.paper is not None:  # the bar extends to twice the interval's width for it
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


@dataclass(frozen=True)
class PhysicsText:
    """The physics table as text: axis, quantity, estimate, interval, unit, expected, ratio; and lines below it."""

    rows: tuple[tuple[str, ...], ...]
    lines: tuple[str, ...]


def physics_text(evidence: Evidence) -> PhysicsText:
    """The model in physical terms; no rows if the card gives no command a meaning."""
    rows = tuple(
        (
            row.axis,
            row.name.replace("_", " "),
            rounded(row.measured.value, _width(row.measured)),
            _interval(row.measured),
            row.unit,
            "" if row.expected is None else rounded(row.expected),
            _ratio(row.ratio),
        )
        for row in evidence.physics
    )
    return PhysicsText(rows, evidence.limits)


def _width(figure: Figure) -> float | None:
    """A quarter of the interval's width: about a standard error."""
    low, high = figure.ci95
    return None if low is None or high is None else (high - low) / 4


def _interval(figure: Figure) -> str:
    if figure.ci95 == (None, None):
        return "—"
    return " to ".join("open" if end is None else rounded(end, _width(figure)) for end in figure.ci95)


def _ratio(ratio: Figure | None) -> str:
    if ratio is None or ratio.value is None:
        return ""
    return f"{rounded(ratio.value, _width(ratio))} ({_interval(ratio)})"


ANSWERS = {
    "yes": ("✓", "proven"),
    "limited": ("~", "in part"),
    "unproven": ("?", "not proven"),
    "no": ("✗", "no"),
    "missing": ("–", "no model"),
}
"""Answer to its symbol and its word."""


@dataclass(frozen=True)
class Cell:
    """One axis at one horizon: answer, symbol, word, errors of velocity and position, ratio, and a sentence."""

    answer: str
    sign: str
    word: str
    velocity: str
    position: str
    times: str
    tip: str


def ahead_rows(verdict: Verdict) -> tuple[tuple[float, ...], list[tuple[str, list[Cell]]]]:
    """The horizons, and a row of cells for every axis and for the model as a whole."""
    horizons = tuple(sorted({use.horizon for use in verdict.uses}))
    rows = [(axis, [_cell(use) for use in verdict.uses if use.axis == axis]) for axis in AXES]
    return horizons, [*rows, ("all", [_cell(use) for use in verdict.weakest])]


def _cell(use: Use) -> Cell:
    sign, word = ANSWERS[use.answer]
    (reason,) = sentences([use.reason]) if use.reason else ("",)
    place = f"{use.axis}, {use.horizon:g} s ahead: {word}."
    if use.velocity is None:
        return Cell(use.answer, sign, word, "", "", "", f"{place} {reason}")
    tip = f"{place} Errors {errors_text(use)}{better(use.times)}, over {use.n} predictions. {reason}".rstrip()
    short = [text.replace("deg", "°") for text in errors_text(use).split(" and ")]
    times = "" if use.times is None else f"{figure(use.times)} ×"
    return Cell(use.answer, sign, word, short[0], short[1] if len(short) > 1 else "", times, tip)


def mode_rows(model: Model) -> list[list[str]]:
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
            values = (f"{mode.delay:.3f} s", f"{mode.damping:.3g} 1/s", f"{mode.input:.3g}")
            rows.append([name, word, *values, likelihood, error, str(mode.starts)])
    return rows


def flight_names(validation: Validation) -> list[str]:
    """Paths of the flights; those to which the model was fitted are marked, for they prove nothing."""
    named = zip(named_apart(validation.flights), validation.flights, strict=True)
    return [f"{name} (fitted)" if flight.fitted else name for name, flight in named]


def score_rows(validation: Validation) -> list[list[str]]:
    """Errors flight by flight, of the axes that have any, at the horizons of the protocol."""
    return [
        row for number, name in enumerate(flight_names(validation)) for row in _flight_rows(validation, number, name)
    ]


def _flight_rows(validation: Validation, number: int, name: str) -> list[list[str]]:
    by_name: dict[str, FlightScores] = {
        "model": validation.flights[number],
        **{name: flights[number] for name, flights in validation.baselines.items()},
    }
    rows = []
    for axis in AXES:
        for key, own in by_name["model"].axes[axis].horizons.items():
            if float(key) in HORIZONS and own.velocity_rmse is not None:
                at = {predictor: each.axes[axis].horizons[key] for predictor, each in by_name.items()}
                velocity = {predictor: each.velocity_rmse for predictor, each in at.items()}
                position = {predictor: each.position_rmse for predictor, each in at.items()}
                score = HorizonErrors(axis, float(key), velocity, position, own.n)
                rows.append([name, *_score_row(score)])
    return rows


def pooled_rows(scores: Sequence[HorizonErrors]) -> list[list[str]]:
    """Errors pooled over all flights that count."""
    return [["all that were not fitted", *_score_row(score)] for score in scores if score.horizon in HORIZONS]


def _score_row(score: HorizonErrors) -> list[str]:
    """Axis, horizon, errors of model, paper and hold, number of predictions."""
    cells = [score.axis, f"{score.horizon:g} s"]
    for errors, (unit, factor) in ((score.velocity, SPEED[score.axis]), (score.position, LENGTH[score.axis])):
        for name in ("model", "paper", "hold"):
            value = errors.get(name)
            cells.append("—" if value is None else f"{factor * value:.3g} {unit}")
    return [*cells, str(score.n)]


def paired_rows(validation: Validation) -> list[list[str]]:
    """Differences from the baselines with their 95 % intervals, flight by flight and pooled."""
    paths = flight_names(validation)
    rows = []
    for axis in AXES:
        for test in validation.paired:
            for key, both in test.axes[axis].items():
                short = max(each.left_out for each in both.values())
                pool = "all that were not fitted" + (f", less {short} too short" if short else "")
                names = [*paths, pool] if len(paths) > 1 else paths
                for number, name in enumerate(names if float(key) in HORIZONS else ()):
                    velocity = _difference(_one(both["velocity"], number), *SPEED[axis])
                    position = _difference(_one(both["position"], number), *LENGTH[axis])
                    if (cells := velocity + position) != ["—"] * 4:
                        rows.append([name, axis, test.second, f"{float(key):g} s", *cells])
    return rows


def _one(paired: Paired, number: int) -> Difference | None:
    """The difference on one flight; the pooled one for the number after the last."""
    return paired.pooled if number == len(paired.flights) else paired.flights[number]


def _difference(found: Difference | None, unit: str, factor: float) -> list[str]:
    """Figures and verdict."""
    if found is None:
        return ["—", "—"]
    ends = found.rmse_ci95
    scale = None if ends is None else factor * (ends[1] - ends[0]) / 4  # about the standard error
    difference, *interval = (_signed(factor * value, scale) for value in (found.rmse, *(ends or ())))
    told = f" ({' to '.join(interval)})" if interval else ""
    return [f"{difference}{told} {unit}", found.verdict.replace("_", " ")]


def _signed(value: float, scale: float | None) -> str:
    """A difference with its sign, rounded according to its uncertainty."""
    return f"{'+' if value > 0 else ''}{rounded(value, scale)}"


def residual_rows(paths: Sequence[str], tests: Sequence[Mapping[str, ResidualTests]]) -> list[list[str]]:
    """Flight, axis, whiteness, independence of past commands, variance, effect on the intervals."""
    pairs = [(path, axis, each) for path, axes in zip(paths, tests, strict=False) for axis, each in axes.items()]
    return [_residual_row(*pair) for pair in pairs]


def _residual_row(path: str, axis: str, tests: ResidualTests) -> list[str]:
    low, high = tests.variance_ci95
    command = "not tested"
    if tests.command_p is not None:
        command = f"{'follow' if tests.follows_command else 'free of'} them ({told_p(tests.command_p)})"
    return [
        path,
        axis,
        f"{'white' if tests.white else 'not white'} ({told_p(tests.white_p)})",
        f"{tests.ljung_box:.0f}, {tests.lags}",
        command,
        f"{tests.variance_ratio:.2f} ({low:.2f} to {high:.2f})",
        f"{max(tests.optimism.values(), default=1.0):.2f}",
    ]
