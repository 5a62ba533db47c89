"""The paired test of two predictors: it adds up to the scores, finds what is there, and only in 5 % what is not."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from test_validation import of

from flights import flown, steps
from rotorfit.assessment.paired import independent_frequencies, paired_test
from rotorfit.assessment.validation import dynamics_from_model
from rotorfit.core.frames import AXES, Array
from rotorfit.core.results import Difference, Paired, StartErrors
from rotorfit.dynamics.long_run import variance_of_mean
from rotorfit.dynamics.protocol import hold_velocity, predict_flight, score_predictions, start_errors
from rotorfit.simulation.paper_vehicle import Controller, Truth

ALL = (AXES,)


def errors_of(velocity: Array, position: Array | None = None, start: Array | None = None) -> dict[str, StartErrors]:
    """Errors of all axes at 1 s from mean squares of the starts, 10 steps each."""
    n = velocity.size
    every = np.repeat(velocity[:, None], 4, axis=1)
    ends = every if position is None else np.repeat(position[:, None], 4, axis=1)
    return {"1": StartErrors(0.5 * np.arange(n) if start is None else start, 10 * every, np.full((n, 4), 10.0), ends)}


def compared(a: Sequence[dict[str, StartErrors]], b: Sequence[dict[str, StartErrors]], axis: str = "x") -> Paired:
    return paired_test(("a", "b"), a, b, [AXES] * len(a)).axes[axis]["1"]["velocity"]


def real(found: Difference | None) -> Difference:
    """A difference with a standard error."""
    assert found is not None
    assert found.rmse_stderr is not None
    return found


def test_the_errors_of_the_starts_add_up_to_the_scores() -> None:
    flight = flown(Truth(), steps(seed=3), 20.0, 3, initial_yaw=0.5)
    parts = predict_flight(flight, dynamics_from_model(of()), 5.0)
    for predicted in ([part.predicted for part in parts], [hold_velocity(part) for part in parts]):
        scores = score_predictions(parts, predicted, (0.5, 5.0))
        for horizon in (0.5, 5.0):
            errors = start_errors(parts, predicted, horizon)
            for k, axis in enumerate(AXES):
                expected = scores[axis].horizons[f"{horizon:g}"]
                assert errors.start.size == expected.n
                velocity = math.sqrt(errors.velocity[:, k].sum() / errors.steps[:, k].sum())
                assert velocity == pytest.approx(expected.velocity_rmse, rel=1e-12)
                assert math.sqrt(errors.position[:, k].mean()) == pytest.approx(expected.position_rmse, rel=1e-12)


def test_differences_are_those_of_the_scores() -> None:
    rng = np.random.default_rng(1)
    a, b = rng.chisquare(1, 100), 2 * rng.chisquare(1, 100)

    found = real(compared([errors_of(a)], [errors_of(b)]).flights[0])
    assert found.mse == pytest.approx(a.mean() - b.mean())
    assert found.rmse == pytest.approx(math.sqrt(a.mean()) - math.sqrt(b.mean()))
    assert found.n == 100
    assert found.verdict == "better"


def test_the_standard_error_of_white_errors_is_the_textbooks() -> None:
    rng = np.random.default_rng(2)
    found = [
        real(compared([errors_of(a)], [errors_of(b)]).flights[0]).mse_stderr
        for a, b in (rng.chisquare(1, (2, 200)) for _ in range(300))
    ]

    assert np.mean(np.square(np.array(found, float))) == pytest.approx(4 / 200, rel=0.08)  # var of a chi-squared is 2


def test_the_variance_of_the_mean_of_a_coloured_series_is_that_of_its_lowest_frequencies() -> None:
    """An autoregression with coefficient 0.8: its mean varies nine times as much as that of a white series."""
    rng = np.random.default_rng(3)
    noise = rng.standard_normal((400, 1100))
    for t in range(1, 1100):
        noise[:, t] += 0.8 * noise[:, t - 1]
    series = noise[:, 100:]

    claimed = np.mean([variance_of_mean(row[:, None], 16)[0, 0] for row in series])
    assert claimed == pytest.approx(series.mean(axis=1).var(), rel=0.15)


def test_predictors_that_are_one_do_not_differ() -> None:
    a = np.random.default_rng(4).chisquare(1, 80)

    for b in (a, a * (1 + 1e-13)):
        found = real(compared([errors_of(a)], [errors_of(b)]).flights[0])
        assert (found.p, found.verdict) == (1.0, "no_difference_shown")


def test_exchanging_the_two_exchanges_the_verdict_and_nothing_else() -> None:
    rng = np.random.default_rng(5)
    a, b = errors_of(rng.chisquare(1, 80)), errors_of(3 * rng.chisquare(1, 80))

    one, two = (real(compared([x], [y]).pooled) for x, y in ((a, b), (b, a)))
    assert (one.verdict, two.verdict) == ("better", "worse")
    assert (one.rmse, one.p) == (pytest.approx(-two.rmse), pytest.approx(two.p))


def test_another_unit_changes_no_verdict() -> None:
    rng = np.random.default_rng(6)
    a, b = rng.chisquare(1, 80), 1.5 * rng.chisquare(1, 80)

    one, two = (real(compared([errors_of(s * a)], [errors_of(s * b)]).pooled) for s in (1.0, 1e4))
    assert two.rmse == pytest.approx(100 * one.rmse)
    assert two.p == pytest.approx(one.p)


def test_only_starts_that_both_have_are_compared() -> None:
    rng = np.random.default_rng(7)
    a, b = rng.chisquare(1, 80), rng.chisquare(1, 80)
    shifted = errors_of(b[20:], start=0.5 * np.arange(20, 80))

    found, expected = (
        real(compared([errors_of(x)], [y]).pooled) for x, y in ((a, shifted), (a[20:], errors_of(b[20:])))
    )
    assert found == expected


def test_a_flight_too_short_for_a_standard_error_gives_none_and_says_so() -> None:
    rng = np.random.default_rng(8)
    found = compared([errors_of(rng.chisquare(1, 8))], [errors_of(rng.chisquare(1, 8))]).flights[0]

    assert found is not None
    assert (found.rmse_stderr, found.p, found.verdict) == (None, None, "too_short")
    assert compared([errors_of(np.ones(4))], [errors_of(np.ones(4))]).flights == (None,)


def test_an_axis_without_a_model_has_no_difference() -> None:
    a = errors_of(np.ones(50))
    none = {"1": replace(a["1"], velocity=np.full((50, 4), np.nan), position=np.full((50, 4), np.nan))}

    found = paired_test(("a", "b"), [none], [a], ALL).axes["z"]["1"]
    assert found["velocity"] == found["position"] == Paired((None,), None, None)


def test_degrees_of_freedom_fall_with_the_overlap_of_the_predictions() -> None:
    """142 starts of 5 s, as on half a Bebop flight: seven frequencies, one every two horizons."""
    assert independent_frequencies(142, 5.0) == 7
    assert independent_frequencies(158, 1.0) == 11
    assert independent_frequencies(158, 0.2) == 11
    assert independent_frequencies(15, 5.0) == 0


# Several flights


def test_flights_are_kept_apart_and_pooled_by_their_predictions() -> None:
    rng = np.random.default_rng(9)
    a, b = [rng.chisquare(1, n) for n in (60, 120)], [2 * rng.chisquare(1, n) for n in (60, 120)]

    found = compared([errors_of(x) for x in a], [errors_of(x) for x in b])
    pooled = real(found.pooled)
    assert [real(each).n for each in found.flights] == [60, 120]
    assert pooled.n == 180
    assert pooled.mse == pytest.approx((np.concatenate(a) - np.concatenate(b)).mean())
    parts = [real(each) for each in found.flights]
    expected = math.sqrt(sum((each.n / 180 * (each.mse_stderr or 0.0)) ** 2 for each in parts))
    assert pooled.mse_stderr == pytest.approx(expected)
    assert max(each.freedom or 0.0 for each in parts) < (pooled.freedom or 0.0) < sum(e.freedom or 0 for e in parts)


def test_flights_that_contradict_each_other_are_told_from_those_that_agree() -> None:
    rng = np.random.default_rng(10)
    a = [errors_of(rng.chisquare(1, 150)) for _ in range(3)]
    alike = [errors_of(1.5 * rng.chisquare(1, 150)) for _ in range(3)]
    mixed = [errors_of(factor * rng.chisquare(1, 150)) for factor in (0.3, 1.0, 4.0)]

    agreeing, contradicting = compared(a, alike), compared(a, mixed)
    assert (agreeing.agreement or 0.0) > 0.05
    assert (contradicting.agreement or 1.0) < 0.01
    assert {real(each).verdict for each in contradicting.flights} >= {"better", "worse"}


def test_flights_that_were_fitted_or_do_not_move_the_axis_stay_out_of_the_pool() -> None:
    rng = np.random.default_rng(11)
    a, b = [errors_of(rng.chisquare(1, 60)) for _ in range(2)], [errors_of(rng.chisquare(1, 60)) for _ in range(2)]

    found = paired_test(("a", "b"), a, b, [("x",), ()]).axes
    assert found["x"]["1"]["velocity"].pooled == found["x"]["1"]["velocity"].flights[0]
    assert found["x"]["1"]["velocity"].flights[1] is not None
    assert found["y"]["1"]["velocity"].pooled is None


def test_a_short_flight_takes_no_verdict_from_the_others() -> None:
    rng = np.random.default_rng(12)
    a = [errors_of(rng.chisquare(1, n)) for n in (60, 90, 8)]
    b = [errors_of(factor * rng.chisquare(1, n)) for factor, n in ((3, 60), (2, 90), (3, 8))]

    found, long = compared(a, b), compared(a[:2], b[:2])
    assert real(found.pooled).verdict == "better"
    assert (found.pooled, found.agreement) == (long.pooled, long.agreement)
    assert (found.left_out, long.left_out) == (1, 0)
    assert [each.verdict for each in found.flights if each][2] == "too_short"


def test_where_all_flights_are_short_the_pool_is_too_and_none_is_left_out() -> None:
    rng = np.random.default_rng(13)
    found = compared(*([errors_of(rng.chisquare(1, 8)) for _ in range(3)] for _ in range(2)))

    assert found.pooled is not None
    assert (found.pooled.verdict, found.pooled.n, found.left_out) == ("too_short", 24, 0)


# Size and power


def windy_errors(rng: np.random.Generator, starts: int, horizon: float, share: float, wind_time: float = 2.0) -> tuple:
    """Errors of two models that are off by plus and minus the same share of the response, in the same wind.

    Wind and command are independent, so both have the same expected error exactly; the errors overlap as predictions
    do and go on as long as wind does.
    """
    dt = 0.1
    steps_ = round(horizon / dt)
    n = round(0.5 * starts / dt) + steps_ + 1
    wind, command = rng.standard_normal((2, n))
    for series, memory in ((wind, wind_time), (command, 1.5)):
        fade = math.exp(-dt / memory)
        for t in range(1, n):
            series[t] = fade * series[t - 1] + math.sqrt(1 - fade**2) * series[t]
    index = np.arange(starts)[:, None] * 5 + np.arange(steps_ + 1)
    moved = [np.cumsum(series)[index] for series in (wind, command)]
    wind_part, command_part = (part[:, 1:] - part[:, :1] for part in moved)
    return tuple(np.mean((wind_part + sign * share * command_part) ** 2, axis=1) for sign in (1, -1))


def rejected(seed: int, runs: int, starts: int, horizon: float, flights: int = 1) -> float:
    rng, key, count = np.random.default_rng(seed), f"{horizon:g}", 0
    for _ in range(runs):
        pairs = [windy_errors(rng, starts, horizon, 0.7) for _ in range(flights)]
        a, b = ([{key: errors_of(pair[i])["1"]} for pair in pairs] for i in (0, 1))
        found = paired_test(("a", "b"), a, b, [AXES] * flights).axes["x"][key]["velocity"].pooled
        count += real(found).verdict != "no_difference_shown"
    return count / runs


@pytest.mark.slow
@pytest.mark.parametrize(
    ("starts", "horizon", "flights"), [(150, 1.0, 1), (140, 5.0, 1), (90, 1.0, 1), (86, 5.0, 1), (86, 5.0, 3)]
)
def test_two_equally_good_predictors_differ_in_five_per_cent_of_the_cases(
    starts: int, horizon: float, flights: int
) -> None:
    """Measured 4.4 to 6.7 %; sums of autocovariances up to the horizon give up to 19 % on such series."""
    assert 0.025 < rejected(12, 1000, starts, horizon, flights) < 0.08


@pytest.mark.slow
def test_on_simulated_flights_models_that_err_to_both_sides_alike_differ_in_five_per_cent() -> None:
    """Gains 10 % too large and 10 % too small: the same expected error, on the same flights, through the protocol."""
    count = {"1": 0, "5": 0}
    models = [
        {axis: replace(d, input=s * d.input) for axis, d in dynamics_from_model(of()).items()} for s in (0.9, 1.1)
    ]
    for seed in range(200):
        truth = replace(Truth(), wind_sigma=(0.3, 0.3, 0.3, 0.1))
        flight = flown(truth, steps(seed=seed), 60.0, seed)
        parts = [predict_flight(flight, each, 5.0, ("x", "z")) for each in models]
        by = [[{key: start_errors(p, [part.predicted for part in p], float(key)) for key in count}] for p in parts]
        for key in count:
            for axis in ("x", "z"):
                found = paired_test(("a", "b"), *by, ALL).axes[axis][key]["velocity"].pooled
                count[key] += real(found).verdict != "no_difference_shown"

    assert all(0.02 < each / 400 < 0.085 for each in count.values()), count


def test_a_gain_that_is_off_by_a_fifth_is_told_on_a_minute_of_flight() -> None:
    """Power: of flights with feedback all but one tell it at 1 s."""
    dynamics, told = dynamics_from_model(of()), 0
    wrong = {axis: replace(d, input=1.2 * d.input) for axis, d in dynamics.items()}
    for seed in range(5):
        flight = flown(Truth(), steps(("x",), seed=seed), 60.0, seed, controller=Controller(0.3, 0.5))
        parts = [predict_flight(flight, each, 1.0, ("x",)) for each in (dynamics, wrong)]
        by = [[{"1": start_errors(p, [part.predicted for part in p], 1.0)}] for p in parts]
        told += real(paired_test(("a", "b"), *by, ALL).axes["x"]["1"]["velocity"].pooled).verdict == "better"

    assert told >= 4
