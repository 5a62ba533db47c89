"""The same flight twice is refused, by whatever name, and so are parts that overlap."""

import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from clean_flights import clean_flights
from flights import flown, steps
from logs import Csv
from rotorfit.app.workflows import fit_logs, validate_logs
from rotorfit.core.errors import FlightError
from rotorfit.core.flight_data import Flight
from rotorfit.estimation.fitting import fit
from rotorfit.files.log_span import parse_log
from rotorfit.flights.distinct import check_distinct
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


def test_forty_flights_of_many_vehicles_are_all_different() -> None:
    check_distinct([flight for _, _, _, flight in clean_flights(range(40))])
