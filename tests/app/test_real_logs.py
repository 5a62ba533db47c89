"""Logs that nobody of this project recorded: each is read by the card that is proposed, or says precisely why not.

What is odd about these logs, and the test that shows it is survived:

| set | quirk | test |
|---|---|---|
| bebop2-wsu | clock one sample longer; garbage first command; intervals to 0.167 s; commands that saturate | `test_flight::test_bebop2_wsu_loses_its_garbage_start_and_nothing_else` |
| bebop2-wsu | garbage must not make yaw look excited | `test_real_flights::test_the_garbage_command_at_the_start_does_not_make_yaw_look_excited` |
| bebop2-wsu | all raw signs flipped | `test_the_motion_tells_axes_and_signs_of_every_recorded_set` (here) |
| bebop2-optitrack | stale poses with fresh stamps, frozen end; commands that stop without a zero | `test_flight::test_bebop2_optitrack_drops_its_stale_frames_and_stops_with_its_commands` |
| bebop2-optitrack | one axis excited a bag | `test_real_flights::test_of_a_bag_only_the_excited_axis_has_numbers` |
| dji-hexarotor | references one sample shorter; yaw wraps through whole turns; single precision | `test_flight::test_dji_hexarotor_drops_the_last_measurement_and_unwraps` |
| dji-hexarotor | `VF_ref` beside `vf_ref`; MATLAB objects beside the arrays | `test_sources::test_real_mat_files_come_as_scipy_reads_them` |
| dji-hexarotor | 10 Hz: fast axes have no separable time constant | `test_doctor_fit::test_the_quirks_of_real_flights_are_told` |
| bebop2-joystick | half of all rows repeat the pose before | `test_flight::test_bebop2_joystick_keeps_half_of_its_rows` |
| bebop2-joystick | x, y in the world, commands in the body | `test_the_motion_tells_axes_and_signs_of_every_recorded_set` (here) |
| ardrone2-optitrack | integer arrays, matrices by row, empty ones | `test_flight::test_ardrone2_reads_matrices_by_row` |
| ardrone2-optitrack | signs of phi, theta, psidot flipped | `test_the_motion_tells_axes_and_signs_of_every_recorded_set` (here) |
| ardrone2-optitrack | damping of x and y not identifiable | `test_real_flights::test_two_second_steps_of_the_ardrone_do_not_tell_the_damping_of_x_and_y` |
| px4-s500 | set-points NaN before control starts; NED; heading reset | `test_px4_uses_its_velocity_controlled_window_only` (here) |
| px4-s500 | names differ between versions | `test_old_and_new_px4_logs_are_read_by_the_same_cards` (here) |
| PX4 elsewhere | set-points of 0.00 while velocity control is off; position resets | `test_set_points_while_velocity_control_is_off_are_no_commands` (here), `test_window` |
| arducopter | `MODE` without a time | `test_dataflash::test_a_real_log_is_read_whole_and_one_of_definitions_is_refused` |
| arducopter | NTUN in navigation modes only; yaw clockwise; cm and cm/s | `test_arducopter_uses_its_loiter_window_only` (here) |
| arducopter | 600 bytes of format records | `test_logs_without_commands_or_position_say_so_in_one_line` (here) |
| tello | no x, y; velocities in dm/s; `tof` saturates; `Ux` never used | `test_the_tello_log_is_fitted_in_its_yaw_and_forward_velocity` (test_velocity) |
| motive | quaternion X Y Z W; empty cells; frames from 72210; five pieces | `test_mocap_exports::test_a_real_take_is_read_whole_with_its_holes` |
| motive | Y up | `test_a_draft_for_motive_has_z_up` (here) |
"""  # noqa: E501

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_survey import loaded

from rotorfit.app.workflows import fit_logs, load_flight
from rotorfit.core.card import Card
from rotorfit.core.errors import RotorfitError
from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES
from rotorfit.core.log import Log, Table
from rotorfit.core.results import Fit
from rotorfit.diagnosis import card_choice
from rotorfit.diagnosis.card_choice import proposal
from rotorfit.diagnosis.card_draft import draft_card
from rotorfit.diagnosis.command_response import answers_of
from rotorfit.diagnosis.survey import survey
from rotorfit.files.cards import card_from_mapping, load_card
from rotorfit.files.log_span import LogSpan
from rotorfit.files.logs import read
from rotorfit.flights.assemble import flight_from_log
from rotorfit.flights.columns import card_for, fitting_cards

pytestmark = pytest.mark.flights

PX4 = "px4-s500/TestFlight1.ulg"
ARDUCOPTER = "arducopter/2014-10-18_20-04-24.bin"


@cache
def fitted(path: Path, axes: tuple[str, ...] = AXES) -> Fit:
    return fit_logs([LogSpan(str(path), (None, None))], axes=axes, structure="first_order_delay")


def codes(flight: Flight) -> dict[str, int]:
    return {code: sum(n.count for n in flight.notes if n.code == code) for code in {n.code for n in flight.notes}}


def test_a_flight_names_the_built_in_card_that_reads_it(real_flights: Path) -> None:
    path = str(real_flights / "bebop2-joystick/record_velocity.csv")
    told = {note.code: note.text for note in load_flight(LogSpan(path, (None, None))).notes}

    assert told["card_proposed"].startswith("read with the built-in card bebop2-joystick, ")
    notes = load_flight(LogSpan(path, (None, None)), "bebop2-joystick").notes
    assert "card_proposed" not in {note.code for note in notes}


def test_px4_uses_its_velocity_controlled_window_only(real_flights: Path) -> None:
    log = read(real_flights / PX4)
    flight = load_flight(LogSpan(str(real_flights / PX4), (None, None)))
    found = codes(flight)

    assert proposal(log).name == "px4"
    assert found["nan_commands"] == 74
    assert found["card_proposed"] == 1  # px4-offboard makes no flight of it
    assert found["pose_resets"] == 1  # the heading, at 623.4 s
    assert found["commands_on_ground"] == 66  # until it leaves the ground, and from when it is down
    assert len(flight.segments) == 2
    assert flight.duration == pytest.approx(44.5, abs=0.2)
    setpoints = log.tables["vehicle_local_position_setpoint"].columns
    valid = setpoints["timestamp"][np.isfinite(setpoints["vx"])] / 1e6
    origin = valid[0]
    assert origin + flight.command_time[0] == pytest.approx(621.9, abs=0.3)
    assert origin + flight.segments[-1].end <= valid[-1] + 0.11
    assert flight.position[:, 2].max() == pytest.approx(4.3, abs=0.1)  # z up


def test_px4_fits_with_gains_near_one(real_flights: Path) -> None:
    """A velocity loop answers a set-point of 1 m/s with 1 m/s; a wrong sign or exchanged axes could not."""
    axes = fitted(real_flights / PX4).model.axes

    for axis in ("x", "y", "yaw"):
        assert 0.9 < axes[axis].combinations["steady_gain"].value < 1.6
    signs, frames = {"sign_flipped", "axes_turned"}, {"axes_exchanged", "command_frame", "mirrored_pose", "yaw_offset"}
    wrong = signs | frames | {"unit_mistake"}
    assert not wrong & {finding.code for finding in fitted(real_flights / PX4).model.findings}


def test_arducopter_uses_its_loiter_window_only(real_flights: Path) -> None:
    log = read(real_flights / ARDUCOPTER)
    flight = load_flight(LogSpan(str(real_flights / ARDUCOPTER), (None, None)))
    mode = log.tables["MODE"].columns
    begin, end = mode["log_time"][3] / 1e9, mode["log_time"][4] / 1e9
    origin = log.tables["NTUN"].columns["TimeMS"][0] / 1e3

    assert proposal(log).name == "arducopter-3.2"
    assert begin - 0.1 <= origin + flight.segments[0].start
    assert origin + flight.segments[-1].end <= end + 0.11
    assert flight.duration == pytest.approx(281.3, abs=0.2)
    assert codes(flight)["commands_outside_window"] == 366
    assert np.ptp(flight.position[:, 0]) == pytest.approx(96, abs=5)  # metres, not centimetres


def test_arducopter_fits_with_gains_near_one(real_flights: Path) -> None:
    axes = fitted(real_flights / ARDUCOPTER, ("x", "y", "z")).model.axes

    for axis in ("x", "y"):
        assert 0.75 < axes[axis].combinations["steady_gain"].value < 1.1
    assert axes["z"].predictor is not None
    assert axes["z"].predictor.input > 0


@pytest.mark.parametrize(
    ("file", "says"),
    [
        ("motive/pathviewr_motive_example_data.csv", "holds poses but nothing that looks like commands"),
        ("arducopter/format-only_600_bytes.bin", "defines 5 messages and holds none of them"),
    ],
)
def test_logs_without_commands_or_position_say_so_in_one_line(real_flights: Path, file: str, says: str) -> None:
    with pytest.raises(RotorfitError, match=says) as error:
        fit_logs([LogSpan(str(real_flights / file), (None, None))])

    assert "\n" not in str(error.value)
    if "600" not in file:
        assert says in (survey(read(real_flights / file)).problem or "")


# What the motion tells


def without_signs(card: Card) -> Card:
    """The card as somebody writes it who knows neither signs nor frame."""
    raw: dict[str, Any] = {key: value for key, value in card.raw.items() if key != "command"}
    command = {key: value for key, value in card.raw["command"].items() if key != "frame"}
    for axis, value in command.items():
        if axis != "time" and isinstance(value, dict):
            command[axis] = {key: part for key, part in value.items() if key != "scale"}
    return card_from_mapping(raw | {"command": command}, "without signs")


def test_the_motion_tells_axes_and_signs_of_every_recorded_set(real_flights: Path) -> None:
    """Of 21 recorded flights every answer is right; what is not excited is not answered."""
    told = 0
    files = [PX4, ARDUCOPTER, *(str(path.relative_to(real_flights)) for path in sorted(real_flights.glob("*/*.mat")))]
    files += [str(path.relative_to(real_flights)) for path in sorted(real_flights.glob("*/*.bag"))]
    for file in [*files, "bebop2-joystick/record_velocity.csv"]:
        log = read(real_flights / file)
        card = card_for(log, proposal(log).card)
        found = answers_of(flight_from_log(log, without_signs(card)))
        assert found.frame in (None, card.command_frame), file
        for axis, answer in found.of.items():
            if answer.axis is not None:
                told += 1
                assert (answer.axis, answer.sign) == (axis, np.sign(card.command[axis].scale)), (file, axis)
    assert told >= 45


def test_a_draft_finds_axes_signs_and_frame_of_px4_by_itself(
    real_flights: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(card_choice, "fitting_cards", lambda _: {})
    log = read(real_flights / PX4)

    text = draft_card(log)
    card = loaded(text, tmp_path)

    topic = "vehicle_local_position_setpoint"
    assert (card.frame, card.command_frame) == ("NED", "world")
    assert {axis: card.command[axis].source for axis in ("x", "y", "yaw")} == {
        "x": f"{topic}:vy", "y": f"{topic}:vx", "yaw": f"{topic}:yawspeed",
    }  # fmt: skip
    assert [card.command[axis].scale for axis in ("x", "y", "yaw")] == [1, 1, -1]
    assert "EDIT: the motion does not tell the sign" in text  # of z, which takes off once
    assert card.reference["x"].source == f"{topic}:x"
    assert card.window[0].channel.source == "vehicle_control_mode:flag_control_velocity_enabled"


def test_a_draft_for_motive_has_z_up(real_flights: Path) -> None:
    text = draft_card(read(real_flights / "motive" / "pathviewr_motive_example_data.csv"))

    assert 'z = "device02.position.y"' in text
    assert '["device02.rotation.w", "device02.rotation.z", "device02.rotation.x", "device02.rotation.y"]' in text
    assert "INCOMPLETE: nothing was recognised for [command]" in text


# Other versions of the same logs


def renamed(log: Log, table: str, **names: str | None) -> Log:
    """A log in which columns of a table have other names, or are missing."""
    columns = {names.get(name, name): values for name, values in log.tables[table].columns.items()}
    kept = {name: values for name, values in columns.items() if name is not None}
    return Log(log.path, log.format, log.sha256, {**log.tables, table: Table(table, kept)}, log.skipped)


def without(log: Log, *tables: str) -> Log:
    left = {name: table for name, table in log.tables.items() if name not in tables}
    return Log(log.path, log.format, log.sha256, left, log.skipped)


def test_old_and_new_px4_logs_are_read_by_the_same_cards(real_flights: Path) -> None:
    log = read(real_flights / PX4)
    expected = flight_from_log(log, load_card("px4"))

    old = renamed(log, "vehicle_local_position", heading="yaw", heading_reset_counter=None)
    old = without(old, "vehicle_land_detected", "vehicle_control_mode")

    assert list(fitting_cards(old)) == ["px4", "px4-offboard"]
    found = flight_from_log(old, load_card("px4"))
    np.testing.assert_allclose(found.yaw, expected.yaw)
    assert codes(found)["commands_on_ground"] >= 60  # without a land detector


def test_set_points_while_velocity_control_is_off_are_no_commands(real_flights: Path) -> None:
    """Old PX4 publishes 0.00 where new ones publish NaN."""
    log = read(real_flights / PX4)
    topic = "vehicle_local_position_setpoint"
    columns = {
        name: np.nan_to_num(values) if name in ("vx", "vy", "vz") else values
        for name, values in log.tables[topic].columns.items()
    }
    zeros = Log(log.path, log.format, log.sha256, {**log.tables, topic: Table(topic, columns)}, log.skipped)

    found, expected = (flight_from_log(one, load_card("px4")) for one in (zeros, log))

    assert codes(found)["commands_outside_window"] >= 37
    assert found.duration == pytest.approx(expected.duration, abs=1.1)  # the flags come once a second


def test_off_board_velocities_go_before_those_of_the_controller(real_flights: Path) -> None:
    log = read(real_flights / PX4)
    status = {**log.tables["vehicle_status"].columns}
    status["nav_state"] = np.where(status["nav_state"] == 3, 14, status["nav_state"]).astype(np.uint8)
    tables = {**log.tables, "vehicle_status": Table("vehicle_status", status)}
    setpoint = dict(log.tables["trajectory_setpoint"].columns)
    velocity = np.stack([setpoint.pop(f"v{axis}") for axis in "xyz"], axis=1)
    new = {**tables, "trajectory_setpoint": Table("trajectory_setpoint", setpoint | {"velocity": velocity})}

    for changed in (tables, new):
        proposed = proposal(Log(log.path, log.format, log.sha256, changed, log.skipped))
        assert proposed.name == "px4-offboard"
        assert "px4 (px4-offboard goes before it where both fit)" in proposed.why


def test_the_log_of_a_new_arducopter_gives_the_flight_of_the_old_one(real_flights: Path) -> None:
    """The recorded flight in the messages of 4.1: north, east, down, metres, a table an axis."""
    log = read(real_flights / ARDUCOPTER)
    old = log.tables["NTUN"].columns
    stamps = old["TimeMS"].astype(np.int64) * 1000
    climb = log.tables["CTUN"].columns
    messages = {
        "PSCN": {"TimeUS": stamps, "PN": old["PosX"] / 100, "TVN": old["DVelX"] / 100, "VN": old["VelX"] / 100},
        "PSCE": {"TimeUS": stamps + 40, "PE": old["PosY"] / 100, "TVE": old["DVelY"] / 100, "VE": old["VelY"] / 100},
        "PSCD": {
            "TimeUS": climb["TimeMS"].astype(np.int64) * 1000 + 80,
            "PD": -climb["Alt"],
            "TVD": -climb["DCRt"] / 100,
            "VD": -climb["CRt"] / 100,
        },
        "ATT": {"TimeUS": log.tables["ATT"].columns["TimeMS"].astype(np.int64) * 1000}
        | {"Yaw": log.tables["ATT"].columns["Yaw"]},
        "MODE": {"TimeUS": log.tables["MODE"].columns["log_time"] // 1000, "Mode": log.tables["MODE"].columns["Mode"]},
        "EV": {"TimeUS": log.tables["EV"].columns["log_time"] // 1000, "Id": log.tables["EV"].columns["Id"]},
    }
    new = Log(log.path, log.format, log.sha256, {name: Table(name, one) for name, one in messages.items()}, {})

    assert proposal(new).name == "arducopter"
    found = flight_from_log(new, load_card("arducopter"))
    expected = flight_from_log(log, load_card("arducopter-3.2"))

    assert found.duration > expected.duration + 25  # circle and return, too
    for axis in range(3):
        moved = np.interp(expected.pose_time, found.pose_time, found.position[:, axis])
        np.testing.assert_allclose(moved[50:-50], expected.position[50:-50, axis], atol=0.05)
