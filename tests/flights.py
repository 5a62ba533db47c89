"""Flights for the tests of the estimator: flown in the simulator, read back as a stranger's log is."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from rotorfit.core.flight_data import Flight, Segment
from rotorfit.core.frames import AXES, Array
from rotorfit.core.log import Log
from rotorfit.core.results import Fit
from rotorfit.estimation.fitting import fit
from rotorfit.files.cards import builtin_cards
from rotorfit.flights.assemble import flight_from_log
from rotorfit.planning.signals import two_sines
from rotorfit.simulation.paper_vehicle import Controller, SimulatedFlight, Truth, as_log, noise_free, simulate_flight

Excitation = Callable[[Array], Array]

CARD = builtin_cards()["rotorfit-demo"]
NO_LOG = Log(Path("none"), "simulated", "", {}, {})
"""For checks that look at the flight only."""

STILL = noise_free(Truth())
"""The demo's vehicle without wind, in a room whose mocap errs nowhere."""


def steps(
    axes: Sequence[str] = AXES, amplitude: float | Sequence[float] = 0.2, seed: int = 0, every: float = 0.7
) -> Excitation:
    """Commands that change at random about every `every` s, -1, 0 or 1 times the amplitude; rich in all frequencies."""
    rng = np.random.default_rng(seed)
    level = rng.integers(-1, 2, (400, 4)) * (np.asarray(amplitude) * np.isin(AXES, axes))
    switch = np.cumsum(every * (0.5 + rng.random((400, 4))), axis=0)

    def command(t: Array) -> Array:
        return np.stack([level[np.searchsorted(switch[:, a], t), a] for a in range(4)], axis=-1)

    return command


def recorded(flight: SimulatedFlight, span: tuple[float | None, float | None] = (None, None)) -> Flight:
    """A simulated flight as it comes back from its log."""
    return flight_from_log(as_log(flight), CARD, span)


def flown(
    truth: Truth = STILL,
    excitation: Excitation = two_sines,
    duration: float = 40.0,
    seed: int = 1,
    span: tuple[float | None, float | None] = (None, None),
    controller: Controller | None = None,
    initial_yaw: float = 0.0,
) -> Flight:
    """Simulates a flight and reads it back."""
    return recorded(
        simulate_flight(truth, excitation, duration, seed, controller=controller, initial_yaw=initial_yaw), span
    )


def fit_as_flown(flights: Sequence[Flight], axes: Sequence[str] = AXES) -> Fit:
    """Fits the law that the simulated vehicle obeys: averaging it with others takes up to five times as long."""
    return fit(flights, axes=axes, structure="first_order_delay")


def truth_of(truth: Truth, axis: str) -> dict[str, float]:
    """input, damping and delay of an axis."""
    k = AXES.index(axis)
    return {"input": truth.gamma[2 * k], "damping": truth.gamma[2 * k + 1], "delay": truth.delay[k]}


def by_hand(
    pose_time: Array, pose: Array, command_time: Array, command: Array, segments: Sequence[tuple[float, float]] = ()
) -> Flight:
    """A flight from arrays: poses (N, 4) and commands (M, 4); one segment over all unless told otherwise."""
    parts = tuple(Segment(*part) for part in segments) or (Segment(command_time[0], pose_time[-1]),)
    return Flight(
        path="by hand",
        sha256="0" * 64,
        card=CARD,
        span=(parts[0].start, parts[-1].end),
        axes=AXES,
        command_time=np.ascontiguousarray(command_time, float),  # as a reader's: another layout is compiled anew
        command=np.ascontiguousarray(command, float),
        pose_time=np.ascontiguousarray(pose_time, float),
        position=np.ascontiguousarray(pose[:, :3], dtype=float),
        yaw=np.ascontiguousarray(pose[:, 3], dtype=float),
        segments=parts,
    )


def turned(flight: Flight, angle: float) -> Flight:
    """The same flight in a world turned by an angle [rad]."""
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    return replace(flight, position=flight.position @ turn.T, yaw=flight.yaw + angle)


def muddled(flight: Flight, *axes: str) -> Flight:
    """The flight with commands on these axes that the vehicle never got."""
    command = flight.command.copy()
    for axis in axes:
        k = AXES.index(axis)
        command[:, k] = steps((axis,), float(np.abs(command[:, k]).max()), seed=51)(flight.command_time)[:, k]
    return replace(flight, command=command)
