"""Two files, two clocks: what the motion tells of them, how well, and where it must not be believed."""

import functools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from flights import Excitation, fit_as_flown, steps
from rotorfit.control.robustness import believed_possible, known_dynamics
from rotorfit.core.errors import FlightError
from rotorfit.core.flight_data import Clocks, Flight
from rotorfit.core.frames import world_from_heading
from rotorfit.core.log import Log, Table
from rotorfit.core.model import NORMAL, Model
from rotorfit.diagnosis.doctor import findings_of_flight
from rotorfit.files.cards import card_from_mapping
from rotorfit.files.logs import read as read_log
from rotorfit.files.logs.several import join_logs
from rotorfit.flights.assemble import flight_from_log
from rotorfit.flights.clocks.two_clocks import ANSWER_HALF
from rotorfit.flights.several_files import bound
from rotorfit.planning.belief import DELAY, belief_from_model
from rotorfit.planning.signals import two_sines
from rotorfit.simulation.paper_vehicle import SimulatedFlight, Truth, simulate_flight
from twin_logs import Sensor, Skew, as_one, card_of, in_two_files

pytestmark = pytest.mark.flights

LENGTH, LONG = 28.0, 40.0
CUT = card_from_mapping(
    {
        "command": {"time": "v:t", "x": "v:vf_ref", "y": "v:vl_ref", "z": "v:ve_ref", "yaw": "v:w_ref"},
        "pose": {"time": "r:t", "x": "r:xu", "y": "r:yu", "z": "r:zu", "yaw": "r:psi"},
        "velocity": {"frame": "heading", "time": "v:t", "x": "v:vf", "y": "v:vl", "z": "v:ve", "yaw": "v:w"},
    },
    "a recorded flight, cut in two",
)


@functools.cache
def flown(seed: int = 2, duration: float = LENGTH) -> SimulatedFlight:
    return simulate_flight(Truth(), steps(seed=seed), duration, seed)


def read(log: Log, **card: object) -> Flight:
    return flight_from_log(log, card_of(**card))


def clocks_of(log: Log, **card: object) -> Clocks:
    clocks = read(log, **card).clocks
    assert clocks is not None
    return clocks


def codes(log: Log, **card: object) -> dict[str, str]:
    return told(log, flight_from_log(log, bound(card_of(**card), log)))


def told(log: Log, flight: Flight) -> dict[str, str]:
    return {finding.code: finding.severity for finding in findings_of_flight(log, flight)}


def within(clocks: Clocks, skew: Skew, most: float = 0.002) -> None:
    """Near the truth, and no further than three of its standard errors."""
    assert abs(clocks.offset - skew.offset) < min(most, 3 * clocks.half_width / NORMAL)
    assert abs(clocks.drift - skew.drift) < 3 * clocks.drift_half_width / NORMAL


# The vehicle's own motion tells


@pytest.mark.parametrize(("offset", "drift"), [(-0.5, 1e-4), (0.02, -1e-4), (0.5, 0.0)])
def test_an_offset_and_a_drift_are_recovered(offset: float, drift: float) -> None:
    clocks = clocks_of(as_one(flown(), Skew(offset, drift)), attitude=True)

    within(clocks, Skew(offset, drift))
    assert clocks.source == "onboard"
    assert clocks.moved
    assert clocks.half_width < 0.004


@functools.cache
def without_holes(skew: Skew) -> Clocks:
    return clocks_of(as_one(flown(), skew), attitude=True)


@pytest.mark.parametrize("lost", [0.25, 0.4, 0.6])
def test_holes_in_the_poses_are_not_bridged(lost: float) -> None:
    """A curve through a hole swings: one of 0.4 s moved the offset by 5 ms, three of 0.6 s left none to be found."""
    flight, skew = flown(), Skew(0.02)
    time = flight.pose_stamp / 1e9
    there = ~np.any([(time >= start) & (time < start + lost) for start in (8.0, 19.0, 30.0)], axis=0)
    of_poses = ("pose_stamp", "pose", "stale", "true_pose", "velocity", "acceleration", "wind")
    holed = replace(flight, **{name: getattr(flight, name)[there] for name in of_poses})

    clocks = clocks_of(as_one(holed, skew), attitude=True)
    within(clocks, skew)
    assert clocks.half_width < 1.3 * without_holes(skew).half_width


@pytest.mark.parametrize("offset", [-240.0, 1.7e9])
def test_clocks_may_start_minutes_or_an_epoch_apart(offset: float) -> None:
    clocks = clocks_of(as_one(flown(), Skew(offset, 5e-5)), attitude=True)

    within(clocks, Skew(offset, 5e-5))


@pytest.mark.parametrize("card", [{"velocity": True}, {"velocity": False, "attitude": True}])
def test_velocity_alone_and_heading_alone_tell(card: dict) -> None:
    within(clocks_of(as_one(flown(), Skew(0.3, 5e-5)), **card), Skew(0.3, 5e-5), most=0.006)


def test_a_velocity_in_a_table_of_its_own_tells_by_its_own_stamps() -> None:
    vehicle, room = in_two_files(flown(), Skew(0.3, 5e-5))
    columns = dict(vehicle.tables["odometry"].columns)
    climb = {"t": columns["t"][1::2], "v_z": columns.pop("v_z")[1::2]}
    tables = {**vehicle.tables, "odometry": Table("odometry", columns), "climb": Table("climb", climb)}
    apart = join_logs([replace(vehicle, tables=tables), room])
    card = card_of()
    raw = {**card.raw, "velocity": {**card.raw["velocity"], "z": "climb:v_z"}}
    clocks = flight_from_log(apart, card_from_mapping(raw, "two tables")).clocks

    assert clocks is not None
    within(clocks, Skew(0.3, 5e-5))
    assert clocks.explained["velocity z"] > 0.9


def test_slow_sines_tell_too() -> None:
    flight = simulate_flight(Truth(), two_sines, LENGTH, 5)

    within(clocks_of(as_one(flight, Skew(-0.12, 1e-4))), Skew(-0.12, 1e-4))


def test_an_onboard_world_that_is_turned_mirrored_and_in_other_units_tells_as_well() -> None:
    vehicle, room = in_two_files(flown(duration=LONG), Skew(0.2))
    seen = dict(vehicle.tables["odometry"].columns)
    level = world_from_heading(np.column_stack([seen["v_x"], seen["v_y"]]), seen["psi"] + 1.1)
    other = seen | {"v_x": 100 * level[:, 1], "v_y": 100 * level[:, 0], "v_z": -seen["v_z"]}
    vehicle = replace(vehicle, tables={**vehicle.tables, "odometry": Table("odometry", other)})
    raw = card_of().raw
    card = card_from_mapping({**raw, "velocity": {**raw["velocity"], "frame": "world"}}, "other world")

    clocks = flight_from_log(join_logs([vehicle, room]), card).clocks
    assert clocks is not None
    within(clocks, Skew(0.2))


def test_the_room_may_record_long_before_and_after() -> None:
    vehicle, room = in_two_files(flown(), Skew(-40.0))
    pose = {name: np.asarray(values) for name, values in room.tables["mocap"].columns.items()}
    still = np.arange(0.01, 120.0, 0.01)
    rng = np.random.default_rng(3)
    longer = {name: np.concatenate([v[0] + 5e-4 * rng.standard_normal(still.size), v]) for name, v in pose.items()}
    longer["t"] = np.concatenate([pose["t"][0] - still[::-1], pose["t"]])
    room = replace(room, tables={"mocap": Table("mocap", longer)})

    within(clocks_of(join_logs([vehicle, room]), attitude=True), Skew(-40.0))


def test_a_latency_that_the_card_states_is_taken_out() -> None:
    log = as_one(flown(), Skew(0.1), Sensor(latency=0.08))
    time = {"from": "odometry:t", "offset": -0.08}
    raw = card_of(attitude=True).raw
    stated = {key: {**raw[key], "time": time} for key in ("velocity", "attitude")}

    assert clocks_of(log, attitude=True).offset == pytest.approx(0.02, abs=0.003)
    clocks = flight_from_log(log, card_from_mapping({**raw, **stated}, "stated")).clocks
    assert clocks is not None
    within(clocks, Skew(0.1))


def test_a_sensor_that_is_late_against_another_is_left_out_with_a_finding() -> None:
    vehicle, room = in_two_files(flown(), Skew(0.2, 3e-5))
    late, _ = in_two_files(flown(), Skew(0.2, 3e-5), Sensor(latency=0.15))
    seen, after = vehicle.tables["odometry"].columns, late.tables["odometry"].columns
    prompt = {"t": seen["t"], "psi": seen["psi"], "r": seen["r"]}
    tables = {**vehicle.tables, "odometry": Table("odometry", prompt), "speed": Table("speed", after)}
    log = join_logs([replace(vehicle, tables=tables), room])
    velocity = {"frame": "heading", "time": "speed:t", "x": "speed:v_x", "y": "speed:v_y"}
    card = bound(card_from_mapping({**card_of(attitude=True).raw, "velocity": velocity}, "late"), log)
    flight = flight_from_log(log, card)

    assert flight.clocks is not None
    within(flight.clocks, Skew(0.2, 3e-5), most=0.006)
    assert list(flight.clocks.explained) == ["heading"]
    assert flight.clocks.later["level velocity"] == pytest.approx(0.15, abs=0.01)
    assert "clock_sensors_disagree" in {finding.code for finding in findings_of_flight(log, flight)}


def test_recorded_flights_that_are_cut_in_two_give_one_latency(real_flights: Path) -> None:
    """Their own velocity and pose are in one file; what is found beyond the offset put in is the sensors' latency."""
    found = []
    for number, (offset, drift) in enumerate([(0.3, 5e-5), (-0.12, -1e-4)], start=3):
        log = read_log(real_flights / "dji-hexarotor" / f"Datos_Prueba{number}.mat")
        (table,) = log.tables.values()
        time = table.columns["t"].astype(float).ravel()
        middle = time[[0, -1]].mean()
        own = {**table.columns, "t": middle - offset + (time - middle) / (1 + drift)}
        vehicle = replace(log, path=Path("v.mat"), tables={"v": Table("v", own)})
        room = replace(log, path=Path("r.mat"), tables={"r": Table("r", table.columns)})
        clocks = flight_from_log(join_logs([vehicle, room]), CUT).clocks
        assert clocks is not None
        assert clocks.source == "onboard"
        found.append((clocks.offset - offset, clocks.half_width))

    for offset, half in found:
        assert abs(offset - 0.02) < half < 0.03


def test_bad_values_of_a_sensor_do_not_matter() -> None:
    vehicle, room = in_two_files(flown(), Skew(0.2, 3e-5))
    seen = {name: np.array(values) for name, values in vehicle.tables["odometry"].columns.items()}
    rng = np.random.default_rng(1)
    seen["v_x"][rng.random(seen["t"].size) < 0.02] = 8.0
    seen["v_y"][rng.random(seen["t"].size) < 0.1] = np.nan
    seen["psi"] = (seen["psi"] + np.pi) % (2 * np.pi) - np.pi
    vehicle = replace(vehicle, tables={**vehicle.tables, "odometry": Table("odometry", seen)})

    within(clocks_of(join_logs([vehicle, room]), attitude=True), Skew(0.2, 3e-5))


@pytest.mark.slow
def test_the_interval_covers_the_offset_in_19_of_20_flights() -> None:
    rng, hits, drifts, most = np.random.default_rng(7), 0, 0, 60
    for seed in range(most):
        skew = Skew(rng.uniform(-0.5, 0.5), rng.uniform(-1e-4, 1e-4))
        flight = simulate_flight(Truth(), [two_sines, steps(seed=seed)][seed % 2], 50.0, seed)
        clocks = clocks_of(as_one(flight, skew, Sensor(memory=[0.0, 0.5, 0.9][seed % 3]), seed))
        hits += abs(clocks.offset - skew.offset) < clocks.half_width
        drifts += abs(clocks.drift - skew.drift) < clocks.drift_half_width

    assert hits >= 52  # 19 of 20 would be 57 of 60; fewer than 52 happens in one of 100
    assert drifts >= 52


# What it does to the flight and to the delay


def test_the_commands_are_where_they_would_be_on_one_clock() -> None:
    one, two = (read(as_one(flown(), skew), attitude=True) for skew in (Skew(0.0), Skew(-123.4, 8e-5)))

    np.testing.assert_allclose(two.command_time, one.command_time, atol=0.004)
    start = [np.interp(5.0, f.pose_time, f.position[:, 0]) for f in (one, two)]
    assert start[0] == pytest.approx(start[1], abs=0.01)
    assert [note.count for note in two.notes if note.code == "clocks"] == [len(two.command_time)]


def test_the_delay_is_the_vehicles_and_its_interval_is_wider_by_that_of_the_offset() -> None:
    flight = read(as_one(flown(), Skew(0.3)), attitude=True)
    assert flight.clocks is not None
    plain = fit_as_flown([replace(flight, clocks=None)], axes=("z",)).model
    model = fit_as_flown([flight], axes=("z",)).model

    (low, high), (before, after) = model.axes["z"].ci95["delay"], plain.axes["z"].ci95["delay"]
    delay = model.axes["z"].delay
    assert delay is not None
    assert low is not None
    assert high is not None
    assert low < 0.15 < high
    assert high - delay == pytest.approx(np.hypot(after - delay, flight.clocks.half_width))
    assert delay - low == pytest.approx(np.hypot(delay - before, flight.clocks.half_width))
    k = model.covariance_names.index("z.delay")
    grown = model.covariance[k, k] - plain.covariance[k, k]
    assert np.sqrt(grown) == pytest.approx(flight.clocks.half_width / NORMAL)
    assert model.axes["z"].stderr["delay"] == pytest.approx(np.sqrt(model.covariance[k, k]))
    assert model.axes["z"].ci95["damping"] == plain.axes["z"].ci95["damping"]


def test_the_finding_says_what_was_moved_and_by_what() -> None:
    assert codes(as_one(flown(), Skew(0.3)))["clocks_joined"] == "info"


# Only the answer to the commands tells


@functools.cache
def answered(excitation: Excitation, offset: float) -> tuple[Log, Flight, Model]:
    """A log whose clocks only the answer to the commands joins, its flight, and the fit of yaw."""
    log = as_one(simulate_flight(Truth(), excitation, LENGTH, 3), Skew(offset))
    flight = flight_from_log(log, bound(card_of(velocity=False), log))
    return log, flight, fit_as_flown([flight], axes=("yaw",)).model


STEPS = steps(seed=4), 250.0


@pytest.mark.parametrize(("excitation", "offset"), [pytest.param(two_sines, -0.4, marks=pytest.mark.slow), STEPS])
def test_without_a_second_source_the_delay_is_not_identifiable(excitation: Excitation, offset: float) -> None:
    log, result, fitted = answered(excitation, offset)
    model = fitted.axes["yaw"]

    assert result.clocks is not None
    assert result.clocks.includes_delay
    assert told(log, result)["clock_includes_delay"] == "warning"
    assert (model.delay, model.status["delay"], model.ci95["delay"]) == (None, "not_identifiable", (None, None))
    assert "total_lag" not in model.combinations
    total, truth = model.combinations["offset_plus_delay"], offset + Truth().delay[3]
    assert total.ci95[0] is not None
    assert total.ci95[1] is not None
    assert total.ci95[0] - 0.01 < truth < total.ci95[1] + 0.01  # what was measured, with its interval
    assert abs(result.clocks.with_delay - truth) < ANSWER_HALF
    assert model.status["input"] == "ok"
    low, high = model.ci95["input"]
    assert low is not None
    assert high is not None
    assert 0.95 * low < Truth().gamma[6] < 1.05 * high


def test_what_only_the_answer_tells_of_a_delay_reaches_neither_gains_nor_plans() -> None:
    _, _, model = answered(*STEPS)

    assert model.covariance_names == ("yaw.input", "yaw.damping")
    assert known_dynamics(model, "yaw").delay == 0.0
    drawn = np.array([one.delay for one in believed_possible(model, "yaw", 2000, 0)])
    assert (drawn.mean(), drawn.std()) == pytest.approx(DELAY, rel=0.2)
    belief = belief_from_model(model, "m.json")
    assert belief.truth.delay[3] == DELAY[0]
    assert np.sqrt(belief.covariance[11, 11]) == pytest.approx(DELAY[1])
    assert np.sqrt(belief.covariance[9, 9]) < 0.1 * belief.truth.gamma[6]  # the input is known
    assert any("does not know the delay of yaw" in note for note in belief.notes)


def test_flights_with_and_without_the_delay_in_their_clocks_are_not_fitted_together() -> None:
    _, with_delay, _ = answered(*STEPS)
    with pytest.raises(FlightError, match="fit this flight separately"):
        fit_as_flown([replace(with_delay, card=card_of()), read(as_one(flown(), Skew(0.3)))])


# What must not be believed


def test_the_motion_of_another_flight_is_refused_with_a_finding() -> None:
    vehicle, _ = in_two_files(flown(2), Skew(0.2))
    other, room = in_two_files(flown(9), Skew(0.2))
    mixed = replace(other, tables={**other.tables, "odometry": vehicle.tables["odometry"]})
    log = join_logs([mixed, room])

    flight = flight_from_log(log, bound(card_of(attitude=True), log))
    assert flight.clocks is not None
    assert flight.clocks.refused
    assert flight.clocks.includes_delay
    assert told(log, flight)["clock_source_refused"] == "warning"


def test_files_of_two_flights_are_refused() -> None:
    vehicle, _ = in_two_files(flown(2), Skew(0.2))
    _, room = in_two_files(flown(9), Skew(0.2))
    with pytest.raises(FlightError, match="the clock offset between the two files cannot be determined") as error:
        read(join_logs([vehicle, room]), attitude=True)
    assert "\n" not in str(error.value)


def test_a_motion_that_repeats_itself_is_refused() -> None:
    def one_sine(t: np.ndarray) -> np.ndarray:
        return np.outer(np.sin(1.5 * t), [0.2, 0.0, 0.1, 0.3])

    flight = simulate_flight(replace(Truth(), wind_sigma=(0.0,) * 4), one_sine, LONG, 1)
    with pytest.raises(FlightError, match="repeats itself"):
        read(as_one(flight, Skew(0.2), Sensor(noise=0.1)))


# Clocks that are one


def test_clocks_that_the_card_calls_one_are_checked_and_not_moved() -> None:
    right, wrong = as_one(flown(), Skew(0.0)), as_one(flown(), Skew(0.1))

    for log in (right, wrong):
        assert not clocks_of(log, clock="one").moved
    assert "clock_offset" not in codes(right, clock="one")
    assert codes(wrong, clock="one")["clock_offset"] == "warning"
    assert codes(right, velocity=False, clock="one")["clock_unchecked"] == "info"


def test_messages_that_stand_in_both_files_show_that_their_stamps_are_of_one_clock() -> None:
    vehicle, room = in_two_files(flown(), Skew(0.0))

    def stamped(log: Log) -> Log:
        def table(name: str) -> Table:
            columns = dict(log.tables[name].columns)
            return Table(name, {"header.stamp": np.round(1e9 * (columns.pop("t") + 1e5)).astype(np.int64), **columns})

        beat = Table("/clock", {"header.stamp": (10**14 + np.arange(60) * 10**9).astype(np.int64), "n": np.arange(60)})
        return replace(log, tables={**{name: table(name) for name in log.tables}, "/clock": beat})

    log = join_logs([stamped(vehicle), stamped(room)])
    raw = card_of().raw
    clock = {"time": "header.stamp"}
    changed = {key: {**raw[key], **clock} for key in ("command", "pose")}
    clocks = clocks_of(log, velocity=False, **changed)

    assert set(log.tables) >= {"vehicle/clock", "mocap/clock"}
    assert "60 messages of clock" in clocks.stated
    assert not clocks.moved
