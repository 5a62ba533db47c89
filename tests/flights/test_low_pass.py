"""Loggers that low-pass commands: found by the shape of the log, undone where the motion followed what was sent."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from clean_flights import clean_flights
from flights import CARD, NO_LOG, STILL, flown, steps
from rotorfit.app.workflows import load_flight
from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import Array
from rotorfit.core.log import Log
from rotorfit.core.model import STRUCTURE
from rotorfit.diagnosis.command_checks import command_findings
from rotorfit.diagnosis.recording import recording_of
from rotorfit.estimation.fitting import fit
from rotorfit.files.log_span import parse_log
from rotorfit.flights.assemble import flight_from_log
from rotorfit.flights.low_pass import kept_share
from rotorfit.planning.signals import two_sines
from rotorfit.simulation.paper_vehicle import Truth, as_log, simulate_flight

X = "twist.linear.x"


def smoothed(command: Array, share: float = 0.9) -> Array:
    out = command.copy()
    for k in range(1, len(out)):
        out[k] = share * out[k - 1] + (1 - share) * command[k]
    return out


def smoothed_log(log: Log, share: float = 0.9) -> Log:
    table = log.tables["/cmd_vel"]
    columns = {name: smoothed(column, share) if "twist" in name else column for name, column in table.columns.items()}
    return replace(log, tables={**log.tables, "/cmd_vel": replace(table, columns=columns)})


def sent(seed: int = 1, truth: Truth | None = None) -> Log:
    return as_log(simulate_flight(truth or Truth(), steps(("x", "z"), (0.2, 0.2, 0.2, 0.2), seed), 60.0, seed))


def codes(flight: Flight) -> set[str]:
    return {note.code for note in flight.notes if note.code.startswith("commands_")}


def severities(flight: Flight) -> list[str]:
    found = command_findings(recording_of(NO_LOG, flight))
    return [one.severity for one in found if one.code == "commands_low_pass"]


@pytest.mark.parametrize("share", [0.5, 0.8, 0.9, 0.95])
def test_the_share_that_a_logger_keeps_shows_in_the_shape_of_held_commands(share: float) -> None:
    command = sent().tables["/cmd_vel"].columns[X]

    assert kept_share(smoothed(command, share)) == pytest.approx(share, abs=0.002)
    assert kept_share(command) is None


def test_sines_and_ramps_have_no_such_shape() -> None:
    time = np.arange(0, 60, 0.02)

    assert kept_share(two_sines(time)[:, 0]) is None
    assert kept_share(np.abs(time % 8 - 4)) is None
    assert kept_share(np.random.default_rng(0).standard_normal(3000)) is None


def test_a_low_passed_log_gives_the_coefficients_of_what_was_sent() -> None:
    log = sent()
    right, flight = flight_from_log(log, CARD), flight_from_log(smoothed_log(log), CARD)
    one, other = (fit([f], axes=("x", "z"), structure=STRUCTURE).model.axes for f in (right, flight))

    assert codes(flight) == {"commands_unfiltered"}
    np.testing.assert_allclose(flight.command, right.command, atol=1e-3)
    for axis in ("x", "z"):
        for name in ("input", "damping", "delay"):
            assert getattr(other[axis], name) == pytest.approx(getattr(one[axis], name), rel=0.02, abs=0.002)
    assert severities(flight) == ["info"]


def test_commands_that_the_sender_smooths_stay_as_they_are() -> None:
    plain = steps(("x", "z"), 0.2, 1)
    grid = np.arange(0.0, 61.0, 0.02)
    slow = smoothed(plain(grid))

    def excitation(time: Array) -> Array:
        return slow[np.searchsorted(grid, time + 1e-9, side="right") - 1]

    truth = replace(STILL, wind_sigma=(0.02,) * 4, mocap_noise=(0.0005,) * 4, command_jitter=0.0)
    flight = flown(truth, excitation, 60.0)

    assert codes(flight) == {"commands_low_pass"}
    assert np.isin(flight.command[:, 0], slow[:, 0]).all()
    assert severities(flight) == ["warning"]


def test_commands_that_the_vehicle_does_not_follow_are_a_warning() -> None:
    log = smoothed_log(sent())
    pose = log.tables["/pose"].columns
    rng = np.random.default_rng(1)
    stray = {name: 0.01 * np.cumsum(rng.standard_normal(len(pose[name]))) for name in pose if "position" in name}
    wild = replace(log, tables={**log.tables, "/pose": replace(log.tables["/pose"], columns={**pose, **stray})})
    flight = flight_from_log(wild, CARD)

    assert codes(flight) == {"commands_low_pass"}
    assert [
        one.severity for one in command_findings(recording_of(NO_LOG, flight)) if one.code == "commands_low_pass"
    ] == ["warning"]


def test_no_clean_flight_of_forty_looks_smoothed() -> None:
    assert [codes(flight) for _, _, _, flight in clean_flights(range(40))] == [set()] * 40


@pytest.mark.parametrize(
    "name",
    ["bebop2-wsu/Training_CT_TestDay_X.mat", "dji-hexarotor/Datos_Prueba1.mat", "bebop2-joystick/record_velocity.csv"],
)
def test_commands_of_recorded_flights_have_no_such_shape(real_flights: Path, name: str) -> None:
    flight = load_flight(parse_log(str(real_flights / name)), str((real_flights / name).parent / "card.toml"))

    assert [kept_share(column) for column in flight.command.T] == [None] * 4
