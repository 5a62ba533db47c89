"""Coefficients, scores, horizons, delay profiles, residuals."""

from dataclasses import replace

import numpy as np
import pytest
from test_views import flown, known_axis, known_model

from rotorfit.assessment.evidence import correlograms
from rotorfit.assessment.innovations import residuals
from rotorfit.assessment.rows import HorizonErrors, coefficient_rows, scores_of
from rotorfit.assessment.validation import validate
from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES
from rotorfit.core.frequency_response import FrequencyResponse, ResponseComparison
from rotorfit.core.model import Combination, unknown_axis
from rotorfit.core.residuals import Correlogram
from rotorfit.core.results import (
    AxisScore,
    Difference,
    FlightScores,
    Horizon,
    Paired,
    PairedTest,
    Validation,
    student_quantile,
)
from rotorfit.reporting.charts import horizon_charts, profile_charts, residual_charts
from rotorfit.reporting.drawing import draw_chart
from rotorfit.reporting.frequency import response_charts
from rotorfit.reporting.tables import paired_rows, unit_text
from rotorfit.reporting.views import Chart, Line

NOTHING = AxisScore({"1": Horizon(None, None, 0)}, None)


def scored(path: str, error: float | None, n: int) -> FlightScores:
    score = AxisScore({"1": Horizon(error, error, n)}, None)
    return FlightScores(path, (0.0, 16.0), {axis: score if axis == "z" else NOTHING for axis in AXES}, "measured")


@pytest.fixture(scope="module")
def flight() -> Flight:
    return flown()


def test_scores_are_pooled_by_the_number_of_predictions_over_the_flights_that_command_the_axis() -> None:
    flights = [flown(6.0, ("z",)), flown(6.0, ("z",)), flown(6.0, ("x",))]
    errors = [scored("a", 0.1, 10), scored("b", 0.2, 30), scored("c", 9.0, 100)]
    validation = Validation(tuple(errors), {"hold": tuple(errors), "paper": (scored("a", None, 0),) * 3})

    score = next(score for score in scores_of(validation, flights) if score.axis == "z")
    assert score.velocity["model"] == pytest.approx(np.sqrt((10 * 0.01 + 30 * 0.04) / 40))
    assert score.velocity["paper"] is None
    assert score.n == 40


def test_without_the_flights_all_scores_count() -> None:
    errors = (scored("a", 0.1, 10), scored("b", 0.2, 30))

    scores = scores_of(Validation(errors, {"hold": errors, "paper": errors}), ())
    assert next(score for score in scores if score.axis == "z").n == 40


def test_no_validation_gives_no_scores_and_no_charts() -> None:
    scores = scores_of(Validation((), {"hold": (), "paper": ()}), ())

    assert scores == ()
    assert horizon_charts(scores) == ()


def test_horizon_charts_hold_the_scores_in_units_for_people(flight: Flight) -> None:
    validation = validate(known_model(), [flight])
    velocity, position = (c for c in horizon_charts(scores_of(validation, [flight])) if c.axis == "yaw")

    error = validation.flights[0].axes["yaw"].horizons["1"]
    assert velocity.x.tolist() == [0.5, 1.0, 2.0, 5.0]
    assert [line.role for line in velocity.lines] == ["hold", "paper", "model"]
    assert velocity.lines[-1].y[1] == pytest.approx(np.degrees(error.velocity_rmse))
    assert position.lines[-1].y[1] == pytest.approx(np.degrees(error.position_rmse))
    assert "[deg/s]" in velocity.y_label


def test_the_band_of_a_horizon_chart_is_the_paired_interval_around_the_model(flight: Flight) -> None:
    validation = validate(known_model(), [flight])
    chart = horizon_charts(scores_of(validation, [flight]), validation.paired)[0]
    against = next(test for test in validation.paired if test.second == "paper").axes["x"]["1"]["velocity"].pooled

    low, high = (line.y for line in chart.lines if line.role == "band")
    own = next(line.y for line in chart.lines if line.role == "model")
    assert against is not None
    assert against.rmse_stderr is not None
    assert high[1] - own[1] == pytest.approx(100 * student_quantile(against.freedom or 0.0) * against.rmse_stderr)
    assert np.all((low[:2] < own[:2]) | np.isnan(low[:2]))


def test_a_band_that_reaches_down_to_zero_leaves_the_chart_and_does_not_stretch_it(flight: Flight) -> None:
    validation = validate(known_model(), [flight])
    for chart in horizon_charts(scores_of(validation, [flight]), [_uncertain(test) for test in validation.paired]):
        low, high = (line.y for line in chart.lines if line.role == "band")
        errors = np.concatenate([line.y for line in chart.lines if line.role != "band"])
        known = np.isfinite(high)

        assert known.any()
        assert chart.y_range is not None
        assert np.all((low[known] > 0) & (low[known] < chart.y_range[0]))
        assert chart.y_range == pytest.approx((0.7 * np.nanmin(errors), 1.4 * np.nanmax(high)))


def test_errors_that_are_all_zero_make_an_empty_chart() -> None:
    none = {"model": 0.0, "hold": 0.0, "paper": None}
    for chart in horizon_charts([HorizonErrors("yaw", 1.0, none, none, 10)]):
        assert chart.lines == ()
        draw_chart(chart, 300, 200)


def _uncertain(test: PairedTest) -> PairedTest:
    """A test whose standard errors are 100 times the differences."""
    axes = {
        axis: {
            key: {
                what: replace(one, pooled=one.pooled and replace(one.pooled, rmse_stderr=100 * abs(one.pooled.rmse)))
                for what, one in each.items()
            }
            for key, each in horizons.items()
        }
        for axis, horizons in test.axes.items()
    }
    return replace(test, axes=axes)


def test_an_axis_without_a_model_has_no_horizon_chart(flight: Flight) -> None:
    charts = horizon_charts(scores_of(validate(known_model(("x",)), [flight]), [flight]))

    assert {chart.axis for chart in charts} == {"x"}


def test_coefficients_stand_beside_the_papers_with_units_of_the_card() -> None:
    rows = {(row.axis, row.name): row for row in coefficient_rows(known_model(("x", "yaw")))}

    x = rows["x", "input"]
    assert (x.symbol, x.value, x.low, x.high, x.paper) == ("g1", 3.6976, 3.6576, 3.7376, 3.6976)
    assert (x.unit, x.per, unit_text(x)) == ("m/s^2", "full tilt", "m/s² per full tilt")
    assert rows["yaw", "damping"].symbol == "g8"
    assert rows["yaw", "steady_gain"].paper == pytest.approx(2 * 4.4168 / 2.7023)
    assert rows["yaw", "total_lag"].status == "open"
    assert (rows["z", "input"].value, rows["z", "input"].status) == (None, "not_excited")
    assert ("z", "steady_gain") not in rows


def test_a_paper_without_numbers_or_with_negative_damping_gives_no_lag() -> None:
    model = replace(known_model(), paper=(None, None, 4.0, -0.2, 2.0, 0.0, None, 1.0))
    rows = {(row.axis, row.name): row.paper for row in coefficient_rows(model)}

    assert rows["x", "steady_gain"] is None
    assert (rows["y", "steady_gain"], rows["y", "total_lag"]) == (-20.0, None)
    assert rows["z", "steady_gain"] is None
    assert rows["yaw", "damping"] == 1.0


def test_the_profile_carries_the_interval_and_all_optima_relative_to_the_chosen_one() -> None:
    chart = profile_charts(known_model(("x",)))[0]

    assert chart.x.tolist() == [0.0, 0.142, 0.15, 0.158, 0.6]
    assert chart.span == (0.142, 0.158)
    assert [(mark.role, mark.y) for mark in chart.marks] == [("chosen", 0.0), ("rejected", 3.0)]
    assert chart.levels[0][0] == -1.92
    assert "4 of 6 starts reached this optimum" in chart.summary
    assert chart.y_range == (-25.0, pytest.approx(3.3))


def test_the_shaded_interval_is_said_to_be_the_vehicles_and_not_that_of_the_curve() -> None:
    wide = replace(known_axis("x"), ci95={**known_axis("x").ci95, "delay": (-0.3, 0.5)})
    chart = profile_charts(replace(known_model(), axes={"x": wide} | dict.fromkeys(AXES[1:], unknown_axis("ok"))))[0]

    assert "The shaded one is the vehicle's" in chart.reading
    assert "interval for the vehicle -0.300 to 0.500 s" in chart.summary


@pytest.mark.parametrize(("top", "missed"), [(30.0, True), (2.9, False)])
def test_a_profile_that_rises_above_the_optima_shows_that_the_search_missed_one(top: float, missed: bool) -> None:
    """Up to 3 it rises to the optimum that was found and rejected."""
    one = known_axis("x")
    axis = replace(one, profile=(*one.profile[:-1], (0.2, top)), modes=one.modes)
    chart = profile_charts(replace(known_model(), axes={**known_model().axes, "x": axis}))[0]

    assert ("the search missed a better one: at 0.200 s the curve is at +30.0" in chart.summary) == missed
    lone = replace(axis, modes=one.modes[:1])
    alone = profile_charts(replace(known_model(), axes={**known_model().axes, "x": lone}))[0]
    assert "no other was found" not in alone.summary


def test_an_open_end_of_the_delays_interval_is_infinite() -> None:
    axis = replace(known_axis("x"), ci95={**known_axis("x").ci95, "delay": (None, 0.2)})
    model = known_model()

    chart = profile_charts(replace(model, axes={**model.axes, "x": axis}))[0]
    assert chart.span == (-np.inf, 0.2)
    assert "open to 0.200 s" in chart.summary


def test_no_profile_no_chart() -> None:
    assert profile_charts(known_model(())) == ()
    assert profile_charts(replace(known_model(), axes=dict.fromkeys(AXES, unknown_axis("diverged")))) == ()


def test_the_autocorrelation_is_that_of_the_innovations_and_the_true_model_is_white(flight: Flight) -> None:
    innovation = residuals(known_model(), flight, own_levels=True)["z"].innovation
    centred = innovation - innovation.mean()

    chart = next(chart for chart in residual_charts(*correlograms(known_model(), [flight])) if chart.axis == "z")
    bars, high, low = (line.y for line in chart.lines)
    assert [line.role for line in chart.lines] == ["residual", "band", "band"]
    assert bars[2] == pytest.approx(centred[3:] @ centred[:-3] / (centred @ centred), abs=2e-3)
    assert np.median(high) == pytest.approx(1.96 / np.sqrt(centred.size), rel=0.1)
    np.testing.assert_array_equal(low, -high)
    assert chart.x[0] == pytest.approx(1 / 30, rel=0.05)
    assert np.mean(np.abs(bars) > high) < 0.15


def test_past_commands_have_a_chart_of_their_own_without_those_that_came_after(flight: Flight) -> None:
    charts = [chart for chart in residual_charts(*correlograms(known_model(), [flight])) if chart.axis == "yaw"]

    assert [chart.y_label for chart in charts] == ["autocorrelation", "correlation"]
    assert charts[1].x.min() > 0
    assert charts[1].x.max() == pytest.approx(1.0, abs=0.05)


def test_a_band_wider_than_any_correlation_is_no_band() -> None:
    lag = np.arange(1, 11) / 10
    free = {"yaw": Correlogram(lag, np.full(10, 0.1), np.full(10, 11312.0)), "z": Correlogram(lag, lag, lag)}
    yaw, z = residual_charts({}, {name: free[name] for name in ("yaw", "z")})

    assert yaw.summary == "yaw: not tested: the coefficients are not known well enough."
    assert np.isnan(yaw.lines[1].y).all()
    assert "0.00" in [tick.text for tick in draw_chart(yaw, 300, 200).y_ticks]  # where the bars begin
    assert "±" not in "".join(stop.text for stop in draw_chart(yaw, 300, 200).stops)
    assert "(0.45 expected by chance)" in z.summary


def test_the_models_delay_has_no_band_where_a_whole_turn_of_phase_is_possible() -> None:
    shape = np.ones(2)
    flight = FrequencyResponse(
        "yaw", np.array([2.0, 4.0]), shape + 0j, np.full((2, 2), 0.1), shape, shape, "tones", expected=-shape
    )
    compared = ResponseComparison(flight, shape + 0j, np.array([[0.9, 1.1]] * 2), np.array([1050.0, 0.01]))
    gain, delay = response_charts([{"yaw": compared}])

    assert gain.y_label == "gain [rad/s per command]"
    assert [np.isfinite(line.y).tolist() for line in delay.lines if line.role == "paper"] == [[False, True]] * 2


def test_no_number_is_shown_of_which_the_data_say_nothing() -> None:
    axis = replace(known_axis("z"), combinations={"total_lag": Combination(0.06, (None, None))})
    rows = coefficient_rows(replace(known_model(), axes={**known_model().axes, "z": axis}))

    (row,) = (row for row in rows if (row.axis, row.name) == ("z", "total_lag"))
    assert (row.value, row.status) == (None, "open")


def test_differences_and_delays_are_written_without_powers_of_ten(flight: Flight) -> None:
    found = Difference(40, -1.43, 0.2, 1e6, 0.001, -2.0, 0.3, "better")
    paired = Paired((found,), found, None)
    test = PairedTest("model", "hold", {axis: {"1": {"velocity": paired, "position": paired}} for axis in AXES})
    row = paired_rows(replace(validate(known_model(), [flight]), paired=(test,)))[0]
    assert row[4] == "−143 (−182 to −104) cm/s"

    short = replace(paired, flights=(found, None), left_out=1)
    test = PairedTest("model", "hold", {axis: {"1": {"velocity": short, "position": short}} for axis in AXES})
    once = validate(known_model(), [flight])
    pooled = paired_rows(replace(once, flights=once.flights * 2, paired=(test,)))[1]
    assert pooled[0] == "all that were not fitted, less 1 too short"

    line = Line("x", "model", np.array([1.0, 2.0]))
    chart = Chart("profile", "x", "x", "delay [s]", "y", np.array([-1.39e-17, 0.1]), (line,), "", "")
    assert [stop.text for stop in draw_chart(chart, 300, 200).stops] == ["delay 0 s: 1", "delay 0.1 s: 2"]


def test_flights_are_pooled_in_the_charts_by_what_they_know() -> None:
    flights = [flown(8.0, ("z",), seed=3), flown(16.0, ("z",), seed=4)]
    alone = [residual_charts(*correlograms(known_model(("z",)), [flight]))[0].lines for flight in flights]

    together = residual_charts(*correlograms(known_model(("z",)), flights))[0].lines
    weight = [1 / lines[1].y[:40] ** 2 for lines in alone]
    expected = sum(w * lines[0].y[:40] for w, lines in zip(weight, alone, strict=True)) / sum(weight)
    np.testing.assert_allclose(together[0].y[:40], expected, rtol=0, atol=1e-12)
    assert np.all(together[1].y[:40] < np.minimum(alone[0][1].y[:40], alone[1][1].y[:40]))


def test_residuals_need_a_flight_that_commands_an_axis_with_a_model() -> None:
    assert residual_charts(*correlograms(known_model(), [])) == ()
    assert residual_charts(*correlograms(known_model(("x",)), [flown(6.0, ("z",))])) == ()
