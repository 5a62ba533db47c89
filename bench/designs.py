"""Simulated flights for the coverage benchmark: drawn by Latin hypercube, flown by the paper's vehicle.

The estimator knows nothing of this. The Cramer-Rao bound of a flight follows from the likelihood's information at the
truth.
"""

import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import qmc

from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES, Array
from rotorfit.core.model import COEFFICIENTS
from rotorfit.estimation.likelihood.axis_estimate import free_of
from rotorfit.estimation.likelihood.blocks import record
from rotorfit.estimation.likelihood.likelihood import inverted, score
from rotorfit.estimation.likelihood.parameters import Point
from rotorfit.files.cards import load_card
from rotorfit.flights.assemble import flight_from_log
from rotorfit.simulation.paper_vehicle import STABLE, Controller, Truth, as_log, simulate_flight

DURATION = 60.0
WEAK_DURATION = 20.0

CONTROLLER = Controller(stiffness=0.6, damping=1.0)
"""Stable with every set at delays to 0.3 s; it sees the measured pose, stale frames included."""

TRIM = (0.05, -0.05, 0.03, 0.02)
YAW_WIND = 0.4
"""Wind of yaw [rad/s^2] per wind of x, y, z [m/s^2]; an eighth of it where the heading is to be held."""

EXCITED = {"input": 0.05, "damping": 0.10, "delay": 0.03}
"""Cramer-Rao bounds on the standard errors (shares of the value; the delay in s) below which an axis is well excited.

A property of the truth, so that an estimate cannot talk itself into the other table.
"""


@dataclass(frozen=True)
class Design:
    """One simulated flight before it is flown.

    Attributes:
        seed: Of everything random about it.
        name: Of the published set.
        truth: Vehicle, air and room.
        pace: Mean time between steps of a command [s].
        turning: Whether yaw is steered at will; else it shakes about a held heading.
        duration: [s].
        closed: Whether a controller flies on the measured pose.
    """

    seed: int
    name: str
    truth: Truth
    pace: float
    turning: bool
    duration: float
    closed: bool


def designs(count: int, closed: bool, weak: bool = False, seed: int = 0) -> list[Design]:
    """Draws flights by Latin hypercube.

    Over the sets, delays of 0 to 0.3 s on each axis, mocap noise of 0.1 to 5 mm (and mrad), wind of 0.01 to 0.2 m/s^2
    with a memory of 0.5 to 3 s, steps every 0.4 to 1.2 s, and half the flights turning. Weak flights are all of set E
    with 5 mm, 0.2 m/s^2, 20 s, and half the delays are 0.
    """
    first = 1_000_000 * (2 * int(weak) + int(closed) + 4 * seed)
    draws = qmc.LatinHypercube(10, seed=first).random(count)
    return [_design(first + i, u, closed, weak) for i, u in enumerate(draws)]


def _design(seed: int, u: Array, closed: bool, weak: bool) -> Design:
    name = "E" if weak else tuple(STABLE)[min(int(5 * u[0]), 4)]
    delay = 0.3 * u[1:5]
    if weak:
        delay = np.where(delay < 0.15, 0.0, delay)
    noise = 5e-3 if weak else 1e-4 * 50 ** u[5]
    wind = 0.2 if weak else 0.01 * 20 ** u[6]
    turning = bool(u[8] > 0.5)
    truth = Truth(
        gamma=STABLE[name],
        delay=tuple(float(d) for d in delay),  # type: ignore[arg-type]
        trim=TRIM,
        wind_sigma=(wind, wind, wind, YAW_WIND * wind * (1.0 if turning else 0.125)),
        wind_time=(0.5 * 6 ** u[7],) * 4,
        mocap_noise=(noise,) * 4,
    )
    return Design(seed, name, truth, 0.4 * 3 ** u[9], turning, WEAK_DURATION if weak else DURATION, closed)


def flown(design: Design) -> Flight:
    """The flight as it comes back from its log."""
    controller = CONTROLLER if design.closed else None
    excitation = functools.partial(random_steps, design=design)
    flight = simulate_flight(design.truth, excitation, design.duration, design.seed, controller=controller)
    return flight_from_log(as_log(flight), load_card("rotorfit-demo"))


def random_steps(time: Array, design: Design) -> Array:
    """Commands -1, 0 or 1 times an amplitude, changing at random times; where the heading is held, yaw gets doublets.

    The amplitude accelerates x and y by 1.2 m/s^2 where a command of 1 allows it, and z and yaw by half of what their
    damping takes away at 1.2 m/s and 1 rad/s.
    """
    rng = np.random.default_rng(design.seed)
    number = int(2 * design.duration / design.pace) + 2
    amplitude = _amplitude(design)
    level = rng.integers(-1, 2, (number, 4)) * amplitude
    switch = np.cumsum(design.pace * (0.5 + rng.random((number, 4))), axis=0)
    command = np.stack([level[np.minimum(np.searchsorted(switch[:, a], time), number - 1), a] for a in range(4)], -1)
    if not design.turning:
        middle = switch[:-1, 3] + np.diff(switch[:, 3]) / 2
        at = np.sort(np.concatenate([switch[:-1, 3], middle]))
        side = amplitude[3] * np.where(rng.random(number - 1) > 0.5, 1.0, -1.0)
        values = np.stack([side, -side], axis=1).ravel()
        place = np.searchsorted(at, time, side="right") - 1
        command[:, 3] = np.where(place >= 0, values[np.maximum(place, 0)], 0.0)
    return command


def _amplitude(design: Design) -> Array:
    gain, damping = np.array(design.truth.gamma[::2]), np.array(design.truth.gamma[1::2])
    acceleration = np.array([1.2, 1.2, 0.6 * damping[2], max(0.5 * damping[3], 1.0)])
    if not design.turning:
        acceleration[3] = 0.125 * damping[3] / max(design.pace, 0.5)
    return np.minimum(acceleration / gain, 1.0)


def truth_of(design: Design, axis: str) -> Array:
    """Input, damping and delay of an axis."""
    k = AXES.index(axis)
    return np.array([design.truth.gamma[2 * k], design.truth.gamma[2 * k + 1], design.truth.delay[k]])


def bounds(design: Design, flight: Flight) -> dict[str, Array]:
    """Cramer-Rao bounds on the standard errors of input, damping and delay, the disturbance's levels being known."""
    plane = record(flight, ("x", "y"))
    assert plane is not None
    groups: Sequence[tuple[str, ...]] = (
        (("x",), ("y",), ("z",), ("yaw",)) if plane.held else (("x", "y"), ("z",), ("yaw",))
    )
    return {axis: bound for group in groups for axis, bound in _bounds(design, flight, group).items()}


def _bounds(design: Design, flight: Flight, group: tuple[str, ...]) -> dict[str, Array]:
    rec, K = record(flight, group), len(group)
    assert rec is not None
    places = [AXES.index(axis) for axis in group]
    gain, damping, delay = np.array([truth_of(design, axis) for axis in group]).T
    rate = 1 / np.array(design.truth.wind_time)[places]
    power = 2 * np.array(design.truth.wind_sigma)[places] ** 2 * rate
    noise = np.array(design.truth.mocap_noise)[places] ** 2
    levels = np.stack([power, noise, damping + rate, 4 * damping * rate / (damping + rate) ** 2], axis=1)
    point = Point(gain, np.log(damping), delay, np.zeros((1, K)), np.zeros((rec.starts.size, K)), np.log(levels))
    # The damping is told by the speed at the start, too. The position is linear in that speed: one step finds it.
    at_rest, start = score([rec], point), slice(point.n - point.start.size, point.n)
    speed = np.linalg.solve(at_rest.information[start, start], at_rest.gradient[start])
    point = replace(point, start=speed.reshape(point.start.shape))
    information = score([rec], point).information[: point.n, : point.n]
    errors = np.sqrt(np.diag(inverted(information, free_of([rec], [True] * K)[: point.n])))[: 3 * K].reshape(3, K)
    errors[1] *= damping
    return dict(zip(group, errors.T, strict=True))


def well_excited(truth: Array, bound: Array) -> bool:
    """Whether the flight can tell all three coefficients of an axis well."""
    scale = np.array([truth[0], truth[1], 1.0])
    return bool(np.all(bound < scale * np.array([EXCITED[name] for name in COEFFICIENTS])))
