"""What is not known of the stamps is in the interval of the delay."""

from dataclasses import replace
from pathlib import Path

import pytest

from flights import fit_as_flown
from logs import Csv
from rotorfit.app.workflows import load_flight
from rotorfit.files.log_span import parse_log
from rotorfit.planning.signals import two_sines
from rotorfit.simulation.paper_vehicle import Truth, simulate_flight

pytestmark = pytest.mark.flights

TRUTH = replace(Truth(), stale_share=0.0, pose_rate=25.0, delay=(0.12, 0.12, 0.10, 0.09))


def test_a_command_in_a_row_of_poses_may_have_been_sent_a_row_before(tmp_path: Path) -> None:
    """Rows of 25 Hz hold the latest of commands sent at 50 Hz: as stamped, the delay is confidently too short."""
    log, _, card = Csv(simulate_flight(TRUTH, two_sines, 60.0, 1)).write_rows(tmp_path)
    flight = load_flight(parse_log(log), card)
    told, stamped = (fit_as_flown([f]).model.axes["yaw"] for f in (flight, replace(flight, command_lateness=0.0)))
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
