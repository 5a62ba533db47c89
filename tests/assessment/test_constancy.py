"""Constancy: coefficients that change are noticed, by how much is said, and those that stay are left alone."""

from dataclasses import replace

import numpy as np
import pytest

from flights import flown, steps
from other_laws import flown_by
from rotorfit.assessment.constancy import LEVEL, Constancy, changed_coefficients, constancy
from rotorfit.core.flight_data import Flight
from rotorfit.core.results import Fit
from rotorfit.estimation.fitting import fit
from rotorfit.planning.signals import two_sines
from rotorfit.simulation.paper_vehicle import GAMMA_B, STABLE, Truth

TRUTH = replace(Truth(), stale_share=0.0)


def flight(seed: int = 2, duration: float = 60.0) -> Flight:
    return flown(TRUTH, steps(("z",), seed=seed), duration, seed)


def louder(flight: Flight, after: float, factor: float) -> Flight:
    """The flight of a vehicle whose gain rises by a factor: its commands are logged smaller."""
    late = flight.command_time > after
    return replace(flight, command=np.where(late[:, None], flight.command / factor, flight.command))


def checked(*flights: Flight) -> tuple[Fit, Constancy]:
    result = fit(flights, axes=("z",), structure="first_order_delay")
    found = constancy(flights, result.estimates["z"], "z")
    assert found is not None
    return result, found


def test_halves_of_a_steady_flight_agree_and_each_tells_the_truth() -> None:
    result, found = checked(flight())

    assert found.degrees == 3
    assert found.probability > 0.01
    for part in found.halves[0]:
        assert part.theta[0] == pytest.approx(GAMMA_B[4], abs=4 * np.sqrt(part.covariance[0, 0]))
    assert list(changed_coefficients(result, "z")) == []


def test_a_gain_that_rises_by_a_fifth_in_the_middle_is_told_with_both_values() -> None:
    result, found = checked(louder(flight(), 30.0, 1.2))

    assert found.probability < LEVEL
    first, second = found.halves[0]
    assert second.theta[0] / first.theta[0] == pytest.approx(1.2, abs=0.06)
    (told,) = changed_coefficients(result, "z")
    assert f"{first.theta[0]:.3g}" in told.evidence
    assert f"{second.theta[0]:.3g}" in told.evidence


def test_halves_of_several_flights_are_tested_together() -> None:
    _, found = checked(flight(2), flight(3))

    assert (len(found.halves), found.degrees) == (2, 6)


def test_flights_that_differ_do_not_change_within_and_the_one_that_does_is_named() -> None:
    one, other = flight(2), louder(flight(3), 0.0, 1.3)
    result, found = checked(one, other)

    assert found.probability > 0.01
    assert list(changed_coefficients(result, "z")) == []
    (told,) = changed_coefficients(checked(one, replace(louder(other, 30.0, 1.2), path="logs/late.bag"))[0], "z")
    assert "most in late.bag" in told.evidence
    assert "track logs/late.bag" in told.remedy


def test_halves_of_a_gusty_flight_keep_the_prior_of_the_lag() -> None:
    result = fit([flown_by("first_order_delay_lag", duration=40.0, seed=2, wind=0.6, noise=0.005)], axes=("z",))
    found = constancy(result.flights, result.estimates["z"], "z")

    assert result.model.axes["z"].structure == "first_order_delay_lag"
    assert found is not None  # without it neither half tells the input from damping and lag
    assert len(found.halves) == 1


def test_flights_too_short_for_halves_and_the_papers_method_are_not_checked() -> None:
    brief = flight(duration=25.0)
    short = fit([brief], axes=("z",), structure="first_order_delay")
    paper = fit([louder(flight(), 30.0, 2.0)], "paper", axes=("z",))

    assert constancy([brief], short.estimates["z"], "z") is None
    assert list(changed_coefficients(short, "z")) == []
    assert list(changed_coefficients(paper, "z")) == []


def test_under_no_change_the_test_is_passed_as_often_as_its_level_says() -> None:
    """Six flights: the chi-squares average their degrees of freedom (3 +- 1)."""
    squares = [checked(flight(seed, 40.0))[1].chi_square for seed in range(10, 16)]

    assert 1.2 < np.mean(squares) < 6.0
    assert max(squares) < 21.1  # the point of level 1e-4


def test_x_and_y_of_a_vehicle_that_turns_are_tested_together() -> None:
    turning = flown(TRUTH, steps(("x", "y", "yaw"), (0.2, 0.2, 0.2, 0.4), seed=4), 40.0, 4)
    changed = replace(turning, command=turning.command.copy())
    changed.command[changed.command_time > 20, 0] /= 1.3

    for one, expected in ((turning, []), (changed, ["x"])):
        result = fit([one], axes=("x", "y"), structure="first_order_delay")
        assert [finding.axis for axis in ("x", "y") for finding in changed_coefficients(result, axis)] == expected


def test_halves_that_slow_commands_let_wander_along_a_curve_are_not_told_as_a_change() -> None:
    truth = Truth(gamma=list(STABLE.values())[2], delay=(0.2,) * 4)
    _, found = checked(flown(truth, two_sines, 60.0, 64), flown(truth, steps(seed=7), 50.0, 65))

    gains = [part.theta[0] for halves in found.halves.values() for part in halves]
    assert max(gains) > 2 * min(gains)  # far apart, by errors that hold only near each
    assert found.probability > 0.01
