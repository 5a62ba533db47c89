"""Tests of the innovations: right rates on what is right, and sure on what is wrong."""

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from flights import flown, steps
from other_laws import flown_by
from rotorfit.assessment.innovations import parameter_covariance, residual_tests_of_flight, residuals
from rotorfit.assessment.validation import validate
from rotorfit.assessment.whiteness import (
    FINDING_LEVEL,
    autocorrelation,
    cross_correlation,
    findings_of_residuals,
    narrows_intervals,
    residual_tests,
)
from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES, Array
from rotorfit.core.model import COEFFICIENTS, Model, Predictor
from rotorfit.core.residuals import Innovations, ResidualTests
from rotorfit.estimation.fitting import fit
from rotorfit.simulation.paper_vehicle import Controller, Truth

pytestmark = pytest.mark.flights

N = 1500
TIME = np.arange(N) / 30
LAGS = 30
NONE = np.zeros((3, 3))


def past_commands(rng: np.random.Generator, n: int = N) -> Array:
    """Steps of about 0.7 s, seen 1 to 30 blocks later."""
    level = np.repeat(rng.integers(-1, 2, n // 20 + 4), 20)[: n + LAGS].astype(float)
    return np.stack([level[LAGS - k : LAGS - k + n] for k in range(1, LAGS + 1)], axis=1)


def of(innovation: Array, past: Array | None = None, time: Array = TIME) -> Innovations:
    rng = np.random.default_rng(99)
    n = innovation.size
    return Innovations(time, innovation, past_commands(rng, n) if past is None else past, rng.standard_normal((n, 3)))


def outcome(innovations: Innovations) -> ResidualTests:
    found = residual_tests(innovations, innovations.innovation, NONE, 0.0)
    assert found is not None
    return found


def coloured(rng: np.random.Generator, fade: float, n: int = N) -> Array:
    e = rng.standard_normal(n)
    for t in range(1, n):
        e[t] += fade * e[t - 1]
    return e * np.sqrt(1 - fade**2)


# Synthetic innovations


def test_each_test_fires_on_white_innovations_in_about_five_per_cent() -> None:
    rng, fired = np.random.default_rng(1), np.zeros(4)
    for _ in range(300):
        found = outcome(of(rng.standard_normal(N), past_commands(rng)))
        low, high = found.variance_ci95
        fired += [not found.white, found.ljung_box_p < 0.05, bool(found.follows_command), not low <= 1 <= high]

    assert np.all((fired > 300 * 0.02) & (fired < 300 * 0.09)), fired


def test_the_strongest_lag_is_none_of_those_without_a_command() -> None:
    rng = np.random.default_rng(5)
    past = past_commands(rng)
    past[:, :10] = 0.3  # has not changed yet
    found = outcome(of(rng.standard_normal(N) + 0.3 * past[:, 14], past))

    assert found.command_peak_lag == pytest.approx(0.5, abs=0.04)
    assert found.command_peak is not None
    assert found.command_peak > 1


def test_a_right_model_of_a_short_flight_does_not_follow_commands_by_chance() -> None:
    """Of 5 s commands explain a tenth of white innovations by chance; what they leave of it is no measure of noise."""
    rng, found = np.random.default_rng(1), 0
    for _ in range(150):
        p = outcome(of(rng.standard_normal(150), past_commands(rng, 150), TIME[:150])).command_p
        found += p is not None and p < FINDING_LEVEL

    assert found <= 2


def test_gusts_do_not_make_white_innovations_look_coloured() -> None:
    """Gusts four times as strong, in bursts of 1 s: the classic p-value rejects far too often."""
    rng, plain, robust = np.random.default_rng(2), 0, 0
    for _ in range(80):
        strength = np.repeat(np.where(rng.random(N // 30) < 0.2, 4.0, 1.0), 30)
        found = outcome(of(strength * rng.standard_normal(N)))
        plain, robust = plain + (found.ljung_box_p < 0.05), robust + (not found.white)

    assert plain > 16
    assert robust < 8


def test_colour_is_found_and_the_intervals_are_called_too_narrow_by_the_right_factor() -> None:
    """A slow weight on innovations of an autoregression with 0.3: Bartlett's sum is (1 + 0.3) / (1 - 0.3)."""
    rng, factors = np.random.default_rng(3), []
    slow = np.sin(2 * np.pi * TIME / 20)
    for _ in range(20):
        innovations = replace(of(coloured(rng, 0.3)), sensitivity=np.stack([slow, TIME, slow**2], axis=1))
        found = outcome(innovations)
        assert not found.white
        factors.append(found.optimism["input"])

    assert np.mean(factors) == pytest.approx(np.sqrt(1.3 / 0.7), rel=0.05)


def test_innovations_that_follow_a_past_command_are_found_with_its_lag() -> None:
    rng = np.random.default_rng(4)
    past = past_commands(rng)
    change = past[:, 5] - past[:, 6]  # an answer to the step of 6 blocks ago that the model does not have

    found = outcome(of(rng.standard_normal(N) + 1.5 * change, past))
    assert found.follows_command
    assert found.command_p is not None
    assert found.command_p < 1e-4


def test_what_the_model_may_be_off_by_is_not_held_against_it() -> None:
    """Coefficients drawn from their own covariance: with it, past commands are free in 95 %; without, hardly ever."""
    rng, with_it, without = np.random.default_rng(5), 0, 0
    covariance = np.diag([0.02, 0.0, 0.0])
    for _ in range(80):
        past = past_commands(rng)
        sensitivity = np.stack([past[:, 3], TIME, np.ones(N)], axis=1)
        e = rng.standard_normal(N) - sensitivity[:, 0] * rng.normal(0, np.sqrt(0.02))
        innovations = Innovations(TIME, e, past, sensitivity)
        found = [residual_tests(innovations, e, c, 0.0) for c in (covariance, NONE)]
        with_it += bool(found[0] and found[0].follows_command)
        without += bool(found[1] and found[1].follows_command)

    assert with_it < 8
    assert without > 24


def test_pairs_across_a_hole_do_not_count() -> None:
    """Two halves 10 s apart, whose signs do not alternate at the seam."""
    e = np.concatenate([np.tile([1.0, -1.0], 100), np.tile([-1.0, 1.0], 100)])
    whole, cut = np.arange(400) / 30, np.concatenate([np.arange(200), 500 + np.arange(200)]) / 30

    near, apart = (autocorrelation(time, e).value[0] * 400 for time in (whole, cut))
    assert near == pytest.approx(-397)
    assert apart == pytest.approx(-399)  # as of 399 pairs: what a hole takes does not make a correlation smaller


def test_blocks_of_alternating_lengths_have_all_their_pairs() -> None:
    """At 50 Hz blocks of poses last 0.03, 0.03 and 0.04 s in turn."""
    rng = np.random.default_rng(8)
    e = rng.standard_normal(N)
    e[6:] += 0.8 * e[:-6]
    time = np.cumsum(np.resize([0.03, 0.03, 0.04], N))

    found, even = autocorrelation(time, e), autocorrelation(np.arange(N) / 30, e)

    np.testing.assert_allclose(found.value, even.value)
    np.testing.assert_allclose(found.lag, even.lag, rtol=1e-3)
    assert found.value[5] > 0.4


def test_bands_are_those_of_white_noise_where_nothing_changes() -> None:
    rng = np.random.default_rng(6)
    innovations = of(rng.standard_normal(N))

    np.testing.assert_allclose(autocorrelation(TIME, innovations.innovation).band, 1.96 / np.sqrt(N), rtol=0.15)
    np.testing.assert_allclose(cross_correlation(innovations, NONE).band, 1.96 / np.sqrt(N), rtol=0.25)


def test_coefficients_that_could_explain_any_correlation_leave_past_commands_untested() -> None:
    past = past_commands(np.random.default_rng(5))
    innovations = of(np.random.default_rng(4).standard_normal(N) + past[:, 6], past)
    found = residual_tests(innovations, innovations.innovation, 1e12 * np.eye(3), 0.0)

    assert found is not None
    assert (found.command_p, found.follows_command) == (None, None)
    assert outcome(innovations).follows_command


def test_few_innovations_are_not_tested_and_an_axis_at_rest_is_not_asked_for_commands() -> None:
    few = of(np.ones(99), time=TIME[:99])
    assert residual_tests(few, few.innovation, NONE, 0.0) is None

    rng = np.random.default_rng(7)
    found = outcome(of(rng.standard_normal(N), np.zeros((N, LAGS))))
    assert (found.command_p, found.follows_command, found.command_freedom, found.command_peak_lag) == (
        None,
        None,
        0,
        None,
    )


def test_the_variance_ratio_knows_how_little_a_short_fit_knows_of_its_levels() -> None:
    innovations = of(np.random.default_rng(8).standard_normal(N))

    widths = []
    for share in (0.0, 3.0):
        found = residual_tests(innovations, innovations.innovation, NONE, share)
        assert found is not None
        widths.append(found.variance_ci95[1] - found.variance_ci95[0])
    assert widths[1] == pytest.approx(2 * widths[0])


# Findings


def test_findings_come_with_evidence_and_the_factor_of_the_intervals() -> None:
    rng = np.random.default_rng(9)
    slow = np.sin(2 * np.pi * TIME / 20)
    past = past_commands(rng)
    e = coloured(rng, 0.4) + 2.0 * (past[:, 5] - past[:, 6])
    tests = outcome(Innovations(TIME, e, past, np.stack([slow, slow**2, TIME], axis=1)))
    white, follow = findings_of_residuals("x", tests, "flight.bag")

    assert (white.code, white.severity, white.axis) == ("residuals_not_white", "warning", "x")
    assert narrows_intervals(tests)
    assert f"{max(tests.optimism.values()):.2f}" in white.effect
    assert (follow.code, follow.severity) == ("residuals_follow_command", "warning")
    assert "flight.bag" in follow.evidence


def test_colour_that_hardly_touches_the_coefficients_is_no_warning() -> None:
    rng = np.random.default_rng(10)
    fast = np.sin(2 * np.pi * TIME * 8)
    tests = outcome(replace(of(coloured(rng, 0.3)), sensitivity=np.stack([fast, fast**2 - 0.5, fast**3], axis=1)))

    found = list(findings_of_residuals("z", tests, "flight.bag"))
    assert [(f.code, f.severity) for f in found] == [("residuals_not_white", "info")]


# Flights


@cache
def pair(seed: int, feedback: bool = False) -> tuple[Model, Flight]:
    """A model from one simulated flight, and another flight."""
    controller = Controller() if feedback else None
    first, second = (flown(Truth(), steps(seed=s), 40.0, s, controller=controller) for s in (seed, seed + 4000))
    return fit([first], structure="first_order_delay").model, second


def test_the_past_of_a_flight_is_what_was_sent_before() -> None:
    model, flight = pair(1000)
    z = residuals(model, flight)["z"]

    step = np.median(np.diff(z.time))
    for row in (40, 300):
        for k in (1, 5, 30):
            sent = np.flatnonzero(flight.command_time <= z.time[row] - k * step)[-1]
            assert z.past[row, k - 1] == flight.command[sent, 2]


def test_sensitivities_are_those_of_the_innovations() -> None:
    """Less trim and start: a change of the gain changes the innovations by their product, but for those."""
    model, flight = pair(1000)
    z, point = residuals(model, flight)["z"], model.axes["z"].predictor
    assert point is not None
    moved = replace(model.axes["z"], predictor=replace(point, input=1.01 * point.input))
    other = residuals(replace(model, axes={**model.axes, "z": moved}), flight)["z"]

    change = other.innovation - z.innovation
    expected = -0.01 * point.input * z.sensitivity[:, 0]
    assert np.linalg.norm(change - expected) < 0.02 * np.linalg.norm(expected)


def test_the_interval_of_the_flight_is_that_of_its_sensitivities_and_the_covariance_of_the_vehicle_is_wider() -> None:
    flight = flown(Truth(), steps(seed=1000), 40.0, 1000)
    model = pair(1000)[0]
    sensitivity = residuals(model, flight)["x"].sensitivity

    own = np.sqrt(np.diag(np.linalg.inv(sensitivity.T @ sensitivity)))
    ends = np.array([model.axes["x"].ci95_flight[name] for name in COEFFICIENTS], float)
    ends[1] = np.log(ends[1])
    np.testing.assert_allclose(own, np.ptp(ends, axis=1) / (2 * 1.96), rtol=0.05)
    vehicle = np.sqrt(np.diag(parameter_covariance(model, "x")))
    assert (own < vehicle).all()
    assert (vehicle < 2.5 * own).all()


def test_what_the_lag_may_be_off_by_is_not_held_against_the_model() -> None:
    """A lag that is off by 3 standard errors, and what it takes the coefficients along with, as 15 s allow."""
    model = fit([flown_by("first_order_delay_lag", duration=15.0, wind=0.05, noise=0.001)], axes=("z",)).model
    other = flown_by("first_order_delay_lag", duration=60.0, seed=2, wind=0.05, noise=0.001)
    z, point, covariance = model.axes["z"], model.axes["z"].predictor, parameter_covariance(model, "z")
    assert point is not None
    assert covariance[3, 3] == pytest.approx((z.stderr["lag"] / point.extra["lag"]) ** 2)

    gain, damping, delay, lag = 3 * covariance[:, 3] / np.sqrt(covariance[3, 3])
    extra = {"lag": point.extra["lag"] * np.exp(lag)}
    off = Predictor(point.input + gain, point.damping * np.exp(damping), point.delay + delay, extra)
    moved = replace(model, axes={**model.axes, "z": replace(z, predictor=off)})
    found = residuals(moved, other, own_levels=True)["z"]
    whole, without = (
        residual_tests(found.innovations, found.innovation, known, 0.0)
        for known in (covariance, covariance * np.outer([1, 1, 1, 0], [1, 1, 1, 0]))
    )
    assert whole is not None
    assert without is not None
    assert (whole.follows_command, without.follows_command) == (False, True)


def test_a_wrong_delay_is_seen_in_the_commands_that_the_innovations_follow() -> None:
    model, flight = pair(1000)
    point = model.axes["x"].predictor
    assert point is not None
    wrong = replace(model.axes["x"], predictor=replace(point, delay=point.delay + 0.03))
    found = validate(replace(model, axes={**model.axes, "x": wrong}), [flight], (1.0,))

    assert ("residuals_follow_command", "x") in {(finding.code, finding.axis) for finding in found.findings}
    assert "residuals_follow_command" not in {finding.code for finding in validate(model, [flight], (1.0,)).findings}


def test_a_flight_with_another_gain_is_told_with_it() -> None:
    model, flight = pair(1000)
    point = model.axes["x"].predictor
    assert point is not None
    wrong = replace(model.axes["x"], predictor=replace(point, input=point.input / 1.2))
    found = validate(replace(model, axes={**model.axes, "x": wrong}), [flight], (1.0,))
    tests, own = found.residuals[0]["x"], found.residuals[0]["x"].own_step
    (told,) = [each for each in found.findings if (each.code, each.axis) == ("residuals_follow_command", "x")]

    assert tests.own_p is not None
    assert tests.own_p > 0.05
    assert own["input"] == pytest.approx(0.2, abs=0.03)
    assert re.search(r"other coefficients than the model's \(input 1\.[12]\d times, damping ", told.effect)
    assert "differs on this flight, or its answer depends on the size or speed of the commands" in told.effect


def test_another_vehicle_is_told_on_every_axis_however_large_the_errors_are() -> None:
    """Innovations that consist of the model's errors must not pass for noise among which nothing is significant."""
    truth, model = Truth(), pair(1000)[0]
    other = replace(truth, gamma=tuple(0.6 * value for value in truth.gamma), delay=tuple(d + 0.1 for d in truth.delay))
    found = validate(model, [flown(other, steps(seed=2), 40.0, 2)], (1.0,))

    assert {f.axis for f in found.findings if f.code == "residuals_follow_command"} == set(AXES)
    assert all(tests.command_p is not None and tests.command_p < 1e-12 for tests in found.residuals[0].values())


def test_coefficients_beyond_the_reach_of_one_linear_step_are_not_given() -> None:
    rng = np.random.default_rng(4)
    past = past_commands(rng)
    e = rng.standard_normal(N) + 2.0 * (past[:, 5] - past[:, 6])
    found = outcome(Innovations(TIME, e, past, np.stack([past[:, 5] - past[:, 6], TIME, np.ones(N)], axis=1)))
    far = replace(found, own_step={"input": 10.9, "damping": 10.9, "delay": -0.03})
    (told,) = [each for each in findings_of_residuals("x", far, "f") if each.code == "residuals_follow_command"]

    assert "(far from these)" in told.effect


def test_an_answer_that_no_coefficients_give_is_left_out_by_the_model() -> None:
    rng = np.random.default_rng(4)
    past = past_commands(rng)
    sensitivity = np.stack([past[:, 12], TIME, np.ones(N)], axis=1)
    e = rng.standard_normal(N) + 1.5 * (past[:, 5] - past[:, 6]) + 0.5 * past[:, 12]

    found = residual_tests(Innovations(TIME, e, past, sensitivity), e, NONE, 0.0)
    assert found is not None
    assert found.own_p is not None
    assert found.own_p < 1e-4
    (told,) = [each for each in findings_of_residuals("x", found, "f") if each.code == "residuals_follow_command"]
    assert told.effect.startswith("the model leaves out part of the response of x")


def test_what_the_stamps_of_a_flight_leave_unknown_is_not_held_against_the_model() -> None:
    model, flight = pair(1000)
    point = model.axes["x"].predictor
    assert point is not None
    early = replace(model.axes["x"], predictor=replace(point, delay=point.delay - 0.03))
    wrong = replace(model, axes={**model.axes, "x": early})
    stamped, told = (residual_tests_of_flight(wrong, replace(flight, pose_lateness=late))["x"] for late in (0.0, 0.033))

    assert (stamped.follows_command, told.follows_command) == (True, False)


def test_a_flight_whose_command_is_held_says_nothing_of_the_delay() -> None:
    model, _ = pair(1000)

    def held(t: Array) -> Array:
        return np.where(t[:, None] < 0.3, 0.0, 0.2) * np.array([0.0, 0.0, 1.0, 0.0])

    found = residual_tests_of_flight(model, flown(Truth(), held, 10.0, 5))
    assert set(found["z"].optimism) == {"input", "damping"}


def test_axes_that_the_flight_does_not_command_are_not_tested() -> None:
    model, _ = pair(1000)

    assert set(residual_tests_of_flight(model, flown(Truth(), steps(("z",), seed=2), 20.0, 2))) == {"z"}


@pytest.mark.slow
@pytest.mark.parametrize("feedback", [False, True])
def test_on_other_clean_flights_each_test_fires_at_its_rate_and_few_findings_come_by_chance(feedback: bool) -> None:
    """240 axes: measured white 4.6 %, command 4.6 %, variance 5.8 %; with feedback 4.2, 3.8, 5.8 %.

    A frequency response that denies the law is told below p = 0.01: of 240 axes by chance on more than six in 1 of 100.
    """
    fired, found, n = np.zeros(3), 0, 0
    for seed in range(1000, 1060):
        model, flight = pair(seed, feedback)
        validation = validate(model, [flight], (1.0,))
        for tests in validation.residuals[0].values():
            low, high = tests.variance_ci95
            fired += [not tests.white, bool(tests.follows_command), not low <= 1 <= high]
            n += 1
        found += len(validation.findings)

    assert n == 60 * len(AXES)
    assert np.all((fired > 0.015 * n) & (fired < 0.095 * n)), fired
    assert found <= 6


def test_the_classic_test_is_silent_on_white_noise_of_which_poses_are_lost() -> None:
    rejected = 0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        time = TIME[rng.uniform(size=N) > 0.1]
        rejected += outcome(of(rng.standard_normal(time.size), time=time)).ljung_box_p < 0.05

    assert rejected <= 6
