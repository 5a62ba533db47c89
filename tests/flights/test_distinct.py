"""The same flight twice is refused, by whatever name, and so are parts that overlap."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from clean_flights import clean_flights
from flights import flown, steps
from logs import Csv
from rotorfit.app.workflows import fit_logs, validate_logs
from rotorfit.assessment.innovations import was_fitted
from rotorfit.core.errors import FlightError
from rotorfit.core.flight_data import Flight
from rotorfit.estimation.fitting import fit
from rotorfit.files.log_span import parse_log
from rotorfit.files.models import from_mapping, to_mapping
from rotorfit.flights.distinct import check_distinct, landmarks, passes
from rotorfit.simulation.paper_vehicle import Truth, simulate_flight


def flight(seed: int = 1, span: tuple[float | None, float | None] = (None, None)) -> Flight:
    return flown(Truth(), steps(("z",), seed=3), 30.0, seed, span)


def error_of(*flights: Flight) -> str:
    with pytest.raises(FlightError) as error:
        check_distinct(flights)
    assert "\n" not in str(error.value)
    return str(error.value)


def test_a_flight_given_twice_is_refused() -> None:
    assert "overlap" in error_of(flight(), flight())


def test_a_copy_under_another_name_with_another_hash_is_refused() -> None:
    copy = replace(flight(), path="copy.bag", sha256="1" * 64, pose_time=flight().pose_time + 5.0)

    assert "simulated-1 and copy.bag hold 29" in error_of(flight(2), flight(), copy)


def test_parts_that_overlap_are_refused_and_parts_that_touch_are_not() -> None:
    assert "overlap" in error_of(flight(span=(None, 16.0)), flight(span=(14.0, None)))
    check_distinct([flight(span=(None, 15.0)), flight(span=(15.0, None))])


def test_a_fit_refuses_it() -> None:
    with pytest.raises(FlightError, match="overlap"):
        fit([flight(), flight()], axes=("z",))


def test_files_are_refused_by_their_content(tmp_path: Path) -> None:
    log, _, card = Csv(simulate_flight(Truth(), steps(("z",), seed=3), 30.0, 1)).write(tmp_path)
    shutil.copy(log, tmp_path / "copy.csv")
    with (tmp_path / "copy.csv").open("a") as file:  # another hash
        file.write("\n")
    both = [parse_log(log), parse_log(str(tmp_path / "copy.csv"))]

    with pytest.raises(FlightError, match="the same poses"):
        fit_logs(both, card, axes=("z",))
    model = fit_logs(both[:1], card, axes=("z",)).model
    with pytest.raises(FlightError, match="the same poses"):
        validate_logs(model, both)


def test_the_same_poses_in_another_file_with_fewer_digits_and_another_clock_are_recognised() -> None:
    model = fit([flight()], axes=("z",), structure="first_order_delay").model
    rounded = replace(
        flight(),
        sha256="1" * 64,
        pose_time=np.round(flight().pose_time, 3) + 5.0,
        position=np.round(flight().position, 3),
        yaw=np.round(flight().yaw, 3),
    )

    assert was_fitted(model, rounded)
    assert was_fitted(from_mapping(to_mapping(model), "test"), rounded)
    assert not was_fitted(model, flight(2))


def test_hovers_at_one_place_in_steps_of_a_centimetre_are_not_taken_for_one_flight() -> None:
    coarse = [replace(one, position=np.round(one.position, 2), yaw=np.round(one.yaw, 2)) for one in map(flight, (1, 2))]

    assert passes(coarse[0], landmarks(coarse[0]))
    assert not passes(coarse[1], landmarks(coarse[0]))
    still = [replace(one, position=np.zeros_like(one.position)) for one in coarse]
    assert not passes(still[0], landmarks(still[0]))


def test_forty_flights_of_many_vehicles_are_all_different() -> None:
    check_distinct([flight for _, _, _, flight in clean_flights(range(40))])
