"""Axes that are only held: the law of the controller is found, and stamps by which it answers the future."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from clean_flights import clean_flights
from flights import CARD, NO_LOG, fit_as_flown, steps
from rotorfit.app.workflows import load_flights
from rotorfit.assessment.advice import findings_of_fit
from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES
from rotorfit.diagnosis.position_loop import EARLY, restoring_findings, restoring_law
from rotorfit.diagnosis.recording import recording_of
from rotorfit.dynamics.kinematics import motion_from_flight
from rotorfit.estimation.fitting import fit
from rotorfit.files.log_span import parse_log
from rotorfit.flights.assemble import flight_from_log
from rotorfit.simulation.paper_vehicle import Controller, Truth, as_log, simulate_flight


def held(seed: int = 1, **vehicle: object) -> Flight:
    """z is excited, x and y are held by a position controller."""
    truth = replace(Truth(), wind_sigma=(0.05,) * 4, **vehicle)
    flown = simulate_flight(truth, steps(("z",), 0.2), 60.0, seed, controller=Controller())
    return flight_from_log(as_log(flown), CARD)


def late(flight: Flight, by: float) -> Flight:
    """The same with poses that bear later stamps."""
    time = flight.pose_time + by
    there = (time >= flight.span[0]) & (time <= flight.span[1])
    return replace(flight, pose_time=time[there], position=flight.position[there], yaw=flight.yaw[there], velocity=None)


def test_the_law_of_a_controller_is_found_on_axes_that_are_held_and_not_on_one_that_is_excited() -> None:
    flight = held()

    for axis in ("x", "y"):
        law = restoring_law(flight, axis)
        assert law is not None
        assert law.lag < 0  # it answers what it has seen
    assert restoring_law(flight, "z") is None


def test_the_lag_moves_with_the_stamps_and_poses_of_the_future_are_told() -> None:
    flight = held()
    plain = restoring_law(flight, "x")
    shifted = restoring_law(late(flight, 0.137), "x")

    assert plain is not None
    assert shifted is not None
    assert shifted.lag - plain.lag == pytest.approx(0.137, abs=0.025)
    assert not list(restoring_findings(recording_of(NO_LOG, flight)))
    (found,) = restoring_findings(recording_of(NO_LOG, late(flight, 0.137)))
    assert found.code == "answers_before_motion"
    assert found.severity == "warning"


@pytest.mark.parametrize("by", [0.0, 0.05, 0.137, 0.25])
def test_a_loop_that_is_read_backwards_is_never_a_model_however_late_the_poses_are_stamped(by: float) -> None:
    flight = late(held(), by)
    done = fit_as_flown([flight], axes=("x", "y"))

    assert {done.model.axes[axis].status["input"] for axis in ("x", "y")} == {"not_excited"}
    told = findings_of_fit(done)
    assert "sign_flipped" not in {finding.code for finding in told}
    assert all("only a response to the motion" in finding.evidence for finding in told if finding.code == "not_excited")


@pytest.mark.parametrize("method", ["paper", "svf", "weak", "oe"])
def test_no_method_takes_a_position_controller_for_the_vehicle(method: str) -> None:
    done = fit([held()], method, ("x", "z"))

    assert {axis: done.model.axes[axis].status["input"] for axis in "xz"} == {"x": "not_excited", "z": "ok"}
    assert {name.split(".")[0] for name in done.model.covariance_names} == {"z"}
    (told,) = (finding for finding in findings_of_fit(done) if finding.code == "not_excited")
    assert told.axis == "x"
    assert "only a response to the motion" in told.evidence


def test_a_held_axis_whose_commands_are_mostly_noise_of_its_poses_has_no_numbers_by_any_regression() -> None:
    truth = replace(Truth(), wind_sigma=(0.015,) * 4)
    still = simulate_flight(truth, steps(()), 40.0, 0, controller=Controller(2.0, 2.0))
    flight = flight_from_log(as_log(still), CARD)
    assert restoring_law(flight, "yaw") is None

    done = fit([flight], "weak", ("yaw",))

    assert done.model.axes["yaw"].status["input"] == "not_excited"
    assert "not_excited" in {finding.code for finding in findings_of_fit(done)}


def test_a_card_with_a_wrong_sign_is_no_feedback_even_of_a_vehicle_as_quick_as_a_servo() -> None:
    gamma = tuple(value if k % 2 else 12.0 for k, value in enumerate((0, 12.0) * 4))
    flown = simulate_flight(replace(Truth(), gamma=gamma), steps(("x", "y"), 0.3), 60.0, 1)
    flight = flight_from_log(as_log(flown), CARD)
    turned = replace(flight, command=-flight.command)

    assert restoring_law(turned, "x") is None
    done = fit_as_flown([turned], axes=("x",))
    assert {finding.code for finding in findings_of_fit(done)} >= {"sign_flipped"}


def test_clean_flights_are_not_held_in_open_loop_nor_where_a_loop_is_excited() -> None:
    for _, _, _, flight in clean_flights(range(12)):
        motion = motion_from_flight(flight)
        assert not any(restoring_law(flight, axis, motion) for axis in AXES)


@pytest.mark.parametrize(("name", "moved"), [("X", "x"), ("Z", "z")])
def test_on_a_recorded_flight_a_controller_holds_all_axes_but_one_whatever_noise_it_differentiates(
    real_flights: Path, name: str, moved: str
) -> None:
    folder = real_flights / "bebop2-wsu"
    (flight,) = load_flights([parse_log(str(folder / f"Training_CT_TestDay_{name}.mat"))], str(folder / "card.toml"))
    laws = {axis: restoring_law(flight, axis) for axis in AXES}

    assert laws.pop(moved) is None
    for law in laws.values():
        assert law is not None
        assert law.explained > 0.93
        assert law.lag < EARLY


def test_the_height_of_a_recorded_flight_is_held_by_a_law_that_is_known_to_four_digits(real_flights: Path) -> None:
    folder = real_flights / "bebop2-wsu"
    (flight,) = load_flights([parse_log(str(folder / "Training_CT_TestDay_X.mat"))], str(folder / "card.toml"))
    law = restoring_law(flight, "z")

    assert law is not None
    assert law.explained > 0.999
    assert np.ptp(flight.command[:, 2]) > 0


def test_a_flight_of_whose_motion_nothing_is_known_has_no_law() -> None:
    flight = held()
    motion = motion_from_flight(flight, least=10**6)

    assert motion.time.size == 0
    assert restoring_law(flight, "x", motion) is None
