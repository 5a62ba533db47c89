"""One axis, or x and y: alone, coupled through small turns, together where the vehicle turns."""

from functools import cache

import numpy as np
import pytest

from flights import STILL, flown, muddled, steps, truth_of
from rotorfit.core.flight_data import Flight
from rotorfit.estimation.likelihood.axis_estimate import couple_axes, estimate_axis, estimate_plane, free_of
from rotorfit.estimation.likelihood.blocks import Record, record
from rotorfit.estimation.likelihood.fisher_scoring import maximise
from rotorfit.simulation.paper_vehicle import Truth


def swaying(heading: float, sway: float, truth: Truth = STILL, axes: tuple[str, ...] = ("x", "y", "yaw")) -> Flight:
    """Yaw follows slow small steps, so that the heading stays within a few degrees of its mean."""
    return flown(truth, steps(axes, (0.2, 0.2, 0.2, sway), every=1.5), 40.0, 3, initial_yaw=heading)


def pair(flight: Flight) -> Record:
    rec = record(flight, ("x", "y"))
    assert rec is not None
    return rec


@cache
def held_flight() -> Flight:
    flight = swaying(0.8, 0.03)
    assert 2.0 < np.degrees(np.ptp(flight.yaw)) < 20.0
    return flight


def test_one_axis_alone_takes_the_small_turns_for_its_own_and_coupled_it_does_not() -> None:
    flight = held_flight()
    plain = [estimate_axis([flight], axis, True) for axis in ("x", "y")]
    joined = couple_axes([pair(flight)], plain)

    for before, after, axis in zip(plain, joined, ("x", "y"), strict=True):
        truth = truth_of(STILL, axis)
        errors = [
            [
                abs(e.optimum.point.gain[0] / truth["input"] - 1),
                abs(np.exp(e.optimum.point.log_damping[0]) / truth["damping"] - 1),
                abs(e.optimum.point.delay[0] - truth["delay"]),
            ]
            for e in (before, after)
        ]
        assert max(errors[0]) > 5e-3
        np.testing.assert_array_less(errors[1], [1e-3, 2e-3, 2e-4])


def test_coupled_and_together_agree_where_both_apply() -> None:
    flight = swaying(-2.0, 0.04, Truth())
    joined = couple_axes([pair(flight)], [estimate_axis([flight], axis, True) for axis in ("x", "y")])
    one = estimate_plane([flight], [pair(flight)], ("x", "y"), [True, True])[0].optimum

    for k, estimate in enumerate(joined):
        here = estimate.optimum
        error = np.sqrt(np.diag(np.linalg.inv(here.score.information[:3, :3])))
        assert abs(here.point.gain[0] - one.point.gain[k]) < error[0]
        assert abs(here.point.log_damping[0] - one.point.log_damping[k]) < error[1]
        assert abs(here.point.delay[0] - one.point.delay[k]) < error[2]


def test_an_axis_that_is_never_moved_has_levels_and_nothing_else() -> None:
    flight = flown(Truth(), steps(("x",)), 30.0, 2)

    estimate = estimate_axis([flight], "z", False)
    assert not estimate.excited
    assert estimate.found == ()
    assert estimate.optimum.point.gain[0] == 0.0
    np.testing.assert_allclose(np.sqrt(np.exp(estimate.optimum.point.levels[0, 1])), 0.0005, rtol=0.15)


def test_an_axis_whose_command_explains_nothing_is_not_excited() -> None:
    flight = flown(Truth(), steps(("z",), seed=1), 60.0, 1)

    assert estimate_axis([flight], "z", True).excited
    estimate = estimate_axis([muddled(flight, "z")], "z", True)
    assert not estimate.excited
    assert estimate.optimum.point.gain[0] == 0.0
    assert not estimate.optimum.free[:3].any()


def test_of_two_axes_together_only_the_one_that_explains_is_excited() -> None:
    flight = flown(Truth(), steps(("x", "y", "yaw"), seed=1), 60.0, 1)
    assert np.ptp(flight.yaw) > 1.0

    x, y = estimate_plane([flight], [pair(flight)], ("x", "y"), [True, True])
    assert x.excited
    assert y.excited
    other = muddled(flight, "y")
    x, y = estimate_plane([other], [pair(other)], ("x", "y"), [True, True])
    assert x.excited
    assert not y.excited
    assert x.optimum is y.optimum
    assert x.optimum.point.gain[0] == pytest.approx(truth_of(Truth(), "x")["input"], rel=0.1)


def test_where_one_axis_is_never_moved_the_starts_are_told_apart_by_the_other_alone() -> None:
    flight = flown(Truth(), steps(("x", "yaw")), 40.0, 2)

    x, y = estimate_plane([flight], [pair(flight)], ("x", "y"), [True, False])
    assert x.excited
    assert not y.excited
    assert x.found[0].starts >= 3


def test_a_long_flight_is_searched_in_an_excerpt_and_climbed_whole() -> None:
    flight = flown(Truth(), steps(("z",)), 150.0, 2)
    rec = record(flight, ("z",))
    assert rec is not None

    estimate = estimate_axis([flight], "z", True)
    assert estimate.found[0].optimum.score.innovations[0].size < 0.5 * rec.count.size
    assert estimate.optimum.score.innovations[0].size == rec.count.size
    again = maximise([rec], estimate.optimum.point, free_of([rec], [True]))
    assert again.point.delay[0] == pytest.approx(estimate.optimum.point.delay[0], abs=2e-4)
    assert estimate.optimum.gain < 1e-3


def test_what_may_move_are_the_coefficients_of_moved_axes_and_everything_else() -> None:
    rec = pair(held_flight())

    free = free_of([rec, rec], [True, False])
    assert free[:6].tolist() == [True, False] * 3
    assert free[6:].all()
    assert free.size == 6 + 2 * 2 + 2 * 2 + 8
