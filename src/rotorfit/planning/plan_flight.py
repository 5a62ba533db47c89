"""Planning: card, space, design, axes, duration and belief -> Plan that stays in its space, with its predictions."""

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from rotorfit.core.card import Card
from rotorfit.core.errors import PlanError
from rotorfit.core.flight_plan import AxisExcitation, Feedback, Plan, Signal, Space
from rotorfit.core.frames import AXES, Array
from rotorfit.core.progress import Progress, part_of
from rotorfit.planning.belief import Belief, belief_from_mapping, belief_mapping
from rotorfit.planning.envelope import (
    ALLOWED,
    Envelope,
    braking_amplitude,
    fleet_of,
    judged_amplitude,
    judges_of,
    largest_amplitudes,
    predicted_path,
    refuse_if_outside,
    with_amplitudes,
)
from rotorfit.planning.optimal import AxisLimits, optimal_excitations
from rotorfit.planning.plan_control import full_scale
from rotorfit.planning.precision import Precision, excited_axes, informations, precision_of
from rotorfit.planning.signals import DESIGNS, all_odd, crest_factor, designed, ident_reference, paper_sines, scaled
from rotorfit.simulation.paper_vehicle import Draw

RATE, RAMP, QUIET = 50.0, 2.0, 1.0
"""Command rate [Hz]; ramp of the signals [s]; hover before and after them [s]."""

SHORTEST = 10.0
"""Shortest plan [s]: the estimator needs 0.7 s at its ends, ramps and hover take 6 s."""

SHARE_OF_SCALE = 0.8
"""Largest command of a signal, as a share of full scale: the rest is left for the feedback."""

LARGEST = (3.0, 3.0, 3.0, 4.0)
"""Largest acceleration demanded by a signal [m/s^2, rad/s^2]: a tilt of 17 degrees, where the tangent is still within
3 % of linear."""

BRIEF = 10.0
"""Damping above which an axis accelerates so briefly that `LARGEST` limits its change of velocity in 0.1 s [1/s]."""

FAST, FASTEST, SLOWEST = 0.7, 5.0, 2.5
"""The band ends at 0.7 over the delay, within these bounds [rad/s].

Faster signals would carry more information about the model's vehicle, but mislead for a real one: what the model calls
a delay is in part an attitude loop, which follows slow commands fully but not fast ones.
"""

HARD = ("doublets", "3211", "prbs")
"""Designs with hard steps, whose harmonics exceed any band."""

HARD_NOTE = (
    "hard steps: a vehicle whose tilt or speed lags behind its command follows their fast part less, and a law "
    "without that lag takes this for a smaller input gain; multisine, chirp and optimal have no such part"
)

MIXED_NOTE = (
    "{axes} together in so short a flight: what tilt and thrust move together falls on the frequencies of y, and may "
    "bias its damping; fly longer, or fewer axes at once"
)

CENTRING = Feedback(AXES, (0.3, 0.3, 0.6, 0.6), (0.5, 0.5, 1.0, 1.0))
"""Soft feedback on excited axes."""

IDENT = Feedback(AXES, (1.33, 1.40, 3.50, 1.75), (1.50, 1.50, 2.00, 2.00))
"""Gains of the tracking controller of the ident manoeuvre.

Source: jrsbenevides/drone_dev, config/bebopParameters.yaml, KpFL and KdFL of its feedback linearisation.
"""

RESERVE = 0.85
"""Share of the space that an optimal design uses with the likeliest vehicle: the rest allows for its uncertainty."""

YAW_REACH, YAW_RATE = np.pi / 2, 1.5
"""Largest angle and rate of an optimal design on yaw [rad, rad/s]."""

OPTIMAL: Mapping[str, Literal["d", "a"]] = {"optimal": "d", "optimal_a": "a"}
"""Designs found by a search, with their criterion, see `optimal`."""

DRIFT_SHARE = 0.25
"""Share of the way to the nearest wall above which a drifting hover is centred by feedback, even while excited."""

TELLING = 0.3
"""Drift of an open loop above which it is noted [m]."""

TOGETHER = (("x", "y"), ("z",), ("yaw",))
"""Axes that the paper flies together. Source: paper, section 4."""


def plan_flight(
    card: Card,
    space: Space,
    design: str,
    axes: Sequence[str],
    duration: float,
    belief: Belief,
    *,
    amplitude: float | None = None,
    open_loop: bool = False,
    seed: int = 0,
    progress: Progress | None = None,
) -> Plan:
    """Plans one flight.

    The signals are as large as full scale and the space allow: 19 of 20 possible vehicles stay inside. Where a hover
    would drift by more than a quarter of the way to a wall, a soft centring feedback is added; this depends on the
    belief, the space and the duration alone. Axes that are not flown are held.

    Args:
        card: Card of the vehicle: meaning and limits of its commands.
        space: Fence, limits and start.
        design: One of `signals.DESIGNS`.
        axes: Axes that are excited, together.
        duration: Duration of the whole plan [s].
        belief: Belief about the vehicle, its air and its room.
        amplitude: Factor on the full amplitude of the design, for all axes; None for as large as fits, at most 1.
        open_loop: No feedback at all.
        seed: Seed of sequences, and of the vehicles and winds of the prediction.
        progress: Called with a fraction and a text; raising in it cancels.

    Returns:
        The plan with its prediction.

    Raises:
        PlanError: A design, axis, duration or amplitude that cannot be flown; with a given amplitude, a plan that
            leaves the space; without, no amplitude that stays inside.
    """
    return plan_with_information(
        card, space, design, axes, duration, belief,
        amplitude=amplitude, open_loop=open_loop, seed=seed, progress=progress,
    )[0]  # fmt: skip


@dataclass(frozen=True)
class Fleets:
    """The vehicles that fly plans of one belief, duration [s] and seed, drawn when they are first needed."""

    belief: Belief
    duration: float
    seed: int

    @functools.cached_property
    def search(self) -> tuple[Draw, ...]:
        """Those that fly every plan on the way."""
        return fleet_of(self.belief, RATE, self.duration, seed=self.seed)

    @functools.cached_property
    def judges(self) -> tuple[Draw, ...]:
        """Those by which a plan is judged."""
        return judges_of(self.belief, RATE, self.duration, self.seed)


def plan_with_information(
    card: Card,
    space: Space,
    design: str,
    axes: Sequence[str],
    duration: float,
    belief: Belief,
    *,
    amplitude: float | None = None,
    open_loop: bool = False,
    seed: int = 0,
    fleets: Fleets | None = None,
    progress: Progress | None = None,
) -> tuple[Plan, Array]:
    """As `plan_flight`, with the information from which its standard errors are predicted, as of `informations`.

    `fleets` may be those of another plan with the same belief, as its file holds it, duration and seed.
    """
    _check_request(card, space, design, axes, duration, amplitude)
    if open_loop and design == "ident":
        raise PlanError("the ident manoeuvre is a position reference and needs its feedback: drop --open-loop")
    belief = belief_from_mapping(belief_mapping(belief), f"plan on {', '.join(axes)}")  # as its file will hold it
    wanted = _Wanted(
        card, space, design, tuple(axis for axis in AXES if axis in axes), duration, belief, amplitude, seed,
        fleets or Fleets(belief, duration, seed),
    )  # fmt: skip
    loop, notes = _loop(wanted, open_loop)
    choice = _choice(wanted, loop, part_of(progress, 0, 2))
    return _finished(choice, wanted, notes, part_of(progress, 1, 2))


@dataclass(frozen=True)
class _Wanted:
    """Arguments of `plan_flight`."""

    card: Card
    space: Space
    design: str
    axes: tuple[str, ...]
    duration: float
    belief: Belief
    amplitude: float | None
    seed: int
    fleets: Fleets


@dataclass(frozen=True)
class _Choice:
    """A plan with one of the possible loops, and the factor of each axis on its full amplitude; 0 if none fits."""

    plan: Plan
    factors: Mapping[str, float]


def _loop(wanted: _Wanted, open_loop: bool) -> tuple[Feedback | None, list[str]]:
    """The feedback, and the notes on it.

    It depends neither on the signals nor on the seed of the plan, so that equal requests always get the same loop.
    """
    if wanted.design == "ident":
        return replace(IDENT, axes=tuple(wanted.card.command)), []
    held = tuple(axis for axis in AXES if axis not in wanted.axes and axis in wanted.card.command)
    bare = Feedback(held) if held and not open_loop else None
    axis, metres, share = _drift(wanted, bare)
    drifts = f"a hover drifts up to {metres:.1f} m off along {axis}"
    if share > DRIFT_SHARE and not open_loop:
        return replace(CENTRING, axes=tuple(wanted.card.command)), [
            f"soft feedback centres the excited axes: without it {drifts}"
        ]
    if metres > TELLING:
        return bare, [f"nothing centres the excited axes: {drifts} within {wanted.duration:g} s, 2.5 % of them further"]
    return bare, []


def _drift(wanted: _Wanted, bare: Feedback | None) -> tuple[str, float, float]:
    """Drift of a hover, for 95 % of the vehicles, on the axes that nothing centres.

    Returns:
        The axis on which it is the largest share of the way to the nearest wall, the drift [m], and that share.
    """
    hover = Plan(
        "hover", wanted.design, wanted.card.raw, RATE, wanted.duration, RAMP, (), bare, wanted.space,
        belief_mapping(wanted.belief),
    )  # fmt: skip
    usual = wanted.fleets if wanted.seed == 0 else Fleets(wanted.belief, wanted.duration, 0)
    extent, space, worst = predicted_path(hover, usual.search).extent, wanted.space, ("x", 0.0, 0.0)
    for a, axis in enumerate(AXES[:3]):
        if bare is None or axis not in bare.axes:
            metres = float(max(space.start[a] - extent[0, a], extent[1, a] - space.start[a]))
            share = metres / min(space.start[a] - space.lower[a], space.upper[a] - space.start[a])
            worst = max(worst, (axis, metres, share), key=lambda each: each[2])
    return worst


def _choice(wanted: _Wanted, loop: Feedback | None, progress: Progress | None) -> _Choice:
    """The plan with a loop, at the requested amplitude or at the largest that fits."""
    belief, length = wanted.belief, wanted.duration - 2 * QUIET
    plan = Plan(
        f"{wanted.design} on {', '.join(wanted.axes)}", wanted.design, wanted.card.raw, RATE, wanted.duration,
        0.0 if wanted.design in OPTIMAL else RAMP, (), loop, wanted.space, belief_mapping(belief), seed=wanted.seed,
    )  # fmt: skip
    if wanted.design in OPTIMAL:
        hover = predicted_path(plan, wanted.fleets.search)
        if not hover.fits:
            return _Choice(plan, dict.fromkeys(wanted.axes, 0.0))
        limits, criterion = _limits(wanted, hover), OPTIMAL[wanted.design]
        smooth = {axis: 2 * np.pi / fastest(belief, axis) for axis in wanted.axes}
        excitations = optimal_excitations(
            belief, limits, QUIET, length, loop, criterion, wanted.seed, part_of(progress, 0, 2), smooth
        )
        progress = part_of(progress, 1, 2)
    else:
        excitations = _ident(wanted.axes, length) if wanted.design == "ident" else _classic(wanted, length)
    plan = replace(plan, excitations=excitations)
    if wanted.amplitude is not None:
        factors = dict.fromkeys(wanted.axes, wanted.amplitude)
    else:
        factors = largest_amplitudes(plan, wanted.fleets.search, progress=progress)
        common = judged_amplitude(with_amplitudes(plan, factors), wanted.fleets.judges)
        factors = {axis: common * factor for axis, factor in factors.items()}
        slower = braking_amplitude(with_amplitudes(plan, factors), wanted.fleets.judges)
        factors = {axis: slower * factor for axis, factor in factors.items()}
    return _Choice(with_amplitudes(plan, factors), factors)


def _limits(wanted: _Wanted, hover: Envelope) -> dict[str, AxisLimits]:
    """Limits for the optimal design of each axis: the space without the drift of a hover, less a reserve."""
    out, space = {}, wanted.space
    for axis in wanted.axes:
        a = AXES.index(axis)
        command = full_amplitude(wanted.card, wanted.belief, axis)
        if axis == "yaw":
            out[axis] = AxisLimits(command, -YAW_REACH, YAW_REACH, YAW_RATE)
            continue
        together = {"x", "y"} <= set(wanted.axes) and axis != "z"
        speed = space.climb if axis == "z" else space.speed / (np.sqrt(2) if together else 1)
        low, high = space.lower[a] - hover.extent[0, a], space.upper[a] - hover.extent[1, a]
        out[axis] = AxisLimits(command, *(float(RESERVE * each) for each in (low, high, speed)))
    return out


def _check_request(
    card: Card, space: Space, design: str, axes: Sequence[str], duration: float, amplitude: float | None
) -> None:
    """Refuses requests that cannot be flown under any belief."""
    if design not in DESIGNS:
        raise PlanError(f"no design {design!r}; designs are {', '.join(DESIGNS)}")
    if card.command_frame != "heading":
        raise PlanError(f"card {card.name}: its commands are in the world frame; plans are for the heading frame only")
    if missing := [axis for axis in axes if axis not in card.command]:
        raise PlanError(f"card {card.name}: it has no command for {', '.join(missing)}; leave it out of --axes")
    if duration < SHORTEST:
        raise PlanError(
            f"a plan of {duration:g} s is too short to identify anything; give --duration {SHORTEST:g} or more"
        )
    if amplitude is not None and not amplitude > 0:
        raise PlanError(f"an amplitude of {amplitude:g} excites nothing; give one above 0")
    inside = all(low < at < high for low, at, high in zip(space.lower, space.start, space.upper, strict=False))
    if not inside:
        raise PlanError(f"the start {space.start[:3]} is not inside the box {space.lower} to {space.upper}")


def _classic(wanted: _Wanted, length: float) -> tuple[AxisExcitation, ...]:
    """The signals of designs with a fixed form, at full amplitude."""
    out = []
    for place, axis in enumerate(wanted.axes):
        scale = full_scale(wanted.card, axis)
        if wanted.design == "two_sines":
            signal: Signal = _within_scale(paper_sines(axis), scale)
        else:
            size = full_amplitude(wanted.card, wanted.belief, axis)
            band = band_of(wanted.belief, wanted.space, axis, size)
            signal = designed(wanted.design, size, length, band, place, len(wanted.axes), wanted.seed)
        out.append(AxisExcitation(axis, "command", QUIET, length, signal))
    return tuple(out)


def _within_scale(signal: Signal, scale: float) -> Signal:
    """Scales sums of sines to full scale: the paper's yaw adds up to 1.2."""
    peak = float(np.sum(np.abs(getattr(signal, "amplitude", 0.0))))
    return scaled(signal, min(1.0, scale / peak))


def _ident(axes: Sequence[str], length: float) -> tuple[AxisExcitation, ...]:
    """x with y, then z, then yaw, one after the other in equal parts, as drone_dev flies them."""
    parts = [tuple(axis for axis in group if axis in axes) for group in TOGETHER]
    parts = [part for part in parts if part]
    share = length / len(parts)
    return tuple(
        AxisExcitation(axis, "position", QUIET + i * share, share, ident_reference(axis))
        for i, part in enumerate(parts)
        for axis in part
    )


def full_amplitude(card: Card, belief: Belief, axis: str) -> float:
    """Largest command of an axis's signal [unit of the card's command]."""
    a = AXES.index(axis)
    gain, damping = np.abs(belief.truth.gamma[2 * a : 2 * a + 2])
    return float(min(SHARE_OF_SCALE * full_scale(card, axis), LARGEST[a] * max(1.0, damping / BRIEF) / gain))


def band_of(belief: Belief, space: Space, axis: str, amplitude: float) -> tuple[float, float]:
    """Lowest and highest useful frequency on an axis [rad/s].

    Fast content, up to `fastest`, determines the delay. Content as slow as the damping determines the damping, but it
    needs space and speed, for which the whole signal would have to shrink: the band begins where a sine of full
    amplitude covers a quarter of the way to the nearest wall, or reaches the speed limit.
    """
    a = AXES.index(axis)
    gain, damping = abs(belief.truth.gamma[2 * a]), belief.truth.gamma[2 * a + 1]
    high = fastest(belief, axis)
    if axis == "yaw":
        reach, speed = YAW_REACH, YAW_RATE
    else:
        reach = min(space.start[a] - space.lower[a], space.upper[a] - space.start[a])
        speed = space.climb if axis == "z" else space.speed
    size = gain * amplitude / (reach / 4)  # w sqrt(w^2 + b^2), where a quarter is covered
    fills = np.sqrt((np.sqrt(damping**4 + 4 * size**2) - damping**2) / 2)
    races = np.sqrt(max((gain * amplitude / speed) ** 2 - damping**2, 0.0))
    return float(min(max(fills, races, damping / 2), high / 3)), high


def fastest(belief: Belief, axis: str) -> float:
    """Highest frequency with substantial content in an axis's signals [rad/s]."""
    return float(np.clip(FAST / max(belief.truth.delay[AXES.index(axis)], 1e-3), SLOWEST, FASTEST))


def _finished(chosen: _Choice, wanted: _Wanted, notes: list[str], progress: Progress | None) -> tuple[Plan, Array]:
    """The plan with its prediction and notes, and the information behind its standard errors.

    Raises:
        PlanError: It leaves its space, or no amplitude stays inside.
    """
    if min(chosen.factors.values()) <= 0:
        raise PlanError(
            f"plan {chosen.plan.name}: no amplitude stays inside for 19 of 20 vehicles that are believed possible, "
            "even the hover drifts out or is too fast; give a larger box, a shorter duration or higher speed limits"
            + ("" if chosen.plan.feedback else ", or let the feedback centre it (without --open-loop)")
        )
    if chosen.plan.design in HARD:
        notes = [HARD_NOTE, *notes]
    mixed = chosen.plan.design == "multisine" and {"y", "z"} < set(wanted.axes)
    if mixed and not all_odd(wanted.duration - 2 * QUIET, len(wanted.axes)):
        notes = [MIXED_NOTE.format(axes=", ".join(wanted.axes)), *notes]
    factors = chosen.factors.values()
    if wanted.amplitude is None and not 0.995 <= min(factors) <= max(factors) <= 1.005:
        sizes = ", ".join(f"{axis} {factor:.2g}" for axis, factor in chosen.factors.items())
        notes = [*notes, f"scaled to fit the space, of full amplitude: {sizes}"]
    envelope = predicted_path(chosen.plan, wanted.fleets.judges, part_of(progress, 0, 2))
    refuse_if_outside(chosen.plan, wanted.fleets.judges, envelope, max(factors))
    information = informations([chosen.plan], wanted.belief, seed=wanted.seed, progress=part_of(progress, 1, 2))
    prediction = prediction_mapping(chosen.plan, envelope, precision_of(information), chosen.factors, notes)
    return replace(chosen.plan, predicted=prediction), information


def prediction_mapping(
    plan: Plan, envelope: Envelope, precision: Precision, factors: Mapping[str, float], notes: Sequence[str]
) -> dict[str, Any]:
    """The predictions of planning, in the plain types of a plan."""
    axes = excited_axes(plan)
    crest = {each.axis: _plain(crest_factor(each.signal, each.duration)) for each in plan.excitations}
    return {
        "stderr": _rounded({axis: precision.stderr[axis] for axis in axes if axis in precision.stderr}),
        "nominal": _rounded({axis: precision.nominal[axis] for axis in axes if axis in precision.nominal}),
        "vehicles": precision.draws,
        "amplitude": {axis: _plain(factor) for axis, factor in factors.items()},
        "crest_factor": crest,
        "extent": {axis: [_plain(end) for end in envelope.extent[:, a]] for a, axis in enumerate(AXES)},
        "speed": dict(zip(("horizontal", "vertical", "yaw"), map(_plain, envelope.speed), strict=True)),
        "speed_high": dict(zip(("horizontal", "vertical", "yaw"), map(_plain, envelope.speed_high), strict=True)),
        "leaving": _plain(envelope.leaving),
        "allowed": ALLOWED,
        "saturated": _plain(envelope.saturated),
        "draws": envelope.draws,
        "notes": list(notes),
    }


def plan_flights(
    card: Card,
    space: Space,
    design: str,
    axes: Sequence[str],
    duration: float,
    belief: Belief,
    *,
    amplitude: float | None = None,
    open_loop: bool = False,
    seed: int = 0,
    progress: Progress | None = None,
) -> list[Plan]:
    """Plans separate flights: x with y, z, yaw, as in the paper; arguments as for `plan_flight`."""
    groups = [group for each in TOGETHER if (group := tuple(axis for axis in each if axis in axes))]
    return [
        plan_flight(
            card, space, design, group, duration, belief,
            amplitude=amplitude, open_loop=open_loop, seed=seed, progress=part_of(progress, i, len(groups)),
        )
        for i, group in enumerate(groups)
    ]  # fmt: skip


def _rounded(table: Mapping[str, Mapping[str, float]]) -> dict[str, dict[str, float]]:
    return {axis: {name: _plain(value) for name, value in row.items()} for axis, row in table.items()}


def _plain(value: float) -> float:
    return float(f"{value:.4g}")
