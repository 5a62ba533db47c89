"""What is known of a model and why to believe it: coefficients, scores, horizons, delay profiles, residuals.

Tables and charts for whoever draws; see `views`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from rotorfit.assessment.validation import coefficient_covariance, residuals
from rotorfit.assessment.whiteness import LEAST_BLOCKS, autocorrelation, cross_correlation
from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES, Array
from rotorfit.core.laws import structure_named
from rotorfit.core.model import COEFFICIENTS, Axis, Model
from rotorfit.core.results import Correlogram, FlightScores, PairedTest, Quantity, Validation
from rotorfit.reporting.views import Chart, Line, Mark, moved_axes

LAGS = 2.0
"""Longest lag of the residuals' autocorrelation [s]."""

FALL = 1.92
"""Fall of the profile at the ends of an interval: half the 95 % point of chi-squared with one degree of freedom."""

PROFILE_REACH = 25.0
"""How far above and below its maximum a profile is drawn: beyond, all delays are equally impossible."""

SPEED = {axis: ("deg/s", 180 / np.pi) if axis == "yaw" else ("cm/s", 100.0) for axis in AXES}
"""Unit of a velocity error for people, and the factor from SI."""

LENGTH = {axis: ("deg", 180 / np.pi) if axis == "yaw" else ("cm", 100.0) for axis in AXES}
"""Unit of a position error for people, and the factor from SI."""

_UNITS = {"natural_frequency": "rad/s", "damping_ratio": "", "damping_at_rest": "1/s", "quadratic_drag": "1/m or 1/rad"}
"""Units of combinations that are not seconds."""


@dataclass(frozen=True)
class HorizonErrors:
    """Errors at one horizon over all validation flights that command the axis, SI; None where there is no number.

    Attributes:
        axis: Name.
        horizon: [s].
        velocity: `model`, `hold`, `paper` to velocity RMSE.
        position: The same of the end point.
        n: Number of predictions.
    """

    axis: str
    horizon: float
    velocity: Mapping[str, float | None]
    position: Mapping[str, float | None]
    n: int


@dataclass(frozen=True)
class CoefficientRow:
    """One row of the table of coefficients; None where there is no number.

    Attributes:
        axis: Name.
        name: `input`, `damping`, `delay`, a further parameter of the structure, or a combination such as `total_lag`.
        symbol: The paper's, such as g1; empty where it has none.
        unit: As text.
        value: Estimate.
        stderr: Standard error.
        low: Lower end of the 95 % interval.
        high: Upper end.
        status: Of the coefficient; of a combination `ok`, or `open` where an end is missing.
        paper: What the paper's regression gives on the same data.
    """

    axis: str
    name: str
    symbol: str
    unit: str
    value: float | None
    stderr: float | None
    low: float | None
    high: float | None
    status: str
    paper: float | None


def coefficient_rows(model: Model) -> tuple[CoefficientRow, ...]:
    """Coefficients and their identifiable combinations, axis by axis, with the paper's beside them."""
    rows = []
    for k, name in enumerate(AXES):
        axis, per = model.axes[name], command_unit(model, name)
        gain, damping = model.paper[2 * k : 2 * k + 2]
        papers = {"input": gain, "damping": damping, "steady_gain": None, "total_lag": None}
        if gain is not None and damping:
            papers |= {"steady_gain": gain / damping, "total_lag": 1 / damping if damping > 0 else None}
        rate = "rad/s" if name == "yaw" else "m/s"
        units = {"input": f"{rate}² per {per}", "damping": "1/s", "steady_gain": f"{rate} per {per}", **_UNITS}
        units |= {"input_up": units["input"], "input_down": units["input"]}
        for number, coefficient in enumerate(COEFFICIENTS):
            low, high = axis.ci95.get(coefficient, (None, None))
            rows.append(
                CoefficientRow(
                    name, coefficient, f"g{2 * k + number + 1}" if number < 2 else "",
                    units.get(coefficient, "s"), getattr(axis, coefficient), axis.stderr.get(coefficient), low, high,
                    axis.status.get(coefficient, "not_identifiable"), papers.get(coefficient),
                )
            )  # fmt: skip
        for extra in structure_named(axis.structure).extras if axis.predictor else ():
            low, high = axis.ci95.get(extra.name, (None, None))
            unit = {"speed": rate, "gain": f"{rate}² per {per}", "command": per}.get(extra.unit, extra.unit)
            value, error = axis.extra[extra.name], axis.stderr.get(extra.name)
            status = axis.status.get(extra.name, "given")
            rows.append(CoefficientRow(name, extra.name, "", unit, value, error, low, high, status, None))
        for combination, known in axis.combinations.items():
            low, high = known.ci95
            status = "ok" if low is not None and high is not None else "open"
            unit, paper = units.get(combination, "s"), papers.get(combination)
            rows.append(CoefficientRow(name, combination, "", unit, known.value, None, low, high, status, paper))
    return tuple(rows)


def command_unit(model: Model, axis: str) -> str:
    """Unit of a command of the model's card, for people."""
    channel = model.card.command.get(axis)
    if channel is None:
        return "unit of command"
    if channel.full_scale:
        return f"full {channel.full_scale.replace('_', ' ')}"
    units = {"tilt": "rad", "velocity": "m/s", "vertical_speed": "m/s", "yaw_rate": "rad/s"}
    return units.get(channel.meaning or "", "unit of command")


def scores_of(validation: Validation, flights: Sequence[Flight]) -> tuple[HorizonErrors, ...]:
    """Scores pooled over the flights that command the axis and were not fitted, weighted by the number of predictions.

    Args:
        validation: Scores, flight by flight.
        flights: The same flights, to tell what they command; where they are not at hand all scores count.
    """
    known = len(flights) == len(validation.flights)
    by_name = {"model": validation.flights, **validation.baselines}
    out = []
    for axis in AXES:
        fresh = [i for i, scores in enumerate(validation.flights) if not scores.fitted]
        used = [i for i in fresh if not known or axis in moved_axes(flights[i])]
        horizons = validation.flights[used[0]].axes[axis].horizons if used else {}
        for key in horizons:
            chosen = {name: [every[i] for i in used] for name, every in by_name.items() if every}
            pooled = {name: _pooled(every, axis, key) for name, every in chosen.items()}
            velocity = {name: result[0] for name, result in pooled.items()}
            position = {name: result[1] for name, result in pooled.items()}
            out.append(
                HorizonErrors(axis, float(key), velocity, position, max(result[2] for result in pooled.values()))
            )
    return tuple(out)


def _pooled(flights: Sequence[FlightScores], axis: str, key: str) -> tuple[float | None, float | None, int]:
    """Velocity RMSE, position RMSE and n at one horizon over several flights."""
    squares, n = np.zeros(2), 0
    for flight in flights:
        errors = flight.axes[axis].horizons.get(key)
        if errors and errors.velocity_rmse is not None and errors.position_rmse is not None:
            squares += errors.n * np.array([errors.velocity_rmse, errors.position_rmse]) ** 2
            n += errors.n
    if not n:
        return None, None, 0
    velocity, position = np.sqrt(squares / n)
    return float(velocity), float(position), n


NAMES = {"hold": "hold the velocity", "paper": "paper's coefficients", "model": "this model"}
"""Predictors that are compared, in the order of drawing."""


def horizon_charts(scores: Sequence[HorizonErrors], paired: Sequence[PairedTest] = ()) -> tuple[Chart, ...]:
    """Velocity and position error over the horizon of the axes that have a model, beside the naive baselines.

    Args:
        scores: As `scores_of` gives them.
        paired: Tests of the model against the baselines, for the band of what cannot be told from it.
    """
    charts = []
    for axis in AXES:
        mine = [score for score in scores if score.axis == axis]
        if any(score.velocity.get("model") is not None for score in mine):
            charts.append(_horizon_chart(mine, "velocity", *SPEED[axis], _band(mine, paired, "velocity")))
            charts.append(_horizon_chart(mine, "position", *LENGTH[axis], _band(mine, paired, "position")))
    return tuple(charts)


def _band(scores: Sequence[HorizonErrors], paired: Sequence[PairedTest], what: Quantity) -> Array:
    """Half width of the 95 % interval of the difference from the nearest baseline that was tested; NaN without."""
    half = np.full(len(scores), np.nan)
    for test in sorted(paired, key=lambda test: test.second == "paper"):  # the paper's, where there is one, stays
        for i, score in enumerate(scores):
            found = test.axes[score.axis].get(f"{score.horizon:g}", {}).get(what)
            if found and found.pooled and (ends := found.pooled.rmse_ci95) is not None:
                half[i] = (ends[1] - ends[0]) / 2
    return half


def _horizon_chart(scores: Sequence[HorizonErrors], what: str, unit: str, factor: float, half: Array) -> Chart:
    """Errors of one axis over the horizon."""
    x = np.array([score.horizon for score in scores])
    errors: list[Mapping[str, float | None]] = [getattr(score, what) for score in scores]
    series = {role: factor * np.array([e.get(role) for e in errors], dtype=np.float64) for role in NAMES}  # None: NaN
    positive = {role: np.where(y > 0, y, np.nan) for role, y in series.items()}
    lines = tuple(Line(NAMES[role], role, y) for role, y in positive.items() if np.isfinite(y).any())
    told = "; ".join(f"{line.name} {_listed(x, line.y)} {unit}" for line in lines)
    sides = [positive["model"] + sign * factor * half for sign in (-1, 1)]
    lines += tuple(Line("95 % band", "band", np.where(y > 0, y, np.nan)) for y in sides if np.isfinite(y).any())
    axis = scores[0].axis
    return Chart(
        kind=f"horizon_{what}",
        axis=axis,
        title=f"{axis}: {what} error",
        x_label="horizon [s]",
        y_label=f"RMSE [{unit}]",
        x=x,
        lines=lines,
        reading="Lower is better: the gap to the dotted line is what the model knows beyond 'it keeps its velocity', "
        "and equal gaps are equal factors.",
        summary=f"{what} RMSE of {axis} over {scores[0].n} predictions: {told}.",
        y_log=True,
    )


def _listed(x: Array, y: Array) -> str:
    return ", ".join(f"{value:.3g} at {at:g} s" for at, value in zip(x, y, strict=True) if np.isfinite(value))


def profile_charts(model: Model) -> tuple[Chart, ...]:
    """Profile of the log-likelihood over the delay, with the optima that the search found."""
    return tuple(_profile_chart(name, model.axes[name]) for name in AXES if model.axes[name].profile)


def _profile_chart(name: str, axis: Axis) -> Chart:
    delay, value = (np.array(column, float) for column in zip(*axis.profile, strict=True))
    chosen = next((mode for mode in axis.modes if mode.chosen), None)
    base, starts = chosen.log_likelihood if chosen else 0.0, sum(mode.starts for mode in axis.modes)
    marks = tuple(
        Mark(
            mode.delay,
            mode.log_likelihood - base,
            "chosen" if mode.chosen else "rejected",
            f"delay {mode.delay:.3f} s, damping {mode.damping:.3g} 1/s, {mode.starts} of {starts} starts, "
            f"log-likelihood {mode.log_likelihood - base:+.1f}",
        )
        for mode in axis.modes
    )
    low, high = axis.ci95.get("delay", (None, None))
    fall = axis.profile_fall or FALL
    told = f"delay {axis.predictor.delay:.3f} s, " if axis.predictor else ""
    reached = f"; {chosen.starts} of {starts} starts reached this optimum" if chosen else ""
    others = len(axis.modes) - 1
    reached += f", {others} other{'s' if others > 1 else ''} found" if others > 0 else ", no other was found"
    return Chart(
        kind="profile",
        axis=name,
        title=f"{name}: why this delay",
        x_label="delay [s]",
        y_label="log-likelihood − maximum",
        x=delay,
        lines=(Line("profile likelihood", "model", value),),
        reading="The curve says how well the data agree with each delay when everything else is fitted anew; where it "
        f"stays above the dashed line (−{fall:.2f}) lies the 95 % interval, shaded. Dots are optima that were found; "
        "hollow ones lie beyond the picture.",
        summary=f"{name}: {told}95 % interval {_end(low)} to {_end(high)} s{reached}.",
        marks=marks,
        levels=((-fall, f"−{fall:.2f}"),),
        span=(-np.inf if low is None else low, np.inf if high is None else high),
        y_range=(
            max(-PROFILE_REACH, float(value.min())),
            min(PROFILE_REACH, max([1.5, 1.1 * float(value.max()), *(1.1 * mark.y for mark in marks)])),
        ),
    )


def _end(value: float | None) -> str:
    return "open" if value is None else f"{value:.3f}"


def residual_charts(model: Model, flights: Sequence[Flight]) -> tuple[Chart, ...]:
    """Autocorrelation of the innovations, and their correlation with past commands, with 95 % bands.

    Pooled over the flights that command the axis, with the levels of the disturbance that each flight has; what each
    flight says alone is in `Validation.residuals`.

    Source: see `whiteness`.
    """
    every = [(moved_axes(flight), residuals(model, flight, own_levels=True)) for flight in flights]
    parts = {
        axis: [found[axis].innovations for moved, found in every if axis in moved and axis in found] for axis in AXES
    }
    parts = {axis: [p for p in found if p.time.size >= LEAST_BLOCKS] for axis, found in parts.items()}
    covariances = {axis: coefficient_covariance(model, axis) for axis, found in parts.items() if found}
    white = [_colour_chart(axis, _pooled_lags([autocorrelation(p.time, p.innovation, LAGS) for p in found]))
             for axis, found in parts.items() if found]  # fmt: skip
    free = [_command_chart(axis, _pooled_lags([cross_correlation(p, covariances[axis]) for p in found]))
            for axis, found in parts.items() if found]  # fmt: skip
    return (*white, *free)


def _pooled_lags(parts: Sequence[Correlogram]) -> Correlogram:
    """Mean of correlograms up to the shortest, each weighted by what its bands say it knows."""
    n = min(part.lag.size for part in parts)
    band = np.stack([part.band[:n] for part in parts])
    weight = np.divide(1.0, band**2, out=np.zeros_like(band), where=band > 0)
    total = weight.sum(axis=0)
    value = np.sum(weight * [part.value[:n] for part in parts], axis=0)
    lag = np.median([part.lag[:n] for part in parts], axis=0)
    known = total > 0
    return Correlogram(lag[known], value[known] / total[known], 1 / np.sqrt(total[known]))


def _correlogram_chart(axis: str, found: Correlogram, title: str, label: str, reading: str) -> Chart:
    outside, n = int(np.sum(np.abs(found.value) > found.band)), found.lag.size
    size = f"of about ±{float(np.median(found.band)):.3f} " if n else ""
    return Chart(
        kind="correlation",
        axis=axis,
        title=f"{axis}: {title}",
        x_label="lag [s]",
        y_label=label,
        x=found.lag,
        lines=(
            Line(title, "residual", found.value),
            Line("95 % band", "band", found.band),
            Line("95 % band", "band", -found.band),
        ),
        reading=reading,
        summary=f"{axis}: {outside} of {n} lags lie outside the 95 % band {size}({0.05 * n:.0f} expected by chance).",
    )


def _colour_chart(axis: str, found: Correlogram) -> Chart:
    reading = (
        "Bars inside the band: the model has used up what the past can tell. Bars that stand out: something regular is "
        "left, and the table says by how much the stated intervals are then too narrow."
    )
    return _correlogram_chart(axis, found, "what the residuals say", "autocorrelation", reading)


def _command_chart(axis: str, found: Correlogram) -> Chart:
    reading = (
        "Residuals against commands from before them: bars that stand out mean that the model leaves out part of the "
        "answer. Commands from after them are not asked, for a controller answers residuals."
    )
    return _correlogram_chart(axis, found, "residuals and past commands", "correlation", reading)
