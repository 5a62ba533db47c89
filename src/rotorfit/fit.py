"""Flights -> Fit: coefficients with intervals, statuses and profiles, by the likelihood or by the paper's method."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from rotorfit.disturbance import LEVELS
from rotorfit.errors import FlightError
from rotorfit.flight import Flight
from rotorfit.frames import AXES, Array
from rotorfit.likelihood import DELAY_RANGE, Optimum, Point, Record, inverted, maximise, record
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
from rotorfit.modes import Found, prediction_error, search, trim_variance, without_input
from rotorfit.profile import ROOT_OF_CHI2, height, hold, interval
from rotorfit.regression import PaperFit, paper_regression

Method = Literal["ml", "paper"]
Progress = Callable[[float, str], None]

LEAST_TIME = 5.0
"""Scored time below which an axis is too short to tell anything [s]."""

EXPLAINS = 0.9
"""The commands must bring the 1 s prediction error on the training flights below this share of what it is without them;
else the axis was not excited, whatever the likelihood of a feedback loop says."""

WIDEST_DAMPING = 10.0
"""Ratio of the ends of the damping's interval beyond which it is not identifiable."""

WIDEST_DELAY = 0.4
"""Width of the delay's interval beyond which it is not identifiable [s]."""

PROFILE_DELAYS = np.linspace(DELAY_RANGE[0], DELAY_RANGE[1], 15)
"""Delays at which the profile is drawn besides those that the interval needed [s]."""


@dataclass(frozen=True)
class Fit:
    """A model and the flights that it was fitted to.

    Attributes:
        model: Coefficients, intervals, statuses.
        flights: In the order of `model.flights`.
        paper: The paper's regression on the same flights.
    """

    model: Model
    flights: tuple[Flight, ...]
    paper: PaperFit


def fit(
    flights: Sequence[Flight], method: Method = "ml", axes: Sequence[str] = AXES, progress: Progress | None = None
) -> Fit:
    """Estimates the coefficients of the axes from one or several flights.

    Args:
        flights: Recorded with one card. An axis is fitted to the flights in which its command moves.
        method: `ml`, the likelihood, or `paper`, the regression of the paper.
        axes: Which axes are wanted.
        progress: Called with a fraction and a text; raising in it cancels.

    Returns:
        The fit. What the data cannot tell is a status, never a number.

    Raises:
        FlightError: If no flight is given, or their cards differ in what the coefficients mean.
    """
    if not flights:
        raise FlightError("no flight to fit: give at least one log")
    wanted = [axis for axis in AXES if axis in axes]
    report = progress or (lambda _fraction, _text: None)
    report(0.0, "the paper's regression")
    paper = paper_regression(flights, AXES)
    results: dict[str, Axis] = {}
    covariances: dict[str, Array] = {}
    groups = _groups(flights, wanted)
    for number, group in enumerate(groups):
        report(0.1 + 0.9 * number / len(groups), f"likelihood of {', '.join(group)}")
        found, covariance = _fit_group(flights, group) if method == "ml" else _paper_group(flights, group, paper)
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
    return Fit(model, tuple(flights), paper)


def _moves(flight: Flight, axis: str) -> bool:
    """Whether the flight commands the axis at all."""
    return axis in flight.axes and bool(np.any(flight.command[:, AXES.index(axis)]))


def _groups(flights: Sequence[Flight], wanted: Sequence[str]) -> list[tuple[str, ...]]:
    """Axes that are fitted together: x and y through the heading, z, yaw; only those that some flight moves.

    x alone (or y alone) is fitted by itself where every flight that moves it keeps its heading.
    """
    moving = [axis for axis in wanted if any(_moves(flight, axis) for flight in flights)]
    plane = tuple(axis for axis in moving if axis in ("x", "y"))
    groups = [(axis,) for axis in moving if axis in ("z", "yaw")]
    if len(plane) == 1:
        records = [record(flight, plane) for flight in flights if _moves(flight, plane[0])]
        plane = plane if all(rec.held for rec in records if rec) else ("x", "y")
    return [plane, *groups] if plane else list(groups)  # type: ignore[list-item]


@dataclass(frozen=True)
class _Explored:
    """What the search says of one axis.

    Attributes:
        found: Optima, the believed one first.
        place: Which column of the optima this axis is.
        explained: Prediction error over that without the command.
    """

    found: tuple[Found, ...]
    place: int
    explained: float


def _fit_group(flights: Sequence[Flight], group: Sequence[str]) -> tuple[dict[str, Axis], dict[tuple[str, ...], Array]]:
    """Axes of one group by the likelihood, and their covariance."""
    serving = [f for f in flights if any(_moves(f, axis) for axis in group) and record(f, group)]
    records = [rec for f in serving if (rec := record(f, group))]
    if sum(float(rec.block_time.size) / 30 for rec in records) < LEAST_TIME:
        return {axis: unknown_axis("too_short") for axis in group}, {}
    moving = [any(_moves(f, axis) for f in serving) for axis in group]
    explored = _explore(serving, records, group, moving)
    excited = np.array([part is not None and part.explained < EXPLAINS for part in explored])
    optimum = _assembled(records, group, explored, excited)
    results, covariance = {}, {}
    for k, axis in enumerate(group):
        part = explored[k]
        if part is None:
            results[axis] = replace(unknown_axis("not_excited"), noise=_noise(optimum, k))
        else:
            results[axis] = _axis(records, optimum, k, part, bool(excited[k]), _places(flights, serving))
    known = [k for k, axis in enumerate(group) if results[axis].predictor]
    if known:
        names = tuple(f"{group[k]}.{name}" for k in known for name in COEFFICIENTS)
        covariance[names] = _covariance(optimum, known)
    return results, covariance


def _explore(
    serving: Sequence[Flight], records: Sequence[Record], group: Sequence[str], moving: Sequence[bool]
) -> list[_Explored | None]:
    """Searches axis by axis where the heading is held, else jointly; None for an axis that no flight moves."""
    if len(group) == 1 or all(rec.held for rec in records):
        out: list[_Explored | None] = []
        for k, axis in enumerate(group):
            if not moving[k]:
                out.append(None)
                continue
            alone = [rec for f in serving if (rec := record(f, (axis,)))]
            found = search(alone, serving, _free(len(alone), [True]))
            idle = prediction_error(serving, (axis,), without_input(alone, found[0].optimum, [0]))
            out.append(_Explored(found, 0, _ratio(found[0].prediction[0], idle[0])))
        return out
    found = search(records, serving, _free(len(records), moving))
    out = []
    for k in range(len(group)):
        if not moving[k]:
            out.append(None)
            continue
        idle = prediction_error(serving, group, without_input(records, found[0].optimum, [k]))
        out.append(_Explored(found, k, _ratio(found[0].prediction[k], idle[k])))
    return out


def _ratio(error: float, idle: float) -> float:
    """Prediction error over that without the command; 0 where the flights are too short to predict."""
    return float(error / idle) if np.isfinite(error) and np.isfinite(idle) and idle > 0 else 0.0


def _free(flights: int, moving: Sequence[bool]) -> Array:
    """Which parameters may move: the coefficients of the moving axes, all trims and levels."""
    K = len(moving)
    return np.concatenate([np.tile(moving, 3), np.ones(flights * K + 4 * K, bool)])


def _assembled(
    records: Sequence[Record], group: Sequence[str], explored: Sequence[_Explored | None], excited: Array
) -> Optimum:
    """The maximum over all axes of the group together, the unexcited ones without input."""
    K, F = len(group), len(records)
    columns: list[tuple[float, float, float, Array, Array]] = []
    for part in explored:
        if part is None:
            columns.append((0.0, 0.0, 0.0, np.zeros(F), np.log([0.1, 1e-7, 0.5, 2.0])))
            continue
        p, k = part.found[0].optimum.point, part.place
        columns.append((float(p.gain[k]), float(p.log_damping[k]), float(p.delay[k]), p.trim[:, k], p.levels[k]))
    gain, log_damping, delay = (np.array([column[i] for column in columns]) for i in range(3))
    point = Point(
        gain=np.where(excited, gain, 0.0),
        log_damping=np.where(excited, log_damping, 0.0),
        delay=np.where(excited, delay, 0.0),
        trim=np.column_stack([column[3] for column in columns]),
        levels=np.stack([column[4] for column in columns]),
    )
    inverse = explored[0].found[0].optimum.inverse if K == 1 and explored[0] and excited[0] else None
    return maximise(records, point, _free(F, excited.tolist()), inverse)


def _places(flights: Sequence[Flight], serving: Sequence[Flight]) -> list[int | None]:
    """Of each flight, its place among those that served; None where it did not."""
    return [next((i for i, s in enumerate(serving) if s is f), None) for f in flights]


def _noise(optimum: Optimum, k: int) -> dict[str, float]:
    """Disturbance levels of an axis, by name."""
    levels = np.exp(optimum.point.levels[k])
    return {name: float(v) for name, v in zip(LEVELS, levels, strict=True)} | {
        "trim_variance": float(trim_variance(optimum)[k])
    }


def _axis(
    records: Sequence[Record],
    optimum: Optimum,
    k: int,
    part: _Explored,
    excited: bool,
    places: Sequence[int | None],
) -> Axis:
    """Everything that is said of one axis."""
    modes = _modes(part)
    trim = tuple(None if place is None else float(optimum.point.trim[place, k]) for place in places)
    if not excited:
        return replace(unknown_axis("not_excited"), noise=_noise(optimum, k), modes=modes, trim=trim)
    if optimum.gain > 0.5:
        return replace(unknown_axis("diverged"), noise=_noise(optimum, k), modes=modes, trim=trim)
    K = optimum.point.gain.size
    variance = np.diag(inverted(optimum.score.information, optimum.free))
    index = {"input": k, "damping": K + k, "delay": 2 * K + k}
    ends: dict[str, Interval] = {}
    profile: list[tuple[float, float]] = []
    for name, i in index.items():
        ends[name], points = interval(records, optimum, i, float(np.sqrt(variance[i])))
        if name == "delay":
            profile = points
    g, b, tau = float(optimum.point.gain[k]), float(np.exp(optimum.point.log_damping[k])), float(optimum.point.delay[k])
    ends["damping"] = _exponential(ends["damping"])
    if _holds_zero(ends["input"]):
        return replace(unknown_axis("not_excited"), noise=_noise(optimum, k), modes=modes, trim=trim)
    status = _status(ends)
    value = {"input": g, "damping": b, "delay": tau}
    error = {name: float(np.sqrt(variance[i])) * (b if name == "damping" else 1.0) for name, i in index.items()}
    published = {name: value[name] if status[name] == "ok" else None for name in COEFFICIENTS}
    return Axis(
        input=published["input"],
        damping=published["damping"],
        delay=published["delay"],
        stderr={name: error[name] if status[name] == "ok" else None for name in COEFFICIENTS},
        ci95=ends,
        status=status,
        trim=trim,
        noise=_noise(optimum, k),
        predictor=Predictor(g, b, tau),
        combinations=_combinations(optimum, k),
        modes=modes,
        profile=_drawn(records, optimum, index["delay"], profile),
    )


def _exponential(ends: Interval) -> Interval:
    low, high = (None if end is None else float(np.exp(end)) for end in ends)
    return low, high


def _holds_zero(ends: Interval) -> bool:
    low, high = ends
    return (low is None or low <= 0) and (high is None or high >= 0)


def _status(ends: Mapping[str, Interval]) -> dict[str, str]:
    """Per coefficient, `ok` or `not_identifiable`, from the intervals alone."""
    low, high = ends["damping"]
    damping = low is not None and high is not None and high / low < WIDEST_DAMPING
    early, late = ends["delay"]
    delay = early is not None and late is not None and late - early < WIDEST_DELAY
    gain = None not in ends["input"]
    return {
        name: "ok" if good else "not_identifiable" for name, good in zip(COEFFICIENTS, (gain, damping, delay), strict=True)
    }


def _combinations(optimum: Optimum, k: int) -> dict[str, Combination]:
    """Steady gain and total lag, with intervals by the delta method (the gain's in its logarithm)."""
    K = optimum.point.gain.size
    at = [k, K + k, 2 * K + k]
    C = inverted(optimum.score.information, optimum.free)[np.ix_(at, at)]
    g, b, tau = float(optimum.point.gain[k]), float(np.exp(optimum.point.log_damping[k])), float(optimum.point.delay[k])
    c = np.array([1 / g, -1.0, 0.0])
    spread = ROOT_OF_CHI2 * float(np.sqrt(c @ C @ c))
    steady = sorted((g / b * float(np.exp(-spread)), g / b * float(np.exp(spread)))) if spread < 2 else (None, None)
    c = np.array([0.0, -1 / b, 1.0])
    lag, half = tau + 1 / b, ROOT_OF_CHI2 * float(np.sqrt(c @ C @ c))
    return {
        "steady_gain": Combination(g / b, (steady[0], steady[1])),
        "total_lag": Combination(lag, (lag - half, lag + half) if half < 2 * lag else (None, None)),
    }


def _covariance(optimum: Optimum, known: Sequence[int]) -> Array:
    """Covariance of (input, damping, delay) of the known axes, from the information."""
    K = optimum.point.gain.size
    at = [offset + k for k in known for offset in (0, K, 2 * K)]
    scale = np.concatenate([[1.0, np.exp(optimum.point.log_damping[k]), 1.0] for k in known])
    C = inverted(optimum.score.information, optimum.free)[np.ix_(at, at)]
    return C * np.outer(scale, scale)  # type: ignore[no-any-return]


def _joined(blocks: Mapping[tuple[str, ...], Array]) -> tuple[tuple[str, ...], Array]:
    """Block diagonal of the groups' covariances."""
    names = tuple(name for block in blocks for name in block)
    matrix = np.zeros((len(names), len(names)))
    at = 0
    for block in blocks.values():
        matrix[at : at + len(block), at : at + len(block)] = block
        at += len(block)
    return names, matrix


def _modes(part: _Explored) -> tuple[Mode, ...]:
    k, best = part.place, max(f.optimum.score.log_likelihood for f in part.found)
    return tuple(
        Mode(
            delay=float(f.optimum.point.delay[k]),
            damping=float(np.exp(f.optimum.point.log_damping[k])),
            input=float(f.optimum.point.gain[k]),
            log_likelihood=f.optimum.score.log_likelihood - best,
            starts=f.starts,
            prediction=float(f.prediction[k]) if np.isfinite(f.prediction[k]) else None,
            chosen=number == 0,
        )
        for number, f in enumerate(part.found)
    )


def _drawn(
    records: Sequence[Record], optimum: Optimum, index: int, points: Sequence[tuple[float, float]]
) -> tuple[tuple[float, float], ...]:
    """The profile over the delay: the interval's points and a walk over the searched range, outwards from the top."""
    best = float(optimum.point.flat()[index])
    out = [(float(x), float(y)) for x, y in points]
    for side in (-1.0, 1.0):
        here = optimum
        for target in sorted((d for d in PROFILE_DELAYS if side * (d - best) > 0), key=lambda d: side * d):
            here = hold(records, here, index, float(target))
            out.append((float(target), height(here) - height(optimum)))
    return tuple(sorted(out))


def _paper_group(
    flights: Sequence[Flight], group: Sequence[str], paper: PaperFit
) -> tuple[dict[str, Axis], dict[tuple[str, ...], Array]]:
    """Axes by the paper's regression; the disturbance levels that prediction needs are settled at its coefficients."""
    results, covariance = {}, {}
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
        ends = {name: (value[name] - ROOT_OF_CHI2 * spread[name], value[name] + ROOT_OF_CHI2 * spread[name]) for name in names}
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
            noise=_levels_at(flights, axis, value["input"], value["damping"]),
            predictor=Predictor(value["input"], value["damping"], 0.0),
        )
        covariance[(f"{axis}.input", f"{axis}.damping")] = paper.covariance[2 * i : 2 * i + 2, 2 * i : 2 * i + 2]
    return results, covariance


def _levels_at(flights: Sequence[Flight], axis: str, gain: float, damping: float) -> dict[str, float]:
    """Disturbance levels of an axis at given coefficients without delay; a damping below the range counts as its end."""
    records = [rec for f in flights if _moves(f, axis) and (rec := record(f, (axis,)))]
    start = Point(
        gain=np.array([gain]),
        log_damping=np.log([max(damping, 1e-3)]),
        delay=np.zeros(1),
        trim=np.zeros((len(records), 1)),
        levels=np.log([[0.1, 1e-7, 0.5, 2.0]]),
    )
    return _noise(maximise(records, start, _free(len(records), [False])), 0)
