"""Charts of flights: measured against modelled motion."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from models import model_of
from rotorfit.assessment.evidence import motion_of_flight
from rotorfit.assessment.validation import dynamics_from_model
from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES
from rotorfit.core.model import Axis, Combination, Mode, Model, Predictor, Source, unknown_axis
from rotorfit.dynamics.kinematics import motion_from_flight
from rotorfit.dynamics.protocol import predict_flight
from rotorfit.estimation.fitting import fit
from rotorfit.files.cards import load_card
from rotorfit.flights.assemble import flight_from_log
from rotorfit.planning.signals import two_sines
from rotorfit.reporting.charts import profile_charts
from rotorfit.reporting.figures import profile_range
from rotorfit.reporting.views import MOST_POINTS, Chart, extremes, flight_view
from rotorfit.simulation.paper_vehicle import GAMMA_B, Truth, as_log, simulate_flight

DELAY = 0.15


def flown(
    seconds: float = 16.0, axes: tuple[str, ...] = AXES, seed: int = 1, path: str = "flight.bag", yaw: float = 1.0
) -> Flight:
    """A simulated flight of the paper's kind; it starts turned, so that frames cannot be mistaken."""
    simulated = simulate_flight(Truth(), lambda t: two_sines(t, axes), seconds, seed, initial_yaw=yaw)
    return replace(flight_from_log(as_log(simulated), load_card("rotorfit-demo")), path=path)


@cache
def fitted() -> Model:
    """What the likelihood says of a flight: the disturbance levels of the models below."""
    return fit([flown(40.0)], structure="first_order_delay").model


def known_axis(axis: str) -> Axis:
    """The simulator's truth as if it had been estimated."""
    k = AXES.index(axis)
    g, b = GAMMA_B[2 * k : 2 * k + 2]
    return Axis(
        input=g,
        damping=b,
        delay=DELAY,
        stderr={"input": 0.02, "damping": 0.01, "delay": 0.004},
        ci95={"input": (g - 0.04, g + 0.04), "damping": (b - 0.02, b + 0.02), "delay": (0.142, 0.158)},
        status=dict.fromkeys(("input", "damping", "delay"), "ok"),
        trim=(0.0,),
        noise=fitted().axes[axis].noise,
        predictor=Predictor(g, b, DELAY),
        combinations={
            "steady_gain": Combination(g / b, (g / b - 0.1, g / b + 0.1)),
            "total_lag": Combination(DELAY + 1 / b, (DELAY + 1 / b - 0.1, None)),
        },
        modes=(
            Mode(DELAY, b, g, -3.0, 4, 0.02, chosen=True),
            Mode(0.01, 60.0, 90.0, 0.0, 2, 0.05, chosen=False),
        ),
        profile=((0.0, -90.0), (0.142, -1.92), (DELAY, 0.0), (0.158, -1.92), (0.6, -400.0)),
    )


def known_model(axes: tuple[str, ...] = AXES, status: str = "not_excited", flights: tuple[Flight, ...] = ()) -> Model:
    """A model that knows some axes exactly and nothing of the others."""
    return Model(
        card=load_card("rotorfit-demo"),
        structure="first_order_delay",
        method="ml",
        axes={axis: known_axis(axis) if axis in axes else unknown_axis(status) for axis in AXES},
        covariance_names=(),
        covariance=np.zeros((0, 0)),
        paper=tuple(value for k in range(4) for value in (GAMMA_B[2 * k], 0.5 * GAMMA_B[2 * k + 1])),
        findings=(),
        flights=tuple(Source(f.path, f.sha256, f.span, f.notes, f.moved) for f in flights),
    )


@pytest.fixture(scope="module")
def flight() -> Flight:
    return flown()


def chart_of(charts: tuple[Chart, ...], kind: str, axis: str) -> Chart:
    return next(chart for chart in charts if (chart.kind, chart.axis) == (kind, axis))


def line_of(chart: Chart, role: str) -> np.ndarray:
    return next(line.y for line in chart.lines if line.role == role)


def test_a_flight_shows_velocity_and_acceleration_of_every_axis_that_it_commands() -> None:
    flight = flown(axes=("x", "z"))

    view = flight_view(motion_of_flight(known_model(), flight), "validation")
    assert flight.moved == ("x", "z")
    assert [(c.kind, c.axis) for c in view.charts] == [
        (kind, axis) for kind in ("velocity", "acceleration") for axis in ("x", "z")
    ]
    assert (view.role, view.path, view.missing) == ("validation", "flight.bag", ())
    assert all(chart.x is view.charts[0].x for chart in view.charts)


def test_the_predicted_velocity_at_a_pose_is_that_of_the_start_half_a_second_to_a_second_before(flight: Flight) -> None:
    model = known_model()
    (part,) = predict_flight(flight, dynamics_from_model(model), 1.0)

    chart = chart_of(flight_view(motion_of_flight(model, flight), "validation").charts, "velocity", "z")
    predicted = line_of(chart, "model")
    for t, value in list(zip(chart.x, predicted, strict=True))[120::37]:
        start = int(np.flatnonzero((t > part.start + 0.5) & (t <= part.start + 1.0))[0])
        pose = int(np.argmin(np.abs(part.time - t)))
        assert value == part.predicted[start, pose - part.first[start], 1, 2]
    assert np.isnan(predicted[chart.x <= part.start[0] + 0.5]).all()


def test_velocities_are_in_the_heading_frame_and_the_true_model_predicts_them(flight: Flight) -> None:
    truth = simulate_flight(Truth(), two_sines, 16.0, 1, initial_yaw=1.0)
    at = (truth.pose_stamp - truth.command_stamp[0]) / 1e9
    c, s = np.cos(truth.true_pose[:, 3]), np.sin(truth.true_pose[:, 3])
    forward = c * truth.velocity[:, 0] + s * truth.velocity[:, 1]

    chart = chart_of(flight_view(motion_of_flight(known_model(), flight), "validation").charts, "velocity", "x")
    error = line_of(chart, "measured") - np.interp(chart.x, at, forward)
    assert np.sqrt(np.nanmean(error[5:-5] ** 2)) < 0.005
    assert np.sqrt(np.nanmean((line_of(chart, "model") - np.interp(chart.x, at, forward)) ** 2)) < 0.03


def test_the_modelled_acceleration_is_the_papers_equation_with_the_delayed_command(flight: Flight) -> None:
    motion = motion_from_flight(flight)
    gx, bx, gy, by = GAMMA_B[:4]

    charts = flight_view(motion_of_flight(known_model(), flight), "validation").charts
    chart = chart_of(charts, "acceleration", "x")
    y = line_of(chart, "model")
    measured = line_of(chart, "measured")
    for i in range(60, chart.x.size - 60, 41):
        pose = int(np.flatnonzero(motion.time == chart.x[i])[0])
        u = flight.command[np.flatnonzero(flight.command_time <= chart.x[i] - DELAY)[-1]]
        v, yaw = motion.velocity[pose], motion.yaw[pose]
        expected = np.cos(yaw) * (gx * u[0] - bx * v[0]) - np.sin(yaw) * (gy * u[1] - by * v[1])
        assert y[i] == pytest.approx(expected, abs=1e-12)
        assert measured[i] == motion.acceleration[pose, 0]


def test_an_axis_without_a_model_is_named_and_does_not_spoil_its_neighbour(flight: Flight) -> None:
    view = flight_view(motion_of_flight(known_model(("x", "yaw")), flight, True), "training")

    assert view.missing == ("y", "z")
    assert {chart.axis for chart in view.charts} == {"x", "yaw"}
    velocity = chart_of(view.charts, "velocity", "x")
    assert np.isfinite(line_of(velocity, "model")).mean() > 0.7
    assert np.isfinite(line_of(velocity, "paper")).mean() > 0.7


def test_without_any_model_nothing_is_drawn(flight: Flight) -> None:
    view = flight_view(motion_of_flight(known_model(()), flight), "training")

    assert view.charts == ()
    assert view.missing == AXES


def test_the_papers_coefficients_are_drawn_only_when_asked_for(flight: Flight) -> None:
    def roles(asked: bool) -> list[str]:
        view = flight_view(motion_of_flight(known_model(), flight, asked), "validation")
        return [line.role for line in chart_of(view.charts, "velocity", "x").lines]

    assert roles(False) == ["measured", "model"]
    assert roles(True) == ["measured", "paper", "model"]


def test_the_summary_tells_the_error_of_the_whole_series(flight: Flight) -> None:
    view = flight_view(motion_of_flight(known_model(), flight), "validation")
    chart = chart_of(view.charts, "velocity", "yaw")

    told = float(chart.summary.split("off by ")[1].split(" ")[0])
    error = line_of(chart, "model") - line_of(chart, "measured")
    assert told == pytest.approx(np.sqrt(np.nanmean(error**2)), rel=0.05)
    assert "rad/s RMS" in chart.summary


def test_a_long_flight_is_reduced_to_extremes_and_says_so(flight: Flight) -> None:
    whole = flight_view(motion_of_flight(known_model(), flight), "validation", MOST_POINTS)
    short = flight_view(motion_of_flight(known_model(), flight), "validation", 100)

    chart = chart_of(short.charts, "velocity", "x")
    assert chart.x.size <= 100
    assert (np.diff(chart.x) > 0).all()
    assert "extremes" in short.drawn
    assert "30 points a second" in whole.drawn
    measured = line_of(chart_of(whole.charts, "velocity", "x"), "measured")
    assert np.nanmax(line_of(chart, "measured")) == pytest.approx(np.nanmax(measured), rel=0.01)
    assert chart.summary == chart_of(whole.charts, "velocity", "x").summary


def test_extremes_keep_what_is_smallest_and_largest_in_the_order_of_the_trend() -> None:
    time = np.arange(8.0)
    values = np.array([[0.0, 5, 1, 9, 8, 2, 7, 1]]).T

    stamps, kept = extremes(time, values, 2)
    assert kept[:, 0].tolist() == [0.0, 9.0, 8.0, 1.0]
    assert (np.diff(stamps) > 0).all()


def test_lines_break_where_the_poses_have_a_hole(flight: Flight) -> None:
    keep = (flight.pose_time < 6) | (flight.pose_time > 9)
    holed = replace(flight, pose_time=flight.pose_time[keep], position=flight.position[keep], yaw=flight.yaw[keep])

    chart = chart_of(flight_view(motion_of_flight(known_model(), holed), "training").charts, "velocity", "x")
    (hole,) = np.flatnonzero(np.diff(chart.x) > 1)
    assert np.isnan(line_of(chart, "measured")[hole])
    assert np.isnan(line_of(chart, "model")[hole])


def test_a_profile_is_drawn_where_it_and_its_interval_are() -> None:
    model = model_of(error=0.01)
    x = replace(model.axes["x"], profile=((-0.1, -9e3), (0.098, -1.9), (0.1, 0.0), (0.103, -1.9), (0.6, -9e3)))

    def drawn(low: float | None, high: float) -> tuple[float, float]:
        one = replace(x, ci95={**x.ci95, "delay": (low, high)})
        return profile_range(profile_charts(replace(model, axes={**model.axes, "x": one}))[0])

    low, high = drawn(0.09, 0.11)

    assert 0.08 < low < 0.09
    assert 0.11 < high < 0.12
    assert drawn(None, 0.11)[0] < -0.1
