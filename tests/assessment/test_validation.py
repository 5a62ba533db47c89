"""Scores of models and baselines on other flights, and residuals."""

import json
from collections.abc import Mapping
from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest

from flights import CARD, by_hand, fit_as_flown, flown, recorded, steps
from rotorfit.assessment.innovations import residuals
from rotorfit.assessment.validation import dynamics_from_model, to_mapping, validate
from rotorfit.core.errors import FlightError
from rotorfit.core.finding import Finding, told_together
from rotorfit.core.flight_data import Flight, Segment
from rotorfit.core.frames import AXES
from rotorfit.core.model import Model, Predictor, unknown_axis
from rotorfit.core.results import pool_lines
from rotorfit.dynamics.protocol import hold_velocity, predict_flight, score_predictions
from rotorfit.estimation.fitting import fit
from rotorfit.planning.signals import two_sines
from rotorfit.simulation.paper_vehicle import GAMMA_B, Controller, Truth, simulate_flight

pytestmark = pytest.mark.flights

NOISE: Mapping[str, float] = {
    "wind_power": 1e-3,
    "pose_variance": 2.5e-7,
    "wind_damping": 3.0,
    "wind_overlap": 0.8,
    "trim_variance": 1e-5,
}


def of(paper: tuple[float | None, ...] = GAMMA_B, **predictors: Predictor | None) -> Model:
    """A model of the simulator's vehicle B; named axes have another predictor or none."""
    points = {axis: Predictor(GAMMA_B[2 * k], GAMMA_B[2 * k + 1], 0.15) for k, axis in enumerate(AXES)} | predictors
    axes = {
        name: replace(unknown_axis("ok" if point else "not_excited"), predictor=point, noise=NOISE)
        for name, point in points.items()
    }
    return Model(CARD, "first_order_delay", "ml", axes, (), np.zeros((0, 0)), paper, (), ())


@cache
def flight_of(seed: int = 3) -> Flight:
    return flown(Truth(), steps(seed=seed), 20.0, seed, initial_yaw=0.5)


# A case by hand: constant velocity


def straight() -> Flight:
    t = np.arange(0.0, 12.0, 0.01)
    pose = np.outer(t, [0.3, -0.2, 0.1, 0.0]) + np.array([0.0, 0.0, 1.0, 0.7])
    return by_hand(t, pose, np.arange(0.0, 12.0, 0.02), np.zeros((600, 4)))


def test_at_constant_velocity_holding_it_is_exact() -> None:
    quiet = dict(zip(NOISE, (1e-9, 1e-10, 0.05, 1.0, 1e-12), strict=True))
    model = of(**{axis: Predictor(1.0, 2.0, 0.0) for axis in AXES})
    model = replace(model, axes={name: replace(axis, noise=quiet) for name, axis in model.axes.items()})

    held = validate(model, [straight()], (1.0, 5.0)).baselines["hold"][0]
    for axis in AXES:
        for key in ("1", "5"):
            assert held.axes[axis].horizons[key].velocity_rmse == pytest.approx(0.0, abs=1e-3)
            assert held.axes[axis].horizons[key].position_rmse == pytest.approx(0.0, abs=2e-3)
    assert held.axes["x"].horizons["1"].n == 19  # starts at 2, 2.5, ... 11; the last pose is 10 ms before 12
    assert held.axes["x"].horizons["5"].n == 11


def test_n_counts_the_starts_whose_horizon_ends_inside_by_three_periods() -> None:
    found = validate(of(), [flight_of()], (0.5, 1.0, 5.0))
    end = flight_of().segments[0].end + 3 / 120

    for key, horizon in (("0.5", 0.5), ("1", 1.0), ("5", 5.0)):
        starts = np.arange(2.0, end - 0.1, 0.5)
        assert found.flights[0].axes["x"].horizons[key].n == np.sum(starts + horizon <= end)


# Shape


def test_the_result_has_the_shape_of_the_contract() -> None:
    raw = to_mapping(validate(of(), [flight_of(), flight_of(4)], (0.5, 1.0, 2.5)))

    json.dumps(raw, allow_nan=False)
    assert list(raw) == ["flights", "baselines", "paired", "residuals", "frequency_response", "bands", "findings"]
    assert set(raw["baselines"]) == {"hold", "paper", "coast"}
    for flights in (raw["flights"], *(raw["baselines"][name]["flights"] for name in ("hold", "paper"))):
        assert len(flights) == 2
        for flight in flights:
            assert set(flight["axes"]) == set(AXES)
            for axis in flight["axes"].values():
                assert list(axis["horizons"]) == ["0.5", "1", "2.5"]
                assert all(
                    set(errors) == {"velocity_rmse", "position_rmse", "n"} for errors in axis["horizons"].values()
                )
                assert "fit_percent" in axis


def test_the_true_model_predicts_better_than_the_baselines_on_every_axis() -> None:
    paper = fit([flight_of(9)], method="paper").model.paper
    found = validate(of(paper), [flight_of()], (1.0, 5.0))

    for axis in AXES:
        for key in ("1", "5"):
            model, hold, regressed = (
                flights[0].axes[axis].horizons[key].velocity_rmse
                for flights in (found.flights, found.baselines["hold"], found.baselines["paper"])
            )
            assert model is not None
            assert hold is not None
            assert regressed is not None
            assert model < 0.6 * regressed
            assert model < 0.3 * hold


def test_an_axis_without_a_predictor_has_null_scores_and_its_baselines_stay() -> None:
    found = validate(of(y=None), [flight_of()], (1.0,))

    scores = found.flights[0].axes["y"]
    assert scores.fit_percent is None
    assert scores.horizons["1"].velocity_rmse is None
    assert scores.horizons["1"].position_rmse is None
    assert found.baselines["hold"][0].axes["y"].horizons["1"].velocity_rmse is not None
    assert found.flights[0].axes["x"].horizons["1"].velocity_rmse is not None


def test_a_paper_baseline_without_a_coefficient_is_null_there_alone() -> None:
    paper = (None, None, *GAMMA_B[2:])
    found = validate(of(paper), [flight_of()], (1.0,)).baselines["paper"][0]

    assert found.axes["x"].horizons["1"].velocity_rmse is None
    assert found.axes["z"].horizons["1"].velocity_rmse is not None


def test_the_heading_is_predicted_where_yaw_is_known_and_measured_where_it_is_not_and_that_is_said() -> None:
    known, unknown = validate(of(), [flight_of()], (5.0,)), validate(of(yaw=None), [flight_of()], (5.0,))

    assert known.flights[0].heading == "predicted"
    assert unknown.flights[0].heading == "measured"
    errors = [v.flights[0].axes["x"].horizons["5"].position_rmse for v in (known, unknown)]
    assert errors[0] is not None
    assert errors[1] is not None
    assert errors[1] != errors[0]
    assert errors[1] == pytest.approx(errors[0], rel=0.2)


def test_a_wrong_yaw_spoils_x_and_y_as_it_is_the_models_own() -> None:
    wrong = of(yaw=Predictor(0.5 * GAMMA_B[6], GAMMA_B[7], 0.15))

    good, bad = (
        validate(model, [flight_of()], (5.0,)).flights[0].axes["x"].horizons["5"].position_rmse
        for model in (of(), wrong)
    )
    assert good is not None
    assert bad is not None
    assert bad > 1.5 * good


# The protocol is one


def test_scores_are_those_of_the_protocol() -> None:
    model, flight = of(), flight_of()
    parts = predict_flight(flight, dynamics_from_model(model), 5.0)

    found = validate(model, [flight], (1.0, 5.0))
    expected = score_predictions(parts, [part.predicted for part in parts], (1.0, 5.0))
    held = score_predictions(parts, [hold_velocity(part) for part in parts], (1.0, 5.0))
    assert found.flights[0].axes == expected
    assert found.baselines["hold"][0].axes == held


def test_longer_horizons_beside_it_change_no_score() -> None:
    one, more = validate(of(), [flight_of()], (1.0,)), validate(of(), [flight_of()], (1.0, 5.0))

    for axis in AXES:
        a, b = (v.flights[0].axes[axis].horizons["1"] for v in (one, more))
        assert a.n == b.n
        assert a.velocity_rmse == pytest.approx(b.velocity_rmse, rel=1e-12)


def test_nothing_outside_the_span_changes_a_score() -> None:
    """The filter of a span starts anew in it."""
    flight = simulate_flight(Truth(), steps(seed=3), 20.0, 3)
    seen = (flight.pose_stamp > 4_990_000_000) & (flight.pose_stamp < 15_010_000_000)
    sent = (flight.command_stamp > 4_990_000_000) & (flight.command_stamp < 15_010_000_000)
    other = replace(
        flight, pose=flight.pose + ~seen[:, None] * 2.0, command=np.where(sent[:, None], flight.command, 0.7)
    )

    one, two = (validate(of(), [recorded(f, (5.0, 15.0))], (1.0,)).flights[0].axes for f in (flight, other))
    assert one == two


def test_the_trim_of_the_training_flights_is_not_carried_to_another() -> None:
    truth = replace(Truth(), trim=(0.3, -0.2, 0.2, 0.1))
    model = fit([flown(truth, steps(seed=1), 15.0, 1)], structure="first_order_delay").model
    without = replace(model, axes={name: replace(axis, trim=(0.0,)) for name, axis in model.axes.items()})

    flight = flown(Truth(), steps(seed=2), 10.0, 2)
    assert to_mapping(validate(model, [flight])) == to_mapping(validate(without, [flight]))


def test_a_flight_too_short_to_score_gives_nulls_of_the_same_shape() -> None:
    short = replace(flight_of(), segments=(Segment(0.0, 1.5),))

    found = validate(of(), [short], (1.0,))
    for flights in (found.flights, *found.baselines.values()):
        for axis in AXES:
            scores = flights[0].axes[axis]
            assert (scores.horizons["1"].velocity_rmse, scores.horizons["1"].n, scores.fit_percent) == (None, 0, None)


def test_no_flight_and_no_horizon_are_refused() -> None:
    with pytest.raises(FlightError, match="no flight"):
        validate(of(), [])
    for horizons in ((), (0.0,), (-1.0, 2.0)):
        with pytest.raises(FlightError, match="horizons"):
            validate(of(), [flight_of()], horizons)


def test_an_unstable_model_of_the_paper_gives_finite_scores() -> None:
    unstable = replace(of((4.0, -0.5, 4.0, -0.5, 3.0, -1.0, 5.92, -0.38), x=Predictor(4.0, -0.3, 0.0)), method="paper")

    raw = to_mapping(validate(unstable, [flight_of()], (1.0, 5.0)))
    json.dumps(raw, allow_nan=False)
    assert raw["flights"][0]["axes"]["x"]["horizons"]["5"]["position_rmse"] > 0


# Residuals


@cache
def known() -> tuple[Flight, Model]:
    """A flight and what was fitted to it."""
    flight = flown(Truth(), steps(seed=1), 25.0, 1)
    return flight, fit([flight], structure="first_order_delay").model


def test_residuals_of_the_fitted_flight_are_white_and_of_unit_variance() -> None:
    flight, model = known()
    found = residuals(model, flight)

    assert set(found) == set(AXES)
    for axis in AXES:
        e = found[axis].innovation[30:]
        assert np.std(e) == pytest.approx(1.0, abs=0.08)
        for lag in range(1, 6):
            assert abs(np.mean(e[lag:] * e[:-lag])) < 4.5 / np.sqrt(e.size)


def test_residuals_of_a_wrong_model_are_not() -> None:
    flight, model = known()
    point = model.axes["z"].predictor
    assert point is not None
    wrong = replace(model, axes={**model.axes, "z": replace(model.axes["z"], predictor=replace(point, delay=0.4))})

    e = residuals(wrong, flight)["z"].innovation
    assert np.std(e) > 1.5


def test_residuals_of_one_axis_of_a_turning_vehicle_are_white_too() -> None:
    """Only x is known; y drifts. The mean heading is no frame for a vehicle that turns through radians."""
    flight = flown(Truth(), steps(("x", "yaw"), seed=1), 25.0, 1)
    model = fit([flight], structure="first_order_delay").model
    assert np.ptp(flight.yaw) > 1.5
    assert model.axes["y"].predictor is None

    e = residuals(model, flight)["x"].innovation[30:]
    assert np.std(e) == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize(("moved", "told"), [(("x", "y", "yaw"), ["x"]), (("x", "yaw"), []), (("x", "y"), [])])
def test_where_the_heading_turns_x_without_a_commanded_y_is_told_to_be_scored_for_it(
    moved: tuple[str, ...], told: list[str]
) -> None:
    flight = flown(Truth(), steps(moved, seed=1), 12.0, 1)

    landed = replace(flight, segments=(Segment(0.0, 8.0),), yaw=np.where(flight.pose_time > 8.0, flight.yaw, 0.0))

    for one, axes in ((flight, told), (landed, [])):
        found = [each.axis for each in validate(of(y=None), [one]).findings if each.code == "other_axis_unknown"]
        assert found == axes


def test_the_explained_response_follows_the_flight() -> None:
    flight = flown(replace(Truth(), wind_sigma=(0.0,) * 4), steps(("z",), seed=1), 20.0, 1)

    z = residuals(fit_as_flown([flight], axes=("z",)).model, flight)["z"]
    measured = np.interp(z.time, flight.pose_time, flight.position[:, 2])
    np.testing.assert_allclose(z.response - z.response[0], measured - measured[0], rtol=0, atol=0.02)


def test_axes_without_a_predictor_and_flights_too_short_have_no_residuals() -> None:
    model = fit_as_flown([flown(Truth(), partial(two_sines, axes=("yaw",)), 30.0)]).model

    assert set(residuals(model, flight_of())) == {"yaw"}
    assert residuals(model, replace(flight_of(), segments=(Segment(0.0, 0.7),))) == {}


# Commands that answer the motion


@cache
def in_a_loop() -> Flight:
    windy = Truth(wind_sigma=(0.3, 0.3, 0.3, 0.3))
    return flown(windy, steps(amplitude=0.1), 60.0, seed=3, controller=Controller(2.0, 2.5))


def test_beyond_a_second_commands_that_answer_the_motion_are_told_to_reveal_the_wind() -> None:
    def told(*flights: Flight, horizons: tuple[float, ...] = (1.0, 5.0)) -> list[str]:
        found = validate(of(), flights, horizons).findings
        return [one.evidence for one in told_together(found) if one.code == "commands_reveal_wind"]

    assert told(in_a_loop()) == ["the commands of x, y, z and yaw seem to answer the motion, as in a position loop"]
    assert told(in_a_loop(), horizons=(0.5, 1.0)) == []
    assert told(flight_of(), flight_of(4)) == []


# A flight that was read with another card


@pytest.mark.parametrize(("factor", "told"), [(-1.0, "scale = -1 for this flight"), (100.0, "per cent"), (1.0, "")])
def test_commands_of_another_sign_or_unit_are_the_cards_and_not_the_models(factor: float, told: str) -> None:
    flight, k = flight_of(), AXES.index("y")
    command = flight.command.copy()
    command[:, k] *= factor

    found = [one for one in validate(of(), [replace(flight, command=command)]).findings if one.code == "card_differs"]
    assert [one.axis for one in found] == (["y"] if told else [])
    assert all(told in one.remedy for one in found)
    ratio = float(found[0].evidence.split("moves ")[1].split()[0]) if found else 1.0
    assert ratio == pytest.approx(1 / factor, rel=0.2)


def test_a_misread_flight_hides_nothing_that_another_flight_says_of_the_model() -> None:
    flight, k = flight_of(), AXES.index("y")
    later = of(y=Predictor(GAMMA_B[2], GAMMA_B[3], 0.35))
    command = flight_of(4).command.copy()
    command[:, k] *= -1
    misread = replace(flight_of(4), command=command, path="misread.csv")

    alone = {one.code for one in validate(later, [flight]).findings if one.axis == "y"}
    beside = validate(later, [flight, misread]).findings

    assert "residuals_follow_command" in alone
    assert alone <= {one.code for one in beside if one.axis == "y" and "misread" not in one.evidence}
    assert [one.code for one in beside if "misread" in one.evidence] == ["card_differs"]


def test_errors_of_the_data_of_a_flight_are_told_first() -> None:
    wrong = Finding("axes_exchanged", "error", "x acts left", "none of it is the vehicle's", "exchange the columns")
    flight = replace(flight_of(), findings=(wrong,))

    validation = validate(of(), [flight])

    assert validation.findings[0] == replace(wrong, evidence=f"x acts left ({flight.path})")
    assert validation.misread == validation.findings[:1]


def test_what_a_flight_merely_holds_is_not_pooled_which_is_told_where_pooled_figures_are() -> None:
    held = flown(Truth(), steps(("x",), seed=1), 20.0, 1, controller=Controller(2.0, 2.0))
    moved = [
        replace(flown(Truth(), steps(("x", "z"), 1.0, seed=seed), 20.0, seed), path=f"{seed}.bag") for seed in (2, 3)
    ]
    found = validate(of(), [held, *moved])

    assert "z" in found.flights[0].held
    assert "z" not in found.flights[0].moved
    assert found.flights[0].axes["z"].horizons["1"].velocity_rmse is not None
    lines = pool_lines(found.flights, found.paired)
    assert len(lines) == 1
    assert "z" in lines[0]
    assert "merely held" in lines[0]
    assert "z" in to_mapping(found)["flights"][0]["held"]
