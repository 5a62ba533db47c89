"""What is not known of the stamps is in the interval of the delay."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from flights import fit_as_flown
from logs import Csv
from models import model_of
from rotorfit.app.workflows import load_flight
from rotorfit.core.frames import AXES
from rotorfit.core.model import Spread
from rotorfit.core.plain import plain_toml
from rotorfit.estimation.clock_uncertainty import clock_half_width, with_delay_error
from rotorfit.files.cards import card_from_mapping
from rotorfit.files.log_span import parse_log
from rotorfit.files.logs import read
from rotorfit.flights.assemble import flight_from_log
from rotorfit.planning.signals import two_sines
from rotorfit.simulation.paper_vehicle import Truth, simulate_flight

pytestmark = pytest.mark.flights

TRUTH = replace(Truth(), stale_share=0.0, pose_rate=25.0, delay=(0.12, 0.12, 0.10, 0.09))


def test_a_command_in_a_row_of_poses_may_have_been_sent_a_row_before(tmp_path: Path) -> None:
    """Rows of 25 Hz hold the latest of commands sent at 50 Hz: as stamped, the delay is confidently too short."""
    log, _, card = Csv(simulate_flight(TRUTH, two_sines, 60.0, 1)).write_rows(tmp_path)
    flight = load_flight(parse_log(log), card)
    told, stamped = (
        fit_as_flown([f], axes=("yaw",)).model.axes["yaw"] for f in (flight, replace(flight, command_lateness=0.0))
    )
    delay, lag = TRUTH.delay[3], TRUTH.delay[3] + 1 / TRUTH.gamma[7]

    assert flight.command_lateness == pytest.approx(0.04, rel=0.01)
    for one, other, true in (
        (told.ci95["delay"], stamped.ci95["delay"], delay),
        (told.ci95_flight["delay"], stamped.ci95_flight["delay"], delay),
        (told.combinations["total_lag"].ci95, stamped.combinations["total_lag"].ci95, lag),
    ):
        assert None not in one + other
        assert other[1] < true < one[1]  # type: ignore[operator]
        assert one == (other[0], pytest.approx(other[1] + flight.command_lateness))  # type: ignore[operator]
    assert told.ci95["input"] == stamped.ci95["input"]
    assert told.delay == stamped.delay


def test_commands_with_stamps_of_their_own_are_known(tmp_path: Path) -> None:
    log, _, card = Csv(simulate_flight(TRUTH, two_sines, 20.0, 1)).write(tmp_path)

    assert load_flight(parse_log(log), card).command_lateness == 0.0


def test_a_pose_in_a_later_row_was_measured_up_to_a_row_before(tmp_path: Path) -> None:
    """Rows of 30 Hz hold the latest of poses at 15 Hz; commands have rows of their own: the delay is too long."""
    log = Csv(simulate_flight(replace(TRUTH, pose_rate=15.0), two_sines, 60.0, 1))
    rows = np.arange(log.pose_time[0] + 0.032, log.pose_time[-1], 1 / 30)
    log.pose = log.pose[np.searchsorted(log.pose_time, rows, side="right") - 1]
    log.pose_time = rows
    path, _, card = log.write(tmp_path)
    flight = load_flight(parse_log(path), card)
    told, stamped = (
        fit_as_flown([f], axes=("yaw",)).model.axes["yaw"] for f in (flight, replace(flight, pose_lateness=0.0))
    )
    delay, lag = TRUTH.delay[3], TRUTH.delay[3] + 1 / TRUTH.gamma[7]

    assert flight.pose_lateness == pytest.approx(1 / 30, rel=0.01)
    assert flight.command_lateness == 0.0
    for one, other, true in (
        (told.ci95["delay"], stamped.ci95["delay"], delay),
        (told.ci95_flight["delay"], stamped.ci95_flight["delay"], delay),
        (told.combinations["total_lag"].ci95, stamped.combinations["total_lag"].ci95, lag),
    ):
        assert None not in one + other
        assert one[0] < true < other[0]  # type: ignore[operator]
        assert one == (pytest.approx(other[0] - flight.pose_lateness), other[1])  # type: ignore[operator]
    assert told.ci95["input"] == stamped.ci95["input"]
    assert told.delay == stamped.delay


def test_the_vehicle_may_have_held_commands_that_the_log_interpolates(tmp_path: Path) -> None:
    log = Csv(simulate_flight(replace(TRUTH, pose_rate=50.0, command_rate=20.0), two_sines, 60.0, 1))
    command = np.stack([np.interp(log.pose_time, log.command_time, one) for one in log.command.T], axis=1)
    log.command_time, log.command = log.pose_time, command
    path, _, card = log.write_rows(tmp_path)
    flight = load_flight(parse_log(path), card)
    told, stamped = (
        fit_as_flown([f], axes=("yaw",)).model.axes["yaw"] for f in (flight, replace(flight, command_lead=0.0))
    )

    assert flight.command_lead == pytest.approx(0.025, rel=0.02)
    (low, high), narrow = told.ci95["delay"], stamped.ci95["delay"]
    assert (low, high) == (pytest.approx(narrow[0] - flight.command_lead), narrow[1])  # type: ignore[operator]
    assert low < TRUTH.delay[3] < narrow[0]  # type: ignore[operator]


def test_stamps_of_a_coarse_clock_are_known_to_its_step(tmp_path: Path) -> None:
    log = Csv(simulate_flight(replace(TRUTH, pose_rate=50.0), two_sines, 60.0, 1))
    log.pose_time, log.command_time = np.round(log.pose_time, 1), np.round(log.command_time, 1)
    path, _, card = log.write(tmp_path)
    flight = load_flight(parse_log(path), card)
    told, stamped = (
        fit_as_flown([f], axes=("yaw",)).model.axes["yaw"] for f in (flight, replace(flight, stamp_step=0.0))
    )

    assert flight.stamp_step == pytest.approx(0.1)
    (low, high), narrow = told.ci95["delay"], stamped.ci95["delay"]
    assert (low, high) == (pytest.approx(narrow[0] - 0.1), pytest.approx(narrow[1] + 0.1))  # type: ignore[operator]
    assert narrow[1] < TRUTH.delay[3] < high  # type: ignore[operator]
    assert told.ci95["input"] == stamped.ci95["input"]


def test_what_the_card_states_of_its_stamps_is_in_the_delay(tmp_path: Path) -> None:
    """Poses that come 30 ms late by a radio of 60 ms; the link knows it to half of the round trip."""
    log, _, card = Csv(simulate_flight(TRUTH, two_sines, 60.0, 1)).write(tmp_path)
    raw = plain_toml(Path(card).read_text())
    late = {"from": raw["pose"]["time"], "unit": "s", "offset": 0.03}
    flights = [
        flight_from_log(read(log), card_from_mapping({**raw, "pose": {**raw["pose"], "time": time}}, "stated"))
        for time in (late, {**late, "error": 0.03})
    ]
    blind, told = (fit_as_flown([flight], axes=("yaw",)).model.axes["yaw"] for flight in flights)
    true = TRUTH.delay[3]

    assert flights[1].shared_error == 0.03
    assert [note.text for note in flights[1].notes if note.code == "stamp_error"] == [
        "stamps of the poses are known to +-30 ms (95 %), by the card: the interval of every delay holds it"
    ]
    assert blind.ci95["delay"][0] > true  # type: ignore[operator]
    assert told.ci95["delay"][0] < true < told.ci95["delay"][1]  # type: ignore[operator]
    assert told.delay == pytest.approx(blind.delay)
    assert told.ci95["input"] == blind.ci95["input"]


def test_what_all_stamps_of_a_link_may_be_off_by_alike_does_not_shrink_with_the_flights(tmp_path: Path) -> None:
    flights = []
    for seed, error in ((1, 0.03), (2, 0.028)):
        (folder := tmp_path / str(seed)).mkdir()
        log, _, card = Csv(simulate_flight(TRUTH, two_sines, 30.0, seed)).write(folder)
        raw = plain_toml(Path(card).read_text())
        raw["pose"]["time"] = {"from": raw["pose"]["time"], "unit": "s", "error": error}
        raw["command"]["time"] = {"from": raw["command"]["time"], "unit": "s"}
        flights.append(flight_from_log(read(Path(log)), card_from_mapping(raw, "a radio link")))

    assert [flight.shared_error for flight in flights] == [0.03, 0.028]
    assert clock_half_width(flights[:1], "z") == pytest.approx(0.03)
    assert clock_half_width(flights, "z") == pytest.approx(0.03)
    low, high = fit_as_flown(flights, ("z",)).model.axes["z"].ci95["delay"]  # though the cards state other errors
    assert high - low > 0.06  # type: ignore[operator]


def test_the_delay_of_the_next_flight_is_as_uncertain_as_the_clocks_at_least() -> None:
    model = model_of()
    spread = Spread("flights", 0.004, 0.004, 0.0, 2, 0.5, (0.08, 0.12), False)
    x = replace(model.axes["x"], spread={"delay": spread, "input": replace(spread, next_flight=(3.0, 4.0))})
    out = with_delay_error(replace(model, axes={**model.axes, "x": x}), {"x": 0.03}, (AXES,), {"x": (0.0, 0.04)})

    told = out.axes["x"].spread
    assert told["delay"].next_flight == pytest.approx((0.1 - np.hypot(0.02, 0.03), 0.1 + np.hypot(0.02, 0.03) + 0.04))
    assert told["input"].next_flight == (3.0, 4.0)
