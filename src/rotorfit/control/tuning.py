"""Tune: from a model to the gains of a controller, as fast as the model's uncertainty allows.

The bandwidth of each axis is the highest at which none of the vehicles drawn from the model's covariance is unstable,
and 95 % of them keep a peak of the sensitivity of at most `PEAK` and a delay margin of at least half the reach of the
loop. A model that is less certain gets slower gains, and one that is too uncertain gets none.
"""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from html import escape

import numpy as np

from rotorfit.control.control_law import KINDS, AxisLaw, Kind, law_of_bandwidth, linear_system
from rotorfit.control.loop_vehicle import LaggedAxis, LoopVehicle, has_own_margins, has_quadratic_drag
from rotorfit.control.margins import Margins, closed_loop, margins
from rotorfit.control.robustness import (
    Doubt,
    Robustness,
    believed_possible,
    doubt,
    highest_peak,
    known_dynamics,
    known_vehicle,
    robustness,
)
from rotorfit.core.display import html_table, interval, number, text_table
from rotorfit.core.errors import ModelError
from rotorfit.core.finding import WRONG_FRAME
from rotorfit.core.frames import AXES, POSE_UNITS
from rotorfit.core.frozen import frozen_axes
from rotorfit.core.laws import FIRST_ORDER_DELAY, structure_named
from rotorfit.core.limits import meaning_of
from rotorfit.core.model import (
    COEFFICIENTS,
    MEND,
    Axis,
    Model,
    first_order,
    pose_rates,
    unknown_why,
)
from rotorfit.core.plain import by_reason, listed
from rotorfit.planning.axis_information import AxisBelief
from rotorfit.planning.belief import DELAY
from rotorfit.planning.plan_control import full_scale

PEAK = 1.7
"""Highest peak of the sensitivity. Source: K. J. Åström, T. Hägglund, Advanced PID Control (2006): between 1.4 for
careful and 2.0 for fast loops. It implies a phase margin of 2 asin(1 / 2 peak) and a gain margin of peak / (peak -
1)."""

DELAY_SHARE = 0.5
"""Least delay margin as a share of the reach of the loop: latency plus delay."""

BANDWIDTHS = (0.1, 15.0, 81)
"""Lowest and highest bandwidth that are tried [rad/s], and the number of them, in geometric steps."""

FILTERS = (0.03, 0.06, 0.12, 0.25)
"""Filter times that are tried, the shortest first [s]."""

RESTLESS = 0.05
"""Largest standard deviation of a command due to the noise of poses, as a share of full scale, for which no longer
filter is tried."""

SLOWED = 2.0
"""Bandwidth that the estimate alone allows, over that of the gains, from which on a note says why they are slow."""

SLOWER = (
    f"the estimate alone would allow {SLOWED:g} times the bandwidth or more: what slows these gains is how little the "
    "axis is known"
)

RATE, LATENCY, DRAWS = 50.0, 0.015, 200
"""Command rate where poses allow it [1/s]; time from the exposure of a pose to the command that uses it [s]; number of
vehicles drawn."""

RATES = (5.0, 500.0)
"""Lowest and highest command rate [1/s]."""

FEWER = 0.9
"""Poses for each command that still count as one for each: at 50 commands a second they are 1 ms older on average."""


@dataclass(frozen=True)
class AxisTuning:
    """Gains of one axis, with their margins.

    Attributes:
        law: The law with the gains.
        bandwidth: w [rad/s].
        margins: Margins around the model's estimate of the vehicle.
        robustness: Margins around the vehicles that the model considers possible.
        noise: Standard deviation of the command due to the noise of poses, in its own unit; None if the model has none.
        full_scale: Largest command, in its own unit; None for commands in SI to which the card gives no limit.
        note: Assumptions and warnings; empty if there are none.
    """

    law: AxisLaw
    bandwidth: float
    margins: Margins
    robustness: Robustness
    noise: float | None
    full_scale: float | None
    note: str

    @property
    def noise_text(self) -> str:
        """The noise of the command in per cent of full scale, or in the command's unit where that is not known."""
        if self.noise is None:
            return "-"
        return f"{self.noise:.2g}" if self.full_scale is None else f"{100 * self.noise / self.full_scale:.1f} %"


@dataclass(frozen=True)
class Tuning:
    """Gains for every axis that a model knows well enough.

    Attributes:
        kind: Design of the laws.
        rate: Command rate [1/s].
        latency: Time from the exposure of a pose to the command that uses it [s].
        axes: Axis name to its gains and margins.
        refused: Axis name to the reason why it has none.
        note: What the poses of the model's flights mean for the rate, if they came less often than commands, and what
            is assumed of the largest commands.
    """

    kind: Kind
    rate: float
    latency: float
    axes: Mapping[str, AxisTuning]
    refused: Mapping[str, str]
    note: str = ""

    def __repr__(self) -> str:
        return "\n".join([text_table(*self._table()), *self._said()])

    def _repr_html_(self) -> str:
        return html_table(*self._table()) + "".join(f"<p>{escape(line)}</p>" for line in self._said())

    def _said(self) -> list[str]:
        return [*([self.note] if self.note else []), *(f"{axis}: {why}" for axis, why in self.refused.items())]

    def _table(self) -> tuple[str, tuple[str, ...], list[tuple[str, ...]]]:
        heads = ("axis", "bandwidth", "stiffness", "rate_gain", "phase margin", "delay margin")
        rows = []
        for axis, one in self.axes.items():
            figures = (one.bandwidth, one.law.stiffness, one.law.rate, math.degrees(one.margins.phase))
            rows.append((axis, *map(number, figures), number(one.margins.delay)))
        loop = f"{self.rate:g} commands a second, each from a fresh pose {self.latency:g} s old"
        return f"Gains by {self.kind}, {loop} [rad/s, 1/s^2, 1/s, deg, s]", heads, rows


def tune(
    model: Model,
    kind: Kind = "predictor",
    *,
    rate: float | None = None,
    latency: float = LATENCY,
    axes: Sequence[str] = AXES,
    peak: float = PEAK,
    draws: int = DRAWS,
    seed: int = 0,
) -> Tuning:
    """Gains from a model, with margins under its covariance.

    Args:
        model: From a fit.
        kind: `predictor`, `lqr` or `linearising`; see `control_law`.
        rate: Command rate, 5 to 500 [1/s], with a fresh pose for each command. None is `rate_of` the model.
        latency: Time from the exposure of a pose to the command that uses it, 0 to 0.5 [s].
        axes: Axes to tune.
        peak: Highest peak of the sensitivity for 95 % of the vehicles drawn, 1.2 to 3.
        draws: Number of vehicles drawn from the covariance, at least 20.
        seed: Seed of the draws.

    Returns:
        The gains of the axes that the model knows well enough, and for each of the others the reason in one line.

    Raises:
        ModelError: No axis can be tuned, or the kind, rate, latency, peak or number of draws is not possible.
    """
    asked, rate = rate is not None, rate_of(model, axes) if rate is None else rate
    _check(kind, rate, latency, peak, draws)
    tuned: dict[str, AxisTuning] = {}
    refused: dict[str, str] = {}
    for axis in (axis for axis in AXES if axis in axes):
        if model.axes[axis].predictor is None:
            refused[axis] = f"the model has no numbers {unknown_why(model, axis)}"
            continue
        if doubts := _untrusted(model, axis):
            refused[axis] = doubts
            continue
        vehicle = known_dynamics(model, axis)
        own = known_vehicle(model, axis)
        possible = doubt(believed_possible(model, axis, draws, seed), 1 / rate, latency, seed)
        found = _fastest(model, axis, kind, vehicle, own, possible, 1 / rate, latency, peak)
        if isinstance(found, str):
            refused[axis] = found
        else:
            tuned[axis] = found
    if not tuned:
        raise ModelError(f"no axis can be tuned: {by_reason(refused)}")
    notes = rate_note(model, rate, asked, axes), _scale_note(model, tuned)
    return Tuning(kind, rate, latency, tuned, refused, "; ".join(filter(None, notes)))


def rate_of(model: Model, axes: Collection[str] = AXES) -> float:
    """The command rate of these axes where none is given [1/s].

    It is `RATE`, or, where they were fewer, that of the fresh poses of the model's flights, to two digits: the margins
    are of a loop with a fresh pose for each command.
    """
    fewest = min(pose_rates(model, axes), default=RATE)
    return RATE if fewest >= FEWER * RATE else max(RATES[0], float(f"{fewest:.2g}"))


def rate_note(model: Model, rate: float, asked: bool, axes: Collection[str] = AXES) -> str:
    """What the poses of the model's flights mean for gains at a command rate [1/s]; empty if nothing.

    Args:
        model: The model.
        rate: The command rate, that of `rate_of` unless it was asked for.
        asked: Whether it was.
        axes: The axes of the gains.
    """
    fewest = min(pose_rates(model, axes), default=math.inf)
    known = f"{float(f'{fewest:.2g}'):g}"  # 100, not 1e+02
    seen = f"the model's flights had {known} fresh poses a second, and the margins are of a loop"
    if fewest < FEWER * rate:
        remedy = f"tune with --rate {known}" if fewest >= RATES[0] else "they do not hold"
        return f"{seen} that gets {rate:g}, one for each command: if yours gets as few as those flights, {remedy}"
    if asked or rate == RATE:
        return ""
    return f"{seen} with as many commands, a fresh pose for each: if yours gets more poses, tune with its --rate"


UNDER_WAY = 50.0
"""Most commands within the latency: the loop has a state for each, and its margins take their cube."""


def _check(kind: Kind, rate: float, latency: float, peak: float, draws: int) -> None:
    if kind not in KINDS:
        raise ModelError(f"no such design: {kind!r}; designs are {', '.join(KINDS)}")
    for what, value, low, high, unit in (
        ("rate", rate, *RATES, " commands a second"),
        ("latency", latency, 0, 0.5, " s"),
        ("largest peak of the sensitivity", peak, 1.2, 3, ""),
    ):
        if not low <= value <= high:
            raise ModelError(f"cannot tune for a {what} of {value:g}{unit}: give {low:g} to {high:g}{unit}")
    if draws < 20:
        raise ModelError(f"cannot tune over {draws} vehicles drawn: give 20 or more")
    if latency * rate > UNDER_WAY:
        raise ModelError(
            f"cannot tune for {latency * rate:.0f} commands under way ({rate:g} a second, {latency:g} s): at most "
            f"{UNDER_WAY:g}; give a lower rate"
        )


def _untrusted(model: Model, axis: str) -> str:
    """Why the numbers of an axis are for no controller, by its findings and its sign; empty if nothing speaks so."""
    for finding in model.findings:
        if finding.axis in (axis, None) and (finding.severity == "error" or finding.code == "delay_negative"):
            return f"{finding.evidence}; {finding.remedy}"
    predictor = model.axes[axis].predictor
    if predictor is not None and predictor.input < 0:
        return f"its input gain is negative; give {axis} of [command] in the card the other sign, and fit again"
    return ""


def _fastest(
    model: Model,
    axis: str,
    kind: Kind,
    vehicle: AxisBelief,
    own: LoopVehicle,
    possible: Doubt,
    period: float,
    latency: float,
    peak: float,
) -> AxisTuning | str:
    """The fastest law that keeps the margins, with the shortest filter that keeps it quiet; or why there is none."""
    quietest, alone = None, doubt([own], period, latency, possible.seed)
    scale = _full_scale(model, axis)
    largest = scale if math.isfinite(scale) else None
    for filter_time in FILTERS:
        for bandwidth in np.geomspace(*BANDWIDTHS[:2], int(BANDWIDTHS[2]))[::-1].tolist():
            law = law_of_bandwidth(kind, vehicle, bandwidth, period, latency, filter_time)
            if known := _kept(law, possible, peak):
                break
        else:
            continue
        noise = _command_noise(model, axis, law, own)
        restless = noise is not None and noise > RESTLESS * (largest or full_scale(model.card, axis))
        faster = law_of_bandwidth(kind, vehicle, SLOWED * bandwidth, period, latency, filter_time)
        slowed = [SLOWER] if bandwidth * SLOWED <= BANDWIDTHS[1] and _kept(faster, alone, peak) else []
        note = "; ".join(filter(None, [_note(model, axis, law), *slowed]))
        quietest = AxisTuning(law, bandwidth, margins(law, own), known, noise, largest, note)
        if not restless:
            break
        told = f"noise of the poses moves the command by {quietest.noise_text}: filter the poses"
        quietest = replace(quietest, note="; ".join(filter(None, (note, told))))
    frozen = axis in frozen_axes(model.findings)
    remedy = MEND if frozen else "fly the next flight (`rotorfit plan --after`) and fit again"
    structure, status = model.axes[axis].structure, model.axes[axis].status
    if isinstance(own, LaggedAxis) and not frozen and all(status[name] == "ok" for name in COEFFICIENTS):
        remedy = (
            f"more flights do not help where its {structure} is known well: gains would be those of the first-order "
            "law; design a controller for the law itself (`rotorfit export --to python-control`)"
        )
    return quietest or (
        f"not even at {BANDWIDTHS[0]:g} rad/s do 95 % of the vehicles that its covariance allows keep a peak of "
        f"{peak:g}: it is too poorly known; {remedy}"
    )


def _kept(law: AxisLaw, possible: Doubt, peak: float) -> Robustness | None:
    """The margins of a law around the possible vehicles; None where too many of them do not keep what is asked for."""
    if highest_peak(law, possible) > peak:
        return None
    known = robustness(law, possible)
    kept = known.unstable == 0 and known.peak <= peak and known.delay >= DELAY_SHARE * law.reach
    return known if kept else None


def _command_noise(model: Model, axis: str, law: AxisLaw, vehicle: LoopVehicle) -> float | None:
    """Standard deviation of the command due to white noise of the poses in the closed loop, in its own unit.

    Source: the stationary covariance X = M X M' + B B' of a stable linear system.
    """
    from scipy.linalg import solve_discrete_lyapunov

    variance = model.axes[axis].noise.get("pose_variance")
    if variance is None:
        return None
    M, states = closed_loop(law, vehicle), 3 if isinstance(vehicle, LaggedAxis) else 2
    B = np.zeros(len(M))
    B[states:] = linear_system(law, len(M) - states - 3)[1]
    command = states + 3
    return float(np.sqrt(variance * solve_discrete_lyapunov(M, np.outer(B, B))[command, command]))


def _full_scale(model: Model, axis: str) -> float:
    """Largest command of an axis; infinite where commands are in SI without a limit, or where nobody tells.

    Where the card does not say what a command means it is a fraction, unless larger ones were flown.
    """
    if meaning_of(model.card, axis).asked is not None:
        return full_scale(model.card, axis)
    flown = [one.commanded[axis] for one in model.flights if axis in one.commanded]
    if not flown:  # by an older version
        return math.inf
    along = math.sqrt(2) if model.card.command_frame == "world" and axis in ("x", "y") else 1.0  # along the heading
    return max(1.0, max(flown) / along)


def _scale_note(model: Model, axes: Mapping[str, AxisTuning]) -> str:
    """What is assumed of the largest commands; empty where the card tells what each of them means."""
    unsaid = [axis for axis in axes if meaning_of(model.card, axis).asked is None]
    cut = {
        axis: "not cut, as the model does not hold what was flown"
        if (largest := axes[axis].full_scale) is None
        else f"cut at +-{largest:.4g}, the largest that was flown"
        if largest > 1
        else "cut at +-1, as fractions are"
        for axis in unsaid
    }
    if not cut:
        return ""
    wanted = f"give {listed(unsaid)} of [command] a full_scale or a unit if that is wrong"
    return f"the card does not say what a full command is: {by_reason(cut)}; {wanted}"


def _note(model: Model, axis: str, law: AxisLaw) -> str:
    """The assumptions and warnings about the gains of an axis."""
    wrong = [one for one in model.findings if one.code in WRONG_FRAME and axis in ("x", "y")]
    notes = [f"made in a wrong frame: {one.evidence}; {one.remedy}" for one in wrong]
    known = model.axes[axis]
    if axis in frozen_axes(model.findings):
        notes.append(MEND)
    structure, beside = structure_named(known.structure), known.plain
    if has_quadratic_drag(structure):
        beside = None
        notes.append(
            f"gains and margins are those of {structure.name} at hover, where it damps least; d, or the integral, "
            "takes up the drag at speed"
        )
    elif structure.limited:
        beside = None
        most = known.extra["acceleration_limit"]
        about = f", about {most:.2g} {POSE_UNITS[axis]}/s^2" if most else ""
        notes.append(f"gains and margins are those of motion that asks for less than the limit{about}")
    elif structure != FIRST_ORDER_DELAY:
        whose = "its own" if has_own_margins(structure) else "not those"
        notes.append(f"gains of the first-order law with a delay, margins {whose} of {structure.name}")
        notes += _beside_the_model(known, law)
    status = beside.status if beside and structure != FIRST_ORDER_DELAY else known.status
    status = {name: "refuted" if known.status[name] == "refuted" else status[name] for name in COEFFICIENTS}
    if unknown := [name for name in COEFFICIENTS[:2] if status[name] != "ok"]:
        said = " and ".join(f"{name} ({status[name].replace('_', ' ')})" for name in unknown)
        notes.append(f"the model does not know {said}: tuned for the values that predict best, with margins for others")
    notes += _denied(known)
    if known.delay is None and f"{axis}.delay" not in model.covariance_names:
        notes.append(
            f"the delay is not known: the law looks ahead by none, its margins are for {DELAY[0]:g} +- {DELAY[1]:g} s"
        )
    if (delay := first_order(model, axis).predictor.delay) < 0:
        notes.append(
            f"the delay of the model is {delay:.2g} s, but no vehicle moves before its command: tuned for none"
        )
    return "; ".join(notes)


def _denied(known: Axis) -> list[str]:
    """What the flights say against the law of an axis: margins are of vehicles that obey it."""
    told = {one.test: one.strength for one in known.evidence}
    if "bound" in told:
        return [
            f"the margins are not those of small motion: {told['bound']}; fit with --structure limited_acceleration, "
            "or flights with commands too small to reach that"
        ]
    return [f"the margins are those of the law, which the flights deny: {why}" for why in list(told.values())[:1]]


def _beside_the_model(known: Axis, law: AxisLaw) -> list[str]:
    """Where the first-order law of the gains lies outside of what the model knows of an axis under its own law.

    Another feed-forward would not help: d, or the integral, takes up whatever input and damping miss, and would work
    against it.
    """
    if law.damping <= 0:
        return []
    steady = law.input / law.damping
    gain, lag = _off(known, "steady_gain", steady), _off(known, "total_lag", law.delay + 1 / law.damping, " s")
    if gain:
        share = known.combinations["steady_gain"].value / steady - 1
        size = f"{100 * abs(share):.0f} % too {'small' if share < 0 else 'large'}"
        gain += f": at a new speed the command is {size} until d, or the integral, has made up for it"
    return [note for note in (gain, lag) if note]


def _off(known: Axis, name: str, value: float, unit: str = "") -> str:
    """A figure of the law of the gains beside the model's own, if it lies outside its interval; else empty."""
    if (own := known.combinations.get(name)) is None:
        return ""
    low, high = own.ci95
    if (low is None or value >= low) and (high is None or value <= high):
        return ""
    told = f"{own.value:.3g}{unit} ({interval(low, high)})"
    return f"the {name.replace('_', ' ')} of that law is {value:.3g}{unit}, of the model {told}"
