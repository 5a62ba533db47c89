"""The vehicle's own velocity: read, measured alone or beside the pose, predicted; and what is refused in a line."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from flights import STILL, fit_as_flown, steps
from onboard import onboard_card, with_odometry
from rotorfit.app.cli import main
from rotorfit.assessment.validation import dynamics_from_model, validate
from rotorfit.core.errors import CardError, FlightError
from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES, heading_from_world
from rotorfit.core.laws import start_levels
from rotorfit.core.log import Log, Table
from rotorfit.core.results import Fit
from rotorfit.dynamics.protocol import predict_flight
from rotorfit.dynamics.velocity_fusion import whiten_fused
from rotorfit.estimation.fitting import fit
from rotorfit.estimation.likelihood.block_response import response
from rotorfit.estimation.likelihood.blocks import Record, record
from rotorfit.estimation.likelihood.latency import delay_error, latency_of
from rotorfit.estimation.likelihood.likelihood import restriction, score
from rotorfit.estimation.likelihood.optima import start_point
from rotorfit.estimation.likelihood.parameters import Point
from rotorfit.files.cards import card_from_mapping
from rotorfit.files.models import load, save
from rotorfit.flights.assemble import flight_from_log
from rotorfit.flights.stamps import coarse, grain
from rotorfit.simulation.paper_vehicle import SimulatedFlight, Truth, simulate_flight
from whole_filters import whiten_axis, whiten_plane

pytestmark = pytest.mark.flights

Array = np.ndarray
EXACT = {"noise": 0.0, "bias": 0.0}


def flown(
    truth: Truth = STILL, axes: tuple[str, ...] = ("x",), seed: int = 3, duration: float = 20.0
) -> SimulatedFlight:
    return simulate_flight(truth, steps(axes, 0.2, seed=seed), duration, seed)


@pytest.fixture(scope="module")
def turning() -> Flight:
    """Position and velocity of a flight that turns."""
    log = with_odometry(flown(Truth(), AXES, duration=12.0), latency=0.0)
    return flight_from_log(log, onboard_card((), independent=True))


@pytest.fixture(scope="module")
def alone() -> tuple[Flight, Fit]:
    """A fit to velocities that are 60 ms late."""
    flight = flight_from_log(with_odometry(flown(Truth(), ("x", "z"))), onboard_card())
    return flight, fit_as_flown([flight], axes=("x", "z"))


def whole(flight: Flight, axes: tuple[str, ...]) -> Record:
    rec = record(flight, axes)
    assert rec is not None
    return rec


# --- the card and the log


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"pose": ("x",)}, "x is missing; x and y go together"),
        ({"pose": ("z",), "velocity": ("z",)}, "z is missing; name its column, or a constant .* or its velocity"),
        ({"velocity_key": ("independent", "yes")}, "independent: must be true or false"),
        ({"velocity_key": ("independant", True)}, "unknown key 'independant'; nearest: 'independent'"),
    ],
)
def test_a_card_that_leaves_out_what_nothing_stands_for_is_refused(change: dict[str, Any], told: str) -> None:
    raw = {key: dict(part) if isinstance(part, dict) else part for key, part in onboard_card(()).raw.items()}
    for axis in change.get("pose", ()):
        del raw["pose"][axis]
    for axis in change.get("velocity", ()):
        del raw["velocity"][axis]
    if "velocity_key" in change:
        name, value = change["velocity_key"]
        raw["velocity"][name] = value

    with pytest.raises(CardError, match=told):
        card_from_mapping(raw, "a card")


@pytest.mark.parametrize("frame", ["heading", "world"])
def test_velocity_is_read_along_the_axes_of_the_world(frame: str) -> None:
    sim = flown(axes=("x", "y", "yaw"), duration=10.0)
    flight = flight_from_log(with_odometry(sim, latency=0.0, frame=frame, **EXACT), onboard_card(frame=frame))

    assert flight.velocity is not None
    assert flight.velocity_only == ("x", "y", "z")
    at = np.searchsorted(sim.pose_stamp / 1e9 - sim.command_stamp[0] / 1e9, flight.velocity.time - 1e-6)
    np.testing.assert_allclose(flight.velocity.value[:, :3], sim.velocity[at, :3], atol=2e-4)
    assert np.isnan(flight.velocity.value[:, 3]).all()  # the yaw has a pose, and nobody called its rate independent


def in_two_tables(log: Log) -> Log:
    """The climb rate in a table of its own, of every third sample."""
    columns = dict(log.tables["/odom"].columns)
    climb = {"header.stamp": columns["header.stamp"][1::3], "rate": columns.pop("twist.linear.z")[1::3]}
    return replace(log, tables={**log.tables, "/odom": Table("/odom", columns), "/climb": Table("/climb", climb)})


@pytest.mark.parametrize("clocked", [True, False])
def test_a_velocity_from_two_tables_is_joined_by_the_stamps(clocked: bool) -> None:
    sim = flown(axes=("x", "z"), duration=10.0)
    raw = dict(onboard_card().raw)
    velocity = {**raw["velocity"], "z": "/climb:rate"}
    if not clocked:
        del velocity["time"]
        raw["command"] = {**raw["command"], "time": "/cmd_vel:header.stamp"}
    log = in_two_tables(with_odometry(sim, rate=60.0, latency=0.0, **EXACT))
    flight = flight_from_log(log, card_from_mapping({**raw, "velocity": velocity}, "two"))

    assert flight.velocity is not None
    at = np.searchsorted(sim.pose_stamp / 1e9 - sim.command_stamp[0] / 1e9, flight.velocity.time - 1e-6)
    np.testing.assert_allclose(flight.velocity.value[:, [0, 2]], sim.velocity[at][:, [0, 2]], atol=0.02)
    assert "joined_velocity" in {note.code for note in flight.notes}


def test_positions_that_were_not_measured_are_the_velocity_summed_up(alone: tuple[Flight, Fit]) -> None:
    flight, sim = alone[0], flown(Truth(), ("x", "z"))
    late = np.abs(flight.velocity.value[:, 0]).max() * 0.06  # type: ignore[union-attr]
    drift = 0.01 * flight.duration  # of the bias
    travelled = flight.position[:, 0] - flight.position[0, 0]
    assert (
        np.abs(travelled - np.interp(flight.pose_time, sim.pose_stamp / 1e9, sim.true_pose[:, 0])).max()
        < late + drift + 0.05
    )
    assert [note.code for note in flight.notes if "velocity" in note.code] == ["velocity_only"]


def test_a_north_east_down_card_turns_the_velocity_as_it_turns_the_pose() -> None:
    log = with_odometry(flown(duration=6.0), latency=0.0, frame="world", **EXACT)
    plain = flight_from_log(log, onboard_card(frame="world")).velocity
    card = onboard_card(frame="world")
    turned = flight_from_log(log, card_from_mapping({**card.raw, "frame": "NED"}, "ned")).velocity

    assert plain is not None
    assert turned is not None
    np.testing.assert_array_equal(turned.value[:, :3], plain.value[:, [1, 0, 2]] * [1, 1, -1])


def test_repeats_are_dropped_where_they_are_no_rounding() -> None:
    log = with_odometry(flown(duration=8.0), latency=0.0)
    table = log.tables["/odom"]
    held = {
        name: np.repeat(column[::3], 3)[: column.size]
        for name, column in table.columns.items()
        if name != "header.stamp"
    }
    stale = replace(log, tables={**log.tables, "/odom": replace(table, columns={**table.columns, **held})})
    rounded = with_odometry(flown(duration=8.0), latency=0.0, rounding=0.1)

    some, every = (flight_from_log(each, onboard_card()) for each in (stale, rounded))
    assert some.velocity is not None
    assert every.velocity is not None
    assert some.velocity.time.size == pytest.approx(every.velocity.time.size / 3, abs=2)
    assert {"stale_velocities", "velocity_only"} <= {note.code for note in some.notes}
    assert "velocity_rounded" in {note.code for note in every.notes}
    np.testing.assert_allclose(every.velocity.grain[:3], 0.1)
    np.testing.assert_allclose(every.velocity.rounding[0], 0.01 / 12)


def test_rounding_is_told_from_the_values() -> None:
    rng = np.random.default_rng(0)
    fine, rough = rng.standard_normal(500), 0.2 * np.round(rng.standard_normal(500))

    np.testing.assert_allclose(grain(np.stack([fine, rough, np.zeros(500)], axis=1)), [0.0, 0.2, 0.0])
    assert coarse(np.stack([rough, np.zeros(500)], axis=1))
    assert not coarse(np.stack([rough, fine], axis=1))


def test_a_velocity_that_never_changes_is_refused() -> None:
    log = with_odometry(flown(duration=4.0))
    table = log.tables["/odom"]
    still = {name: column if name == "header.stamp" else 0 * column for name, column in table.columns.items()}

    with pytest.raises(FlightError, match="the velocity never changes"):
        flight_from_log(replace(log, tables={**log.tables, "/odom": replace(table, columns=still)}), onboard_card())


def test_a_velocity_beside_the_pose_is_not_used_unless_the_card_calls_it_independent() -> None:
    log = with_odometry(flown(duration=6.0))

    assert flight_from_log(log, onboard_card(())).velocity is None
    assert flight_from_log(log, onboard_card((), independent=True)).velocity is not None


# --- the likelihood


def test_the_filter_of_both_is_that_of_poses_where_there_are_only_poses(turning: Flight) -> None:
    plane, line = whole(replace(turning, velocity=None), ("x", "y")), whole(replace(turning, velocity=None), ("z",))
    rng, levels = np.random.default_rng(1), np.exp(np.tile(start_levels("position"), (2, 1)))
    noise = np.stack([levels[:, 1], np.ones(2)], axis=1)
    for rec, K in ((plane, 2), (line, 1)):
        columns, none = rng.standard_normal((rec.count.size, 3, K)), np.zeros(rec.count.size, bool)
        common = (rec.steps, rec.step, rec.count, rec.fresh)
        fused = whiten_fused(*common, none, rec.block_yaw, columns, levels[:K], noise[:K], 0.0, False)
        if K == 2:
            turned = np.ascontiguousarray(columns.transpose(0, 2, 1))
            rows, _, variance = whiten_plane(*common, rec.block_yaw, turned, levels[None], 0)
            rows = rows.transpose(0, 2, 1)
        else:
            rows, _, variance = whiten_axis(*common, columns[:, :, 0], levels[:1], 0)
            rows, variance = rows[:, :, None], variance[:, :, None]
        np.testing.assert_allclose(fused[0], rows, atol=1e-9 * np.abs(rows).max())
        np.testing.assert_allclose(fused[1], variance[0], rtol=1e-9)


def test_colouring_undoes_whitening(turning: Flight) -> None:
    rec = whole(turning, ("x", "y"))
    assert rec.rate is not None
    rng, levels = np.random.default_rng(2), np.exp(np.tile(start_levels("both"), (2, 1)))
    data = rng.standard_normal((rec.count.size, 2, 2))
    fixed = (rec.steps, rec.step, rec.count, rec.fresh, rec.rate, rec.block_yaw)

    given = levels, np.ascontiguousarray(levels[:, [1, 4]]), 0.1
    white, _ = whiten_fused(*fixed, data, *given, False)
    back, _ = whiten_fused(*fixed, white, *given, True)
    np.testing.assert_allclose(back, data, atol=1e-8)


def point_of(rec: Record) -> Point:
    K, rng = len(rec.axes), np.random.default_rng(5)
    point = start_point([rec], 0.14, 0.4, np.tile(start_levels(rec.measured), (K, 1)))
    return replace(point, gain=3.0 + rng.random(K), trim=0.05 * rng.standard_normal((1, K)))


@pytest.mark.parametrize("axes", [("x", "y"), ("z",)])
@pytest.mark.parametrize("lone", [False, True])
def test_the_score_is_the_slope_of_the_likelihood(turning: Flight, axes: tuple[str, ...], lone: bool) -> None:
    assert turning.velocity is not None
    flight = replace(turning, velocity=replace(turning.velocity, alone=("x", "y", "z"))) if lone else turning
    rec = whole(flight, axes)
    assert rec.measured == ("velocity" if lone else "both")
    point = point_of(rec)
    free = np.ones(point.flat().size, bool)
    fixed = restriction([rec], point, free)
    at = score([rec], point, fixed)
    for i in range(point.flat().size):
        step = np.zeros(point.flat().size)
        step[i] = 1e-5
        up, down = (score([rec], point.with_flat(point.flat() + s * step), fixed).objective for s in (1, -1))
        assert at.gradient[i] == pytest.approx((up - down) / 2e-5, rel=2e-3, abs=2e-2 * np.sqrt(at.information[i, i]))


def test_a_block_of_velocities_answers_with_the_velocity(turning: Flight) -> None:
    rec = whole(turning, ("x", "y"))
    assert rec.rate is not None
    point = point_of(rec)
    mean, _ = response(rec, point, 0, point.start)
    every = whole(replace(turning, velocity=None), ("x", "y"))
    position, _ = response(every, point, 0, point.start)
    slope = np.stack([np.gradient(position[:, k], every.block_time) for k in range(2)], axis=1)
    near = np.stack([np.interp(rec.block_time[rec.rate], every.block_time, slope[:, k]) for k in range(2)], axis=1)

    np.testing.assert_allclose(mean[rec.rate][2:-2], near[2:-2], atol=0.02)


def test_velocities_without_noise_give_the_coefficients_back_and_a_delay_with_their_latency() -> None:
    flight = flight_from_log(with_odometry(flown(), **EXACT), onboard_card())
    point = fit_as_flown([flight], axes=("x",)).model.axes["x"].predictor

    assert point is not None
    assert point.input == pytest.approx(STILL.gamma[0], rel=2e-4)
    assert point.damping == pytest.approx(STILL.gamma[1], rel=2e-3)
    assert point.delay == pytest.approx(STILL.delay[0] + 0.06, abs=2e-4)


def test_a_delay_that_the_cards_prior_gives_takes_no_error_from_the_latency_of_the_velocity() -> None:
    sim = flown(replace(Truth(), mocap_noise=(0.02, 0.02, 0.02, 0.01)), ("z",), seed=1, duration=20.0)
    flight = flight_from_log(with_odometry(sim, rate=50.0, noise=0.005), onboard_card((), independent=True))
    raw = {**flight.card.raw, "prior": {"z": {"delay": {"mean": 0.15, "sd": 1e-4}}}}
    result = fit(
        [replace(flight, card=card_from_mapping(raw, "mine"))], axes=("z",), structure="first_order_delay", prior=True
    )
    (used,) = result.flights
    assert used.velocity is not None
    assert used.velocity.late_error is not None

    assert used.velocity.late_error[2] > 5e-3
    assert delay_error([used], result.estimates["z"]) < 2e-4


def test_a_constant_bias_of_the_velocity_goes_into_the_trim() -> None:
    truth = replace(STILL)
    flights = [
        flight_from_log(with_odometry(flown(truth), noise=0.0, bias=bias), onboard_card()) for bias in (0.0, 0.05)
    ]
    without, biased = (fit_as_flown([flight], axes=("x",)).model.axes["x"] for flight in flights)

    assert without.predictor is not None
    assert biased.predictor is not None
    assert biased.predictor.input == pytest.approx(without.predictor.input, rel=1e-3)
    assert biased.trim[0] == pytest.approx((without.trim[0] or 0.0) + 0.05 * truth.gamma[1], abs=1e-3)


def test_intervals_hold_the_truth_and_the_noise_is_found(alone: tuple[Flight, Fit]) -> None:
    for axis in ("x", "z"):
        known, k = alone[1].model.axes[axis], AXES.index(axis)
        truth = {"input": Truth().gamma[2 * k], "damping": Truth().gamma[2 * k + 1], "delay": Truth().delay[k] + 0.06}
        for name, value in truth.items():
            low, high = known.ci95[name]
            assert low is not None
            assert high is not None
            middle, half = 0.5 * (low + high), 0.5 * (high - low)
            assert abs(value - middle) < 1.6 * half, (axis, name)
        assert np.sqrt(known.noise["velocity_variance"]) == pytest.approx(0.03, rel=0.1)
        assert "pose_variance" not in known.noise


def test_pose_and_velocity_together_know_more_than_a_poor_pose_alone() -> None:
    truth = Truth(mocap_noise=(0.05, 0.05, 0.05, 0.01), pose_rate=20.0, stale_share=0.0)
    flight = flight_from_log(with_odometry(flown(truth, seed=7)), onboard_card((), independent=True))
    both = fit_as_flown([flight], axes=("x",)).model.axes["x"]
    pose = fit_as_flown([replace(flight, velocity=None)], axes=("x",)).model.axes["x"]

    assert both.stderr["input"] < 0.8 * pose.stderr["input"]  # type: ignore[operator]
    low, high = both.ci95["delay"]
    assert low is not None
    assert high is not None
    assert low - 0.005 < truth.delay[0] < high + 0.005  # of the pose's clock: the latency is not in it
    assert np.sqrt(both.noise["velocity_variance"]) == pytest.approx(0.03, rel=0.15)
    assert np.sqrt(both.noise["pose_variance"]) == pytest.approx(0.05, rel=0.15)


def test_the_latency_is_found_with_an_interval_and_said() -> None:
    flight = flight_from_log(with_odometry(flown(Truth(), seed=5)), onboard_card((), independent=True))
    latency = latency_of(flight, ("x", "y"))

    assert latency is not None
    assert latency.low is not None
    assert latency.high is not None
    assert latency.value == pytest.approx(0.06, abs=0.006)
    assert 0.002 < latency.high - latency.low < 0.02
    notes = [
        note.text for note in fit_as_flown([flight], axes=("x",)).flights[0].notes if note.code == "velocity_latency"
    ]
    assert any("x, y is 6" in text or "x, y is 5" in text for text in notes)


# --- prediction and proof


def test_a_lone_velocity_is_scored_by_itself_and_its_position_by_nothing(alone: tuple[Flight, Fit]) -> None:
    other = flight_from_log(with_odometry(flown(Truth(), ("x", "z"), seed=9)), onboard_card())
    result = validate(alone[1].model, [other])
    own, held = (each[0].axes["x"].horizons["1"] for each in (result.flights, result.baselines["hold"]))

    assert own.position_rmse is None
    assert own.velocity_rmse is not None
    assert held.velocity_rmse is not None
    assert own.velocity_rmse < 0.5 * held.velocity_rmse
    assert own.velocity_rmse < 0.03
    assert result.residuals[0]["x"]


def test_a_prediction_knows_nothing_after_its_start(alone: tuple[Flight, Fit]) -> None:
    flight, found = alone
    assert flight.velocity is not None
    changed = flight.velocity.value.copy()
    changed[flight.velocity.time > 12.0] += 1.0
    later = replace(flight, velocity=replace(flight.velocity, value=changed))
    (one,), (two,) = (predict_flight(f, dynamics_from_model(found.model, f), 1.0) for f in (flight, later))
    before = one.start <= 12.0
    np.testing.assert_array_equal(one.predicted[before], two.predicted[before])
    assert not np.array_equal(one.predicted[~before], two.predicted[~before])


def test_the_model_file_keeps_the_noise_of_a_velocity(alone: tuple[Flight, Fit], tmp_path: Path) -> None:
    save(alone[1].model, tmp_path / "model.json")

    assert load(tmp_path / "model.json").axes["x"].noise == alone[1].model.axes["x"].noise


def test_a_model_of_velocities_does_not_judge_positions(alone: tuple[Flight, Fit]) -> None:
    posed = flight_from_log(with_odometry(flown(Truth(), seed=9)), onboard_card(()))

    with pytest.raises(
        FlightError, match="x is measured by its position, and the model knows the noise of its velocity"
    ):
        validate(alone[1].model, [posed])


@pytest.mark.parametrize("method", ["robust", "oe", "iv", "svf", "weak"])
def test_methods_that_need_positions_say_so(alone: tuple[Flight, Fit], method: Any) -> None:
    other = flight_from_log(with_odometry(flown(Truth(), ("x", "z"), seed=9)), onboard_card())
    posed, unposed = replace(other, velocity=None), replace(alone[0], path="alone.bag")

    with pytest.raises(FlightError, match=r"^alone\.bag: the method .* needs positions, but x, z have only a velocity"):
        fit([posed, unposed], method, axes=("x", "z"))


def test_the_papers_method_takes_the_summed_up_velocity(alone: tuple[Flight, Fit]) -> None:
    known = fit([alone[0]], "paper", axes=("x",)).model.axes["x"]

    assert known.predictor is not None
    assert known.predictor.input == pytest.approx(Truth().gamma[0], rel=0.4)


# --- the command line, on a log such as a Tello's


TELLO = """
frame = "NED"
[command]
time = { from = "timestamp", unit = "ms" }
x = { from = "Uz", scale = 0.01 }
yaw = { from = "Uyaw", scale = -0.01 }
[pose]
time = { from = "timestamp", unit = "ms" }
z = { from = "tof", unit = "cm", scale = -1 }
yaw = { from = "yaw", unit = "deg" }
[velocity]
x = { from = "vx", scale = 10, unit = "cm/s" }
y = { from = "vy", scale = 10, unit = "cm/s" }
"""


def tello_log(path: Path, seed: int) -> Path:
    """10 Hz, whole dm/s in the take-off frame, whole degrees clockwise, whole centimetres."""
    truth = Truth(pose_rate=10.0, stale_share=0.0, command_rate=10.0, pose_jitter=0.0)
    sim = flown(truth, ("x", "yaw"), seed, 40.0)
    t = sim.pose_stamp / 1e9
    u = sim.command[np.searchsorted(sim.command_stamp, sim.pose_stamp, side="right") - 1]
    yaw = -np.degrees(sim.true_pose[:, 3])
    forward = heading_from_world(sim.velocity[:, :2], np.zeros(t.size))
    columns = {
        "timestamp": 6000 + np.round(1e3 * t),
        "Uz": np.round(100 * u[:, 0]),
        "Uyaw": np.round(-100 * u[:, 3]),
        "yaw": np.round((yaw + 180) % 360 - 180),
        "vx": np.round(10 * forward[:, 0]),
        "vy": np.round(-10 * forward[:, 1]),
        "tof": np.round(100 * sim.true_pose[:, 2]),
    }
    rows = np.stack(list(columns.values()), axis=1).astype(int)
    path.write_text("\n".join([",".join(columns), *(",".join(map(str, row)) for row in rows.tolist())]))
    return path


def ran(*arguments: object) -> str:
    result = CliRunner().invoke(main, [str(argument) for argument in arguments])
    assert result.exit_code == 0, result.output
    return result.stdout


def test_info_fit_validate_and_report_work_on_a_log_without_x_and_y(tmp_path: Path) -> None:
    card, model = tmp_path / "card.toml", tmp_path / "model.json"
    card.write_text(TELLO)
    first, second = tello_log(tmp_path / "first.csv", 1), tello_log(tmp_path / "second.csv", 2)

    assert "x, y have no position" in ran("info", first, "--card", card)
    ran("fit", first, "--card", card, "--structure", "first_order_delay", "-o", model)
    known = json.loads(model.read_text())["axes"]["x"]
    assert known["status"]["input"] == "ok"
    low, high = known["ci95"]["input"]
    assert low < Truth().gamma[0] < high
    scored = json.loads(ran("validate", model, second, "--json"))["flights"][0]["axes"]["x"]["horizons"]["1"]
    assert scored["position_rmse"] is None
    assert scored["velocity_rmse"] < 0.1
    ran("validate", model, second)
    ran("report", model, second, "-o", tmp_path / "report.html")
    assert (tmp_path / "report.html").stat().st_size > 10_000


def test_the_tello_log_is_fitted_in_its_yaw_and_forward_velocity(real_flights: Path, tmp_path: Path) -> None:
    model = tmp_path / "model.json"
    ran(
        "fit",
        real_flights / "tello" / "demo_spotlight.txt",
        "--axes",
        "x,yaw",
        "--structure",
        "first_order_delay",
        "-o",
        model,
    )
    axes = json.loads(model.read_text())["axes"]

    low, high = axes["yaw"]["combinations"]["steady_gain"]["ci95_flight"]
    assert 0.9 < low < high < 1.15  # 100 of the stick are close to 1 rad/s
    assert axes["x"]["noise"]["velocity_variance"] >= 0
