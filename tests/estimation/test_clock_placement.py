"""Flights whose clocks only their answers relate: moved to answer alike, and to answer as a model says."""

import functools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from flights import fit_as_flown, steps
from rotorfit.assessment.innovations import placed, residual_tests_of_flight
from rotorfit.assessment.validation import validate
from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES
from rotorfit.core.laws import AVERAGED
from rotorfit.core.model import Model
from rotorfit.core.results import Fit
from rotorfit.estimation.clock_placement import placed_alike
from rotorfit.estimation.fitting import fit
from rotorfit.flights.assemble import flight_from_log
from rotorfit.flights.clocks.placement import with_later_commands
from rotorfit.simulation.paper_vehicle import SimulatedFlight, Truth, simulate_flight
from twin_logs import Skew, as_one, card_of

pytestmark = pytest.mark.flights

TRUTH = Truth(delay=(0.12, 0.15, 0.1, 0.14))
OFFSETS = 0.4, -1.3
WRONG = 0.07


@functools.cache
def flown(day: int) -> SimulatedFlight:
    return simulate_flight(TRUTH, steps(seed=40 + day), 45.0, 40 + day, initial_yaw=2.0 * day)


@functools.cache
def read(day: int, clock: str = "two") -> Flight:
    skew = Skew(OFFSETS[day] if clock == "two" else 0.0)
    log = replace(as_one(flown(day), skew), path=Path(f"c{day}.csv+m{day}.csv"))
    return flight_from_log(log, card_of(velocity=False, clock=clock) if clock == "one" else card_of(velocity=False))


@functools.cache
def alone() -> Fit:
    """A fit of the first day."""
    return fit_as_flown([read(0)])


@functools.cache
def exact() -> Model:
    """A fit of the first day as recorded by one clock."""
    return fit_as_flown([read(0, "one")]).model


def misplaced(late: float = WRONG) -> Flight:
    """The second day, placed wrong; unless told otherwise, worse than the worst of a hundred."""
    return with_later_commands(read(1), late, "no other flight")


@functools.cache
def moved(late: float = 0.0) -> Flight:
    """The second day, placed wrong or not, where the model of the first day places it."""
    return placed(alone().model, misplaced(late) if late else read(1))


def rmse(flight: Flight) -> list[float]:
    """Errors of the velocity of each axis 1 s ahead, by the model of the first day."""
    axes = validate(alone().model, [flight], (1.0,)).flights[0].axes
    return [axes[axis].horizons["1"].velocity_rmse or np.nan for axis in AXES]


def offset_errors(flights: list[Flight] | tuple[Flight, ...]) -> list[float]:
    """By how much the clock of each flight was taken to be later than it is, less the delay that this includes [s]."""
    return [flight.clocks.offset - offset for flight, offset in zip(flights, OFFSETS, strict=True) if flight.clocks]


@pytest.mark.parametrize("structure", ["first_order_delay", pytest.param(AVERAGED, marks=pytest.mark.slow)])
def test_flights_together_are_placed_alike_and_their_intervals_hold(structure: str) -> None:
    result = fit([read(0), misplaced()], structure=structure)
    one, other = offset_errors(result.flights)
    assert one == pytest.approx(other, abs=5e-4)
    assert sum("clocks_placed" in {note.code for note in flight.notes} for flight in result.flights) == 2
    inside = [
        low < truth < high
        for axis, pair in zip(AXES, np.reshape(TRUTH.gamma, (4, 2)), strict=True)
        for name, truth in zip(("input", "damping"), pair, strict=True)
        if None not in (ends := result.model.axes[axis].ci95[name])
        for low, high in [ends]
    ]
    assert len(inside) == 8
    assert sum(inside) >= 7
    assert all(result.model.axes[axis].delay is None for axis in AXES)


def test_a_flight_is_placed_by_a_model_which_it_does_not_deny_then() -> None:
    one, other = offset_errors((read(0), moved(WRONG)))
    assert one == pytest.approx(other, abs=2e-3)
    p = [each.command_p for each in residual_tests_of_flight(alone().model, moved(WRONG)).values()]
    assert len(p) == 4
    assert min(x for x in p if x is not None) > 0.001
    result = validate(alone().model, [moved(WRONG)], (1.0,))
    assert not [one for one in result.findings if one.severity == "warning"]


def test_validation_tells_that_such_a_flight_does_not_test_the_delay() -> None:
    found = validate(alone().model, [moved()], (1.0,)).findings
    (told,) = (one for one in found if one.code == "delay_not_tested")
    assert told.severity == "info"
    assert "relate the clocks of c1.csv+m1.csv" in told.evidence
    assert ": the commands were moved by a further " in told.evidence
    assert "delay_not_tested" not in {one.code for one in validate(exact(), [read(1, "one")], (1.0,)).findings}


def test_errors_of_the_placement_do_not_count_as_errors_of_the_model() -> None:
    near, far, raw = (rmse(flight) for flight in (moved(), moved(WRONG), misplaced()))
    assert far == pytest.approx(near, rel=0.02)
    assert np.min(np.divide(raw, near)) > 3


def test_flights_of_one_clock_stay_as_they_are() -> None:
    flights = [read(0, "one"), read(1, "one")]
    assert placed_alike(flights, lambda _some: pytest.fail("nothing is to be estimated")) == flights
    assert placed(exact(), flights[1]) is flights[1]


def test_a_flight_alone_is_not_moved() -> None:
    assert placed_alike([read(0)], lambda _some: pytest.fail("nothing is to be estimated")) == [read(0)]


@pytest.mark.parametrize("late", [-0.19, 0.25])
def test_a_flight_is_placed_by_a_model_of_one_clock_whose_delay_is_far_from_the_assumed_one(late: float) -> None:
    one, other = offset_errors((read(0), moved(late)))
    assert one == pytest.approx(other, abs=2e-3)


def test_flights_that_share_no_axis_stay_where_they_are() -> None:
    x, z = (replace(read(day), axes=(axis,), command=read(day).command * mask) for day, axis, mask in (
        (0, "x", np.array([1.0, 0.0, 0.0, 0.0])), (1, "z", np.array([0.0, 0.0, 1.0, 0.0]))))  # fmt: skip
    result = fit([x, z], axes=("x", "z"), structure="first_order_delay")
    assert [flight.clocks for flight in result.flights] == [x.clocks, z.clocks]
