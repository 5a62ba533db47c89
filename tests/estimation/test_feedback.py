"""Whether a command answers the motion: told in loops, and not of open loops whose commands foretell themselves.

Under the law without a lag: what it leaves out of a real vehicle must not pass for a loop.
"""

from pathlib import Path

import numpy as np
import pytest

from clean_flights import clean_fit, clean_flights
from rotorfit.app.workflows import load_flight
from rotorfit.assessment.advice import findings_of_fit
from rotorfit.core.flight_data import Flight
from rotorfit.core.flight_plan import value
from rotorfit.core.frames import AXES
from rotorfit.core.results import Fit
from rotorfit.estimation.fitting import fit
from rotorfit.estimation.likelihood.feedback import LOOP_SIGMAS, LoopEvidence, loop_evidence
from rotorfit.files.cards import card_from_mapping
from rotorfit.files.log_span import parse_log
from rotorfit.flights.assemble import flight_from_log
from rotorfit.planning.signals import multisine
from rotorfit.simulation.flight_room import Conditions, fly_commands, log_of_room_flight
from rotorfit.simulation.vehicle import load_vehicle


def multisines_of(vehicle: str, jitter: float, seed: int) -> Flight:
    """A minute of multisines on all axes of a full rigid body with an attitude loop, sent in an open loop."""
    flown = load_vehicle(vehicle)
    time = np.arange(0.0, 60.0, 0.02) + jitter * np.random.default_rng(seed).random(3000)
    command = np.stack([value(multisine(0.3, 60.0, (0.8, 6.0), k, 4), time) for k in range(4)], axis=1)
    stamps = np.round(time * 1e9).astype(np.int64)
    log = log_of_room_flight(fly_commands(flown, Conditions(), stamps, command, 60.0, seed, (0.0, 0.0, 5.0, 0.0)))
    return flight_from_log(log, card_from_mapping(flown.card(), "test"))


def sigmas(found: Fit) -> dict[str, float]:
    return {axis: e.loop.sigmas for axis, e in found.estimates.items()}


@pytest.mark.parametrize(("vehicle", "jitter"), [("m100", 0.0), ("crazyflie", 0.004)])
def test_open_loop_multisines_of_a_vehicle_with_an_attitude_loop_are_no_feedback(vehicle: str, jitter: float) -> None:
    found = fit([multisines_of(vehicle, jitter, 1)], structure="first_order_delay")

    assert sorted(sigmas(found)) == sorted(AXES)
    assert max(sigmas(found).values()) < LOOP_SIGMAS
    assert not [one for one in findings_of_fit(found) if one.code == "feedback"]


@pytest.mark.slow
def test_most_loops_that_hold_a_place_are_found_and_no_open_loop_is_taken_for_one() -> None:
    told: dict[bool, list[bool]] = {True: [], False: []}
    for seed, closed, _, _ in clean_flights(range(8)):
        told[closed] += [found > LOOP_SIGMAS for found in sigmas(clean_fit(seed)).values()]

    assert sum(told[False]) == 0
    assert np.mean(told[True]) > 0.5


@pytest.mark.parametrize(("name", "loops"), [("s01", {"y", "z", "yaw"}), ("s02", set())])
def test_a_real_autopilots_loops_are_told_apart_from_its_open_flights(
    real_flights: Path, name: str, loops: set[str]
) -> None:
    flight = load_flight(parse_log(str(real_flights / "arducopter-sitl" / f"{name}.mcap")))

    assert {
        axis for axis, found in sigmas(fit([flight], structure="first_order_delay")).items() if found > LOOP_SIGMAS
    } == loops


def test_poses_that_stand_still_are_no_loop() -> None:
    command = np.random.default_rng(1).normal(size=600)

    assert loop_evidence([(command, np.zeros(600))]) == LoopEvidence(0.0, 1, 0.0)
