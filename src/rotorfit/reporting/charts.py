"""From evidence to small charts: errors over the horizon, profiles of the delay, correlations of the residuals."""

from collections.abc import Mapping, Sequence

import numpy as np

from rotorfit.assessment.rows import LENGTH, SPEED, HorizonErrors
from rotorfit.core.frames import AXES, Array
from rotorfit.core.model import Axis, Model
from rotorfit.core.residuals import Correlogram
from rotorfit.core.results import PairedTest, Quantity
from rotorfit.reporting.views import Chart, Line, Mark

FALL = 1.92
"""Drop of the profile at the ends of an interval: half the 95 % quantile of chi-squared with one degree of freedom."""

PROFILE_REACH = 25.0
"""Range of log-likelihood around its maximum in which a profile is drawn: below, all delays are equally impossible."""

SURELY_HIGHER = 0.1
"""Rise of a profile above the optima that were found from which they are not the highest: less is rounding."""

NAMES = {"hold": "hold the velocity", "paper": "paper's coefficients", "model": "this model"}
"""Predictors that are compared, with their names, in the order of drawing."""

INDISTINGUISHABLE = "not distinguishable at 95 %"
"""Name of the lines between which another predictor's error does not differ significantly from the model's."""

BELOW = 1e3
"""How far below the chart such a line ends that would reach 0, which has no place on a logarithmic scale."""


def horizon_charts(scores: Sequence[HorizonErrors], paired: Sequence[PairedTest] = ()) -> tuple[Chart, ...]:
    """Velocity and position error over the horizon of the axes that have a model, beside the naive baselines.

    Args:
        scores: As `scores_of` gives them.
        paired: Tests of the model against the baselines, for the band of errors that do not differ significantly.
    """
    charts = []
    units: Mapping[Quantity, Mapping[str, tuple[str, float]]] = {"velocity": SPEED, "position": LENGTH}
    for axis in AXES:
        mine = [score for score in scores if score.axis == axis]
        for what, unit in units.items():  # an axis with a velocity alone has no position to predict
            if any(getattr(score, what).get("model") is not None for score in mine):
                charts.append(_horizon_chart(mine, what, *unit[axis], _band(mine, paired, what)))
    return tuple(charts)


def _band(scores: Sequence[HorizonErrors], paired: Sequence[PairedTest], what: Quantity) -> Array:
    """Half width of the 95 % interval of the difference from a baseline, at each horizon; NaN without a test."""
    half = np.full(len(scores), np.nan)
    for test in sorted(paired, key=lambda test: test.second == "paper"):  # the paper's, the last, has precedence
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
    upper, lower = (positive["model"] + sign * factor * half for sign in (1, -1))
    shown = np.concatenate([upper, *(line.y for line in lines)])
    known = shown[np.isfinite(shown)] if lines else np.ones(1)  # where every error is 0 there is nothing to draw
    bottom, top = 0.7 * float(known.min()), 1.4 * float(known.max())
    lower = np.maximum(lower, bottom / BELOW)
    lines += tuple(Line(INDISTINGUISHABLE, "band", y) for y in (lower, upper) if np.isfinite(y).any())
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
        y_range=(bottom, top),  # not stretched by a lower end that comes near 0
        y_log=True,
    )


def _listed(x: Array, y: Array) -> str:
    return ", ".join(
        f"{value:.3g} at {round(float(at), 9) + 0.0:g} s" for at, value in zip(x, y, strict=True) if np.isfinite(value)
    )


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
    rise, found = float(value.max()), max((mode.log_likelihood - base for mode in axis.modes), default=0.0)
    fall = axis.profile_fall or FALL
    told = f"delay {axis.predictor.delay:.3f} s, " if axis.predictor else ""
    reached = f"; {chosen.starts} of {starts} starts reached this optimum" if chosen else ""
    others = len(axis.modes) - 1
    if others > 0:
        reached += f", {others} other{'s' if others > 1 else ''} found"
    if rise > found + SURELY_HIGHER:
        reached += f", but the search missed a better one: at {delay[value.argmax()]:.3f} s the curve is at +{rise:.1f}"
    elif others <= 0:
        reached += ", no other was found"
    return Chart(
        kind="profile",
        axis=name,
        title=f"{name}: why this delay",
        x_label="delay [s]",
        y_label="log-likelihood − chosen",
        x=delay,
        lines=(Line("profile likelihood", "model", value),),
        reading="The curve says how well the data agree with each delay when everything else is fitted anew; where it "
        f"stays above the dashed line (−{fall:.2f}) lies the 95 % interval of this law for these flights alone, if "
        "their stamps are right. The shaded one is the vehicle's: it also covers other laws, how flights differ, and "
        "what stamps leave unknown. Dots are optima that were found; hollow ones lie beyond the picture.",
        summary=f"{name}: {told}95 % interval for the vehicle {_end(low)} to {_end(high)} s{reached}.",
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


def residual_charts(white: Mapping[str, Correlogram], free: Mapping[str, Correlogram]) -> tuple[Chart, ...]:
    """Correlations of the residuals with 95 % bands; see `correlograms`.

    Args:
        white: Axis to the autocorrelation of the residuals.
        free: Axis to the correlation of the residuals with past commands.
    """
    return (
        *(_colour_chart(axis, found) for axis, found in white.items()),
        *(_command_chart(axis, found) for axis, found in free.items()),
    )


def _correlogram_chart(axis: str, found: Correlogram, title: str, label: str, reading: str) -> Chart:
    told = found.band < 1  # no correlation is larger: a wider band says nothing
    n, band = int(told.sum()), np.where(told, found.band, np.nan)
    summary = "not tested: the coefficients are not known well enough"
    if n:
        outside, size = int(np.sum(np.abs(found.value) > band)), float(np.median(band[told]))
        summary = (
            f"{outside} of {n} lags lie outside the 95 % band of about ±{size:.3f} ({0.05 * n:.2g} expected by chance)"
        )
    return Chart(
        kind="correlation",
        axis=axis,
        title=f"{axis}: {title}",
        x_label="lag [s]",
        y_label=label,
        x=found.lag,
        lines=(
            Line(title, "residual", found.value),
            Line("95 % band", "band", band),
            Line("95 % band", "band", -band),
        ),
        reading=reading,
        summary=f"{axis}: {summary}.",
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
