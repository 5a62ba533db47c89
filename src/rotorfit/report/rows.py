"""Model, validation, verdict -> rows of the page's tables, ready to print."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from rotorfit.evidence import LENGTH, SPEED, Score
from rotorfit.forecast import HORIZONS
from rotorfit.frames import AXES
from rotorfit.model import Model
from rotorfit.paired import Difference, Paired
from rotorfit.report.usable import Use
from rotorfit.report.verdict import Verdict, better, errors_text
from rotorfit.report.words import figure, sentences
from rotorfit.validation import FlightScores, Validation
from rotorfit.whiteness import ResidualTests

ANSWERS = {
    "yes": ("✓", "proven"),
    "limited": ("~", "in part"),
    "unproven": ("?", "not proven"),
    "no": ("✗", "no"),
    "missing": ("–", "no model"),
}
"""Answer to its sign and its word."""


@dataclass(frozen=True)
class Cell:
    """One axis at one horizon: answer, sign and word, errors of velocity and position, ratio, and all in a sentence."""

    answer: str
    sign: str
    word: str
    velocity: str
    position: str
    times: str
    told: str


def ahead_rows(verdict: Verdict) -> tuple[tuple[float, ...], list[tuple[str, list[Cell]]]]:
    """Horizons, and for every axis and for the model as a whole a cell each."""
    horizons = tuple(sorted({use.horizon for use in verdict.uses}))
    rows = [(axis, [_cell(use) for use in verdict.uses if use.axis == axis]) for axis in AXES]
    return horizons, [*rows, ("all", [_cell(use) for use in verdict.weakest])]


def _cell(use: Use) -> Cell:
    sign, word = ANSWERS[use.answer]
    (reason,) = sentences([use.reason]) if use.reason else ("",)
    place = f"{use.axis}, {use.horizon:g} s ahead: {word}."
    if use.velocity is None:
        return Cell(use.answer, sign, word, "", "", "", f"{place} {reason}")
    told = f"{place} Errors {errors_text(use)}{better(use.times)}, over {use.n} predictions. {reason}".rstrip()
    short = [text.replace("deg", "°") for text in errors_text(use).split(" and ")]
    times = "" if use.times is None else f"{figure(use.times)} ×"
    return Cell(use.answer, sign, word, short[0], short[1] if len(short) > 1 else "", times, told)


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


def score_rows(validation: Validation) -> list[list[str]]:
    """Errors flight by flight, of the axes that have any, at the horizons that people ask for."""
    return [row for number in range(len(validation.flights)) for row in _flight_rows(validation, number)]


def _flight_rows(validation: Validation, number: int) -> list[list[str]]:
    by_name: dict[str, FlightScores] = {
        "model": validation.flights[number],
        **{name: flights[number] for name, flights in validation.baselines.items()},
    }
    rows = []
    for axis in AXES:
        for key, own in by_name["model"].axes[axis].horizons.items():
            if float(key) in HORIZONS and own.velocity_rmse is not None:
                at = {name: each.axes[axis].horizons[key] for name, each in by_name.items()}
                velocity = {name: each.velocity_rmse for name, each in at.items()}
                position = {name: each.position_rmse for name, each in at.items()}
                score = Score(axis, float(key), velocity, position, own.n)
                rows.append([validation.flights[number].path, *_score_row(score)])
    return rows


def pooled_rows(scores: Sequence[Score]) -> list[list[str]]:
    """The same over all flights that count."""
    return [["all that were not fitted", *_score_row(score)] for score in scores if score.horizon in HORIZONS]


def _score_row(score: Score) -> list[str]:
    """Axis, horizon, errors of model, paper and hold, number of predictions."""
    cells = [score.axis, f"{score.horizon:g} s"]
    for errors, (unit, factor) in ((score.velocity, SPEED[score.axis]), (score.position, LENGTH[score.axis])):
        for name in ("model", "paper", "hold"):
            value = errors.get(name)
            cells.append("—" if value is None else f"{factor * value:.3g} {unit}")
    return [*cells, str(score.n)]


def paired_rows(validation: Validation) -> list[list[str]]:
    """Differences from the baselines with their 95 % intervals, flight by flight and pooled."""
    paths = [flight.path for flight in validation.flights]
    rows = []
    for axis in AXES:
        for test in validation.paired:
            for key, both in test.axes[axis].items():
                for number in range(len(paths) + (len(paths) > 1) if float(key) in HORIZONS else 0):
                    name = "all that were not fitted" if number == len(paths) else paths[number]
                    velocity = _difference(_one(both["velocity"], number), *SPEED[axis])
                    position = _difference(_one(both["position"], number), *LENGTH[axis])
                    if (cells := velocity + position) != ["—"] * 4:
                        rows.append([name, axis, test.second, f"{float(key):g} s", *cells])
    return rows


def _one(paired: Paired, number: int) -> Difference | None:
    """Of one flight; of all together behind the last."""
    return paired.pooled if number == len(paired.flights) else paired.flights[number]


def _difference(found: Difference | None, unit: str, factor: float) -> list[str]:
    """Figures and verdict."""
    if found is None:
        return ["—", "—"]
    ends = found.rmse_ci95
    told = "" if ends is None else f" ({factor * ends[0]:+.2g} to {factor * ends[1]:+.2g})"
    return [f"{factor * found.rmse:+.3g}{told} {unit}".replace("-", "−"), found.verdict.replace("_", " ")]


def residual_rows(paths: Sequence[str], tests: Sequence[Mapping[str, ResidualTests]]) -> list[list[str]]:
    """Flight, axis, whiteness, independence of past commands, variance, effect on the intervals."""
    pairs = [(path, axis, each) for path, axes in zip(paths, tests, strict=False) for axis, each in axes.items()]
    return [_residual_row(*pair) for pair in pairs]


def _residual_row(path: str, axis: str, tests: ResidualTests) -> list[str]:
    low, high = tests.variance_ci95
    command = "—"
    if tests.command_p is not None:
        command = f"{'follow' if tests.follows_command else 'free of'} them (p = {tests.command_p:.2g})"
    return [
        path,
        axis,
        f"{'white' if tests.white else 'not white'} (p = {tests.white_p:.2g})",
        f"{tests.ljung_box:.0f}, {tests.lags}",
        command,
        f"{tests.variance_ratio:.2f} ({low:.2f} to {high:.2f})",
        f"{max(tests.optimism.values(), default=1.0):.2f}",
    ]
