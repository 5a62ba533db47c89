"""Findings that a flight, of a validation or of the fit, and the model do not speak of the same commands.

The velocity along an axis is compared with the response of the model to the command of that axis alone, a straight line
in time removed from both. Under the right card their ratio is positive and within a few times 1, whatever the quality
of the model: in a feedback loop, whose commands oppose the wind, 0.24 has been seen. Units differ by more.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from rotorfit.core.finding import Finding
from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES, Array
from rotorfit.core.model import Model, first_order
from rotorfit.core.plain import listed
from rotorfit.diagnosis.command_response import EXPLAINED, GRID, LEAST_POSES, thinned
from rotorfit.dynamics.first_order_low_pass import first_order_low_pass
from rotorfit.dynamics.kinematics import motion_from_flight
from rotorfit.estimation.likelihood.optima import between

LOOKED = 300.0
"""Time from the start of a flight that is looked at [s]: a card is wrong at once."""

ALIKE = 8.0
"""Largest ratio of a velocity to the model's, or inverse, that is left to the scores."""

BACKWARDS, MOSTLY = 0.3, 0.5
"""Least size of a negative ratio, and least share of the variance that it explains: less may be a loop's own doing."""

UNITS = "per cent, degrees, cm and mm differ by 100, 57.3, 100 and 1000"

FASTEST_POLE = 1e3
"""Damping beyond which a response follows its command at once on the grid [1/s]."""


def findings_of_mismatch(model: Model, flight: Flight) -> Iterator[Finding]:
    """Errors of the data of a flight, and axes that respond backwards or by several times what the model says."""
    wrong = [finding for finding in flight.findings if finding.severity == "error"]
    yield from (replace(each, evidence=f"{each.evidence} ({flight.path})") for each in wrong)
    if wrong:
        return
    for axis, ratio, explained in _ratios(model, beginning(flight)):
        if (ratio < -BACKWARDS and explained > MOSTLY) or (ratio > 0 and not 1 / ALIKE < ratio < ALIKE):
            yield _finding(axis, model, flight, ratio)


def findings_of_left_out(model: Model, flight: Flight) -> Iterator[Finding]:
    """Axes that a flight of the fit only seems to hold, as its commands are in another unit than those of the others.

    Args:
        model: The fitted model.
        flight: A flight of the fit; the axes that were taken from it are looked at.
    """
    for axis, ratio, explained in _ratios(model, beginning(replace(flight, axes=flight.held)), beside=flight.axes):
        if explained > MOSTLY and ratio > ALIKE:
            fitted = listed([one.path for one in model.flights if axis in one.axes])
            yield Finding(
                "card_differs",
                "error",
                f"a command of {axis} moves {flight.path} {ratio:.3g} times as far as {fitted}: the one or the other "
                "is in another unit",
                f"{axis} was fitted to {fitted} alone, beside which the commands of the other seem to hold it: the "
                "coefficients are per unit of that",
                f"look at {axis} of the commands of both; one card serves all flights of a fit, so that one log has to "
                f"be left out or written anew: {UNITS}",
                axis,
            )


def beginning(flight: Flight) -> Flight:
    """The part of a flight that is looked at."""
    start, end = flight.segments[0].start, flight.segments[-1].end
    return flight if end - start <= LOOKED else between(flight, start, start + LOOKED)


def _ratios(model: Model, flight: Flight, beside: Sequence[str] = ()) -> Iterator[tuple[str, float, float]]:
    """Of each axis that answers: the ratio of its velocity to the model's, and the share of its variance explained.

    What the commands of the axes `beside` explain of either, as by coupling or by a stick that is not held straight, is
    taken from both.
    """
    motion = motion_from_flight(flight)
    if len(motion.time) < LEAST_POSES:
        return
    motion = thinned(motion, flight.duration)
    line = np.linalg.qr(np.column_stack([np.ones_like(motion.time), motion.time - motion.time.mean()]))[0]
    for axis in flight.axes:
        if model.axes[axis].predictor is None or not np.ptp(flight.command[:, AXES.index(axis)]) > 0:
            continue
        others = [_response(model, flight, axis, motion.time, other) for other in beside]
        known = np.linalg.qr(np.column_stack([line, *others]))[0] if others else line
        seen, expected = (
            one - known @ (known.T @ one)
            for one in (motion.velocity[:, AXES.index(axis)], _response(model, flight, axis, motion.time, axis))
        )
        along, size = float(seen @ expected), float(expected @ expected)
        if size == 0 or along**2 <= EXPLAINED * size * float(seen @ seen):  # equal where a coordinate stands still
            continue
        yield axis, along / size, along**2 / (size * float(seen @ seen))


def _response(model: Model, flight: Flight, axis: str, time: Array, commanded: str) -> Array:
    """Velocity that the first-order law of an axis gives to the command of one axis, at some times, shape (N,)."""
    point = first_order(model, axis).predictor
    grid = np.arange(flight.command_time[0], flight.command_time[-1] + GRID, GRID)
    held = flight.command[np.searchsorted(flight.command_time, grid + 1e-9, side="right") - 1, AXES.index(commanded)]
    damping = min(max(point.damping, 1e-2), FASTEST_POLE)
    smooth = first_order_low_pass(held[:, None], float(np.exp(-GRID * damping)))[:, 0]
    return np.asarray(point.input / damping * np.interp(time - point.delay, grid, smooth))


def _finding(axis: str, model: Model, flight: Flight, ratio: float) -> Finding:
    backwards = ratio < 0
    own, fitted = (card.command[axis].scale if axis in card.command else 1.0 for card in (flight.card, model.card))
    sign = (
        f"give {axis} in [command] scale = {-own:g} for this flight: its log has the other sign than those of the fit"
        if own * fitted > 0
        else f"give the {axis} channel of [command] the sign that it has in the card of the fit"
    )
    way = ", backwards" if backwards else ""
    return Finding(
        "card_differs",
        "error",
        f"{axis} moves {ratio:+.3g} times what the model says of its commands{way} ({flight.path})",
        f"the scores of {axis} do not judge the model: this flight was read with another meaning of its commands or "
        "poses than those of the fit, or is of another vehicle",
        sign
        if backwards
        else f"compare units and scales of {axis} in [command] and [pose] with those of the card of the fit: {UNITS}",
        axis,
    )
