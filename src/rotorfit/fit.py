"""Flights -> Fit: coefficients with intervals, statuses and profiles, by the likelihood or a lower rung."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from rotorfit.card import Prior
from rotorfit.errors import CardError, FlightError
from rotorfit.estimate import Estimate, alone, answers_motion, coupled, together
from rotorfit.flight import Flight
from rotorfit.frames import AXES, Array
from rotorfit.likelihood import inverted
from rotorfit.maximum import Optimum
from rotorfit.model import (
    COEFFICIENTS,
    STRUCTURE,
    Axis,
    Combination,
    Interval,
    Mode,
    Model,
    Predictor,
    Source,
    unknown_axis,
)
from rotorfit.modes import SAME_DELAY, SAME_LOG_DAMPING
from rotorfit.physics import with_physics
from rotorfit.prior import gaussian_prior
from rotorfit.profile import height, hold, profile, quantile
from rotorfit.record import DELAY_RANGE, record
from rotorfit.regression import PaperFit, paper_regression
from rotorfit.robust import Outliers, without_outliers
from rotorfit.rungs import axes_by_rung
from rotorfit.settle import noise_of, with_levels

Method = Literal["ml", "robust", "paper", "svf", "weak", "iv", "oe"]
Progress = Callable[[float, str], None]
Blocks = dict[tuple[str, ...], Array]

LEAST_TIME = 5.0
"""Scored time below which an axis is too short to tell anything [s]."""

WIDEST_INPUT = 10.0
"""Ratio of the ends of the input gain's interval beyond which it is not identifiable."""

WIDEST_DAMPING = 6.0
"""Ratio of the ends of the damping's interval beyond which it is not identifiable."""

WIDEST_DELAY = 0.4
"""Width of the delay's interval beyond which it is not identifiable [s]."""

NORMAL = 1.959963984540054
"""97.5 % point of the normal distribution, for the regression's intervals."""

AT_BOUND = 1e-4
"""How close to an end of its range a delay is at it [s]."""

DIVERGED = 0.5
"""Expected gain in log-likelihood of one more step above which the climb has not ended."""

PROFILE_DELAYS = np.linspace(DELAY_RANGE[0], DELAY_RANGE[1], 15)
"""Delays at which the profile is drawn besides those that the interval needed [s]."""


@dataclass(frozen=True)
class Fit:
    """A model and the flights that it was fitted to.

    Attributes:
        model: Coefficients, intervals, statuses.
        flights: In the order of `model.flights`.
        paper: The paper's regression on the same flights.
        estimates: Axis name to the maximum of its likelihood; none for other methods.
        remarks: Axis name to what a rung says of its numbers: why there is none, which instrument, whether it is valid.
        outliers: Poses of each flight that the robust method left out.
    """

    model: Model
    flights: tuple[Flight, ...]
    paper: PaperFit
    estimates: Mapping[str, Estimate] = field(default_factory=dict)
    remarks: Mapping[str, str] = field(default_factory=dict)
    outliers: Outliers = ()


def fit(
    flights: Sequence[Flight],
    method: Method = "ml",
    axes: Sequence[str] = AXES,
    progress: Progress | None = None,
    prior: bool = False,
) -> Fit:
    """Estimates the coefficients of the axes from one or several flights.

    Args:
        flights: Recorded with one card. An axis is fitted to the flights in which its command moves.
        method: `ml`, the likelihood; `robust`, the same without the poses that are not where the vehicle was; `paper`,
            the regression of the paper; or `svf`, `weak`, `iv`, `oe`.
        axes: Which axes are wanted.
        progress: Called with a fraction and a text; raising in it cancels.
        prior: Use the priors of the card.

    Returns:
        The fit. What the data cannot tell is a status, never a number.

    Raises:
        FlightError: If no flight is given, or their cards differ in what the coefficients mean.
        CardError: If priors are wanted that the card does not have, or with the paper's method.
    """
    if not flights:
        raise FlightError("no flight to fit: give at least one log")
    if any(f.card.raw != flights[0].card.raw for f in flights):
        raise FlightError("the logs were read with different cards: fit them apart, or give one --card for all")
    if prior and method not in ("ml", "robust"):
        raise CardError(f"--method {method} takes no prior: leave --prior out, or use --method ml")
    if prior and not flights[0].card.prior:
        raise CardError(
            "the card has no [prior] to use: leave --prior out, or write x = { input = { mean, sd } } there"
        )
    priors = flights[0].card.prior if prior else {}
    wanted = [axis for axis in AXES if axis in axes]
    report = progress or (lambda _fraction, _text: None)
    outliers: Outliers = ()
    if method == "robust":
        report(0.0, "looking for outliers")
        flights, outliers = without_outliers(flights, lambda some: _estimates(some, wanted))
    report(0.0, "the paper's regression")
    paper = paper_regression(flights, wanted)
    results: dict[str, Axis] = {}
    covariances: Blocks = {}
    estimates: dict[str, Estimate] = {}
    remarks: dict[str, str] = {}
    groups = _groups(flights, wanted)
    for number, group in enumerate(groups):
        report(0.1 + 0.9 * number / len(groups), f"likelihood of {', '.join(group)}")
        if method in ("ml", "robust"):
            estimated = _estimate_group(flights, group, priors)
            found, covariance = _group_axes(flights, group, estimated)
            estimates |= estimated
        elif method == "paper":
            found, covariance = _paper_group(flights, group, paper)
        else:
            found, covariance, said = _rung_group(flights, group, method)
            remarks |= said
        results |= {axis: found[axis] for axis in group if axis in wanted}
        covariances |= covariance
    report(1.0, "done")
    names, matrix = _joined({k: v for k, v in covariances.items() if all(n.split(".")[0] in wanted for n in k)})
    model = Model(
        card=flights[0].card,
        structure=STRUCTURE,
        method=method,
        axes={axis: results.get(axis, unknown_axis("not_excited")) for axis in AXES},
        covariance_names=names,
        covariance=matrix,
        paper=tuple(float(g) if np.isfinite(g) else None for g in paper.gamma),
        findings=(),
        flights=tuple(
            Source(f.path, f.sha256, f.span, f.notes, tuple(axis for axis in AXES if _moves(f, axis))) for f in flights
        ),
    )
    estimates = {axis: e for axis, e in estimates.items() if axis in wanted}
    remarks = {axis: remark for axis, remark in remarks.items() if axis in wanted}
    return Fit(with_physics(model), tuple(flights), paper, estimates, remarks, outliers)


def _estimates(flights: Sequence[Flight], wanted: Sequence[str]) -> dict[str, Estimate]:
    """The likelihood of every axis, without intervals."""
    return {a: e for group in _groups(flights, wanted) for a, e in _estimate_group(flights, group, {}).items()}


def _moves(flight: Flight, axis: str) -> bool:
    """Whether the flight commands the axis at all."""
    return axis in flight.axes and bool(np.any(flight.command[:, AXES.index(axis)]))


def _groups(flights: Sequence[Flight], wanted: Sequence[str]) -> list[tuple[str, ...]]:
    """Axes that are fitted together: x and y through the heading, z, yaw; only those that some flight moves.

    x alone (or y alone) is fitted by itself where every flight that moves it keeps its heading.
    """
    moving = [axis for axis in wanted if any(_moves(flight, axis) for flight in flights)]
    plane = tuple(axis for axis in moving if axis in ("x", "y"))
    groups: list[tuple[str, ...]] = [(axis,) for axis in moving if axis in ("z", "yaw")]
    if len(plane) == 1:
        records = [record(flight, plane) for flight in flights if _moves(flight, plane[0])]
        plane = plane if all(rec.held for rec in records if rec) else ("x", "y")
    return [plane, *groups] if plane else groups


def _serving(flights: Sequence[Flight], group: Sequence[str]) -> list[Flight]:
    """The flights that move one of these axes and are long enough to be scored."""
    return [f for f in flights if any(_moves(f, axis) for axis in group) and record(f, group)]


def _estimate_group(
    flights: Sequence[Flight], group: Sequence[str], priors: Mapping[str, Mapping[str, Prior]]
) -> dict[str, Estimate]:
    """The likelihood of the axes of one group; none where the flights are too short."""
    serving = _serving(flights, group)
    records = [rec for f in serving if (rec := record(f, group))]
    if sum(float(np.ptp(rec.block_time)) for rec in records) < LEAST_TIME:
        return {}
    moving = [any(_moves(f, axis) for f in serving) for axis in group]
    if all(rec.held for rec in records):
        estimates = [
            alone(serving, a, moves, gaussian_prior(priors, [a])) for a, moves in zip(group, moving, strict=True)
        ]
        if len(group) == 2:
            estimates = coupled(records, estimates)
    else:
        estimates = together(serving, records, group, moving, gaussian_prior(priors, group))
    return dict(zip(group, estimates, strict=True))


def _group_axes(
    flights: Sequence[Flight], group: Sequence[str], estimates: Mapping[str, Estimate]
) -> tuple[dict[str, Axis], Blocks]:
    """What is said of the axes of one group, and their covariance."""
    if not estimates:
        return {axis: unknown_axis("too_short") for axis in group}, {}
    serving = _serving(flights, group)
    places = [next((i for i, s in enumerate(serving) if s is f), None) for f in flights]
    results = {axis: _axis(estimates[axis], places) for axis in group}
    return results, _covariances(group, [estimates[axis] for axis in group], results)


def with_delay_profiles(fit: Fit) -> Fit:
    """Draws the profile over the whole searched range of delays, besides what the intervals needed of it.

    Everything else is re-maximised at each delay, walking outwards from the top.
    """
    axes = dict(fit.model.axes)
    for name, estimate in fit.estimates.items():
        if axes[name].predictor is None:
            continue
        index = 2 * estimate.optimum.point.gain.size + estimate.place
        best = float(estimate.optimum.point.flat()[index])
        drawn = list(axes[name].profile)
        for side in (-1.0, 1.0):
            here = estimate.optimum
            beyond = PROFILE_DELAYS[side * (PROFILE_DELAYS - best) > 0]
            for target in beyond[np.argsort(side * beyond)]:
                here = hold(estimate.records, here, index, float(target))
                drawn.append((float(target), height(here) - height(estimate.optimum)))
        axes[name] = replace(axes[name], profile=tuple(sorted(drawn)))
    return replace(fit, model=replace(fit.model, axes=axes))


def _axis(estimate: Estimate, places: Sequence[int | None]) -> Axis:
    """Everything that is said of one axis."""
    records, optimum, k = estimate.records, estimate.optimum, estimate.place
    nothing = replace(
        unknown_axis("not_excited" if not estimate.excited else "diverged"),
        noise=noise_of(optimum, k),
        modes=_modes(estimate),
        trim=tuple(None if place is None else float(optimum.point.trim[place, k]) for place in places),
    )
    if not estimate.excited or _unfinished(optimum, k):
        return nothing
    K = optimum.point.gain.size
    variance = np.diag(inverted(optimum.score.information, optimum.free))
    index = {"input": k, "damping": K + k, "delay": 2 * K + k}
    profiles = {name: profile(records, optimum, i) for name, i in index.items()}
    ends: dict[str, Interval] = {name: found.ci95 for name, found in profiles.items()}
    ends["damping"] = _exponential(ends["damping"])
    ends["input"] = _uncut(ends["input"], ends["damping"], float(optimum.point.gain[k]))
    if _holds_zero(ends["input"]):
        return replace(nothing, status=dict.fromkeys(COEFFICIENTS, "not_excited"))
    status = _status(ends)
    if status["delay"] != "ok" and (_at_bound(optimum, k) or answers_motion(records, optimum, k)):
        status = dict.fromkeys(COEFFICIENTS, "not_identifiable")
    point = Predictor(
        input=float(optimum.point.gain[k]),
        damping=float(np.exp(optimum.point.log_damping[k])),
        delay=float(optimum.point.delay[k]),
    )
    error = {n: float(np.sqrt(variance[i])) * (point.damping if n == "damping" else 1.0) for n, i in index.items()}
    published = {name: getattr(point, name) if status[name] == "ok" else None for name in COEFFICIENTS}
    return replace(
        nothing,
        input=published["input"],
        damping=published["damping"],
        delay=published["delay"],
        stderr={name: error[name] if status[name] == "ok" else None for name in COEFFICIENTS},
        ci95=ends,
        status=status,
        predictor=point,
        combinations=_combinations(optimum, k),
        profile=profiles["delay"].points,
        profile_fall=profiles["delay"].fall,
    )


def _unfinished(optimum: Optimum, k: int) -> bool:
    """Whether one more step would still gain, and by moving the coefficients of an axis by more than a thousandth."""
    K, step = optimum.point.gain.size, optimum.inverse @ optimum.score.gradient
    moved = (step[k] / max(abs(optimum.point.gain[k]), 1e-9), step[K + k], step[2 * K + k])
    return bool(optimum.gain > DIVERGED and np.abs(moved).max() > 1e-3)


def _at_bound(optimum: Optimum, k: int) -> bool:
    """Whether the delay ended at an end of its range. There, or unknown in a feedback loop, it takes the rest with it:
    what such a loop leaves is a slow answer to old commands, whatever the vehicle is."""
    return bool(min(abs(optimum.point.delay[k] - end) for end in DELAY_RANGE) < AT_BOUND)


def _uncut(gain: Interval, damping: Interval, value: float) -> Interval:
    """The input gain's interval, open where it only ends because the searched range of the damping does.

    Gain and damping of a fast vehicle grow together, so an open upper end of the one opens the other.
    """
    low, high = gain
    if damping[1] is not None:
        return gain
    return (low, None) if value > 0 else (None, high)


def _exponential(ends: Interval) -> Interval:
    low, high = (None if end is None else float(np.exp(end)) for end in ends)
    return low, high


def _holds_zero(ends: Interval) -> bool:
    """Whether an interval, an open end being infinite, holds 0."""
    low, high = ends
    return (low is None or low <= 0) and (high is None or high >= 0)


def _status(ends: Mapping[str, Interval]) -> dict[str, str]:
    """Per coefficient, `ok` or `not_identifiable`, from the intervals alone.

    Where the searched range cuts the delay off it cuts the damping off too, and the damping's interval is not its own.
    """
    early, late = ends["delay"]
    delay = early is not None and late is not None and late - early < WIDEST_DELAY
    low, high = ends["damping"]
    damping = None not in ends["delay"] and low is not None and high is not None and high / low < WIDEST_DAMPING
    least, most = ends["input"]
    gain = least is not None and most is not None and max(least / most, most / least) < WIDEST_INPUT
    return {
        name: "ok" if good else "not_identifiable"
        for name, good in zip(COEFFICIENTS, (gain, damping, delay), strict=True)
    }


def _combinations(optimum: Optimum, k: int) -> dict[str, Combination]:
    """Steady gain and total lag, with intervals by the delta method (the gain's in its logarithm)."""
    K = optimum.point.gain.size
    C = inverted(optimum.score.information, optimum.free)
    g, b, tau = float(optimum.point.gain[k]), float(np.exp(optimum.point.log_damping[k])), float(optimum.point.delay[k])

    def half_width(gradient: tuple[float, float, float]) -> float:
        c = np.zeros(optimum.point.n)
        c[[k, K + k, 2 * K + k]] = gradient
        return quantile(optimum, c) * float(np.sqrt(c @ C[: c.size, : c.size] @ c))

    spread, half = half_width((1 / g, -1.0, 0.0)), half_width((0.0, -1 / b, 1.0))
    low, high = sorted((g / b * float(np.exp(-spread)), g / b * float(np.exp(spread)))) if spread < 2 else (None, None)
    lag = tau + 1 / b
    return {
        "steady_gain": Combination(g / b, (low, high)),
        "total_lag": Combination(lag, (lag - half, lag + half) if half < 2 * lag else (None, None)),
    }


def _covariances(group: Sequence[str], estimates: Sequence[Estimate], results: Mapping[str, Axis]) -> Blocks:
    """Covariance of (input, damping, delay) of the axes with a predictor, a block for each likelihood."""
    blocks: dict[int, list[int]] = {}
    for number, (axis, estimate) in enumerate(zip(group, estimates, strict=True)):
        if results[axis].predictor:
            blocks.setdefault(id(estimate.optimum), []).append(number)
    out = {}
    for numbers in blocks.values():
        optimum, places = estimates[numbers[0]].optimum, [estimates[n].place for n in numbers]
        K = optimum.point.gain.size
        at = [offset + k for k in places for offset in (0, K, 2 * K)]
        scale = np.concatenate([[1.0, np.exp(optimum.point.log_damping[k]), 1.0] for k in places])
        C = inverted(optimum.score.information, optimum.free)[np.ix_(at, at)]
        out[tuple(f"{group[n]}.{name}" for n in numbers for name in COEFFICIENTS)] = C * np.outer(scale, scale)
    return out


def _joined(blocks: Blocks) -> tuple[tuple[str, ...], Array]:
    """Block diagonal of the groups' covariances."""
    names = tuple(name for block in blocks for name in block)
    matrix = np.zeros((len(names), len(names)))
    at = 0
    for block in blocks.values():
        matrix[at : at + len(block), at : at + len(block)] = block
        at += len(block)
    return names, matrix


def _modes(estimate: Estimate) -> tuple[Mode, ...]:
    """The optima as this axis sees them; where two axes were searched together, those alike on this one are one."""
    k, best = estimate.place, max((f.optimum.score.log_likelihood for f in estimate.found), default=0.0)
    modes: list[Mode] = []
    for number, f in enumerate(estimate.found):
        final = number == 0 and estimate.excited
        point, rmse = (estimate.optimum if final else f.optimum).point, float(f.prediction[k])
        mode = Mode(
            delay=float(point.delay[k]),
            damping=float(np.exp(point.log_damping[k])),
            input=float(point.gain[k]),
            log_likelihood=f.optimum.score.log_likelihood - best,
            starts=f.starts,
            prediction=rmse if np.isfinite(rmse) else None,
            chosen=number == 0,
        )
        alike = next((i for i, other in enumerate(modes) if _alike(mode, other)), None)
        if alike is None:
            modes.append(mode)
        else:
            modes[alike] = replace(modes[alike], starts=modes[alike].starts + mode.starts)
    return tuple(modes)


def _alike(one: Mode, other: Mode) -> bool:
    return abs(one.delay - other.delay) < SAME_DELAY and abs(np.log(one.damping / other.damping)) < SAME_LOG_DAMPING


def _paper_group(flights: Sequence[Flight], group: Sequence[str], paper: PaperFit) -> tuple[dict[str, Axis], Blocks]:
    """Axes by the paper's regression; the disturbance levels that prediction needs are settled at its coefficients."""
    results: dict[str, Axis] = {}
    covariance: Blocks = {}
    for axis in group:
        i = AXES.index(axis)
        if paper.status.get(axis) != "ok":
            results[axis] = unknown_axis(paper.status.get(axis, "not_excited"))
            continue
        g, b = paper.gamma[2 * i : 2 * i + 2]
        error = paper.stderr[2 * i : 2 * i + 2]
        names = ("input", "damping")
        value = dict(zip(names, (float(g), float(b)), strict=True))
        spread = dict(zip(names, (float(e) for e in error), strict=True))
        ends = {name: (value[name] - NORMAL * spread[name], value[name] + NORMAL * spread[name]) for name in names}
        excited = not _holds_zero(ends["input"])
        if not excited:
            results[axis] = unknown_axis("not_excited")
            continue
        results[axis] = Axis(
            input=value["input"],
            damping=value["damping"],
            delay=None,
            stderr={**spread, "delay": None},
            ci95={**ends, "delay": (None, None)},
            status={"input": "ok", "damping": "ok", "delay": "not_identifiable"},
            trim=(None,) * len(flights),
            predictor=Predictor(value["input"], value["damping"], 0.0),
        )
        covariance[(f"{axis}.input", f"{axis}.damping")] = paper.covariance[2 * i : 2 * i + 2, 2 * i : 2 * i + 2]
    serving = [f for f in flights if any(_moves(f, axis) for axis in results if results[axis].predictor)]
    return with_levels(serving, results), covariance


def _rung_group(
    flights: Sequence[Flight], group: Sequence[str], method: str
) -> tuple[dict[str, Axis], Blocks, dict[str, str]]:
    """Axes by a rung between the paper and the likelihood, their covariance, and what it says of its numbers."""
    serving = [f for f in flights if any(_moves(f, axis) for axis in group)]
    found, covariance, remarks = axes_by_rung(serving, group, method)
    places = [next((i for i, s in enumerate(serving) if s is f), None) for f in flights]
    results = {
        axis: replace(known, trim=tuple(None if place is None else known.trim[place] for place in places))
        for axis, known in found.items()
    }
    return results, covariance, remarks
