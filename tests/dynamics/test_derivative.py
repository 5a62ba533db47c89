"""Local polynomial differentiation on the stamps as they are."""

import numpy as np
import pytest
from numpy.polynomial import Polynomial

from rotorfit.dynamics.kinematics import local_polynomial


def jittered(n: int, rate: float, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.arange(n) / rate + rng.uniform(-0.4, 0.4, n) / rate


@pytest.mark.parametrize("degree", [2, 3, 4, 5])
def test_exact_for_polynomials_up_to_the_degree_on_irregular_stamps(degree: int) -> None:
    rng = np.random.default_rng(degree)
    time = np.sort(rng.uniform(0.0, 3.0, 250))
    truth = [Polynomial(rng.normal(size=degree + 1)) for _ in range(3)]
    value = np.column_stack([p(time) for p in truth])
    at = np.linspace(time[0], time[-1], 57)

    fit = local_polynomial(time, value, at, 0.3, degree)

    np.testing.assert_allclose(fit.value, np.column_stack([p(at) for p in truth]), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(fit.velocity, np.column_stack([p.deriv(1)(at) for p in truth]), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(fit.acceleration, np.column_stack([p.deriv(2)(at) for p in truth]), rtol=1e-9, atol=1e-9)


def test_the_scoring_reference_is_the_local_cubic_of_the_prediction_protocol() -> None:
    """Centred unweighted cubic over +-0.125 s, widened until it holds 7 poses, nothing across a gap of 1 s."""
    rng = np.random.default_rng(3)
    time = jittered(400, 120.0)
    # Sparse stretches, as left by dropped stale poses, and one hole that no score may cross.
    time = time[(time < 1.0) | (rng.random(400) < 0.15)]
    time = np.where(time > 2.0, time + 1.2, time)
    value = np.column_stack([np.sin(2 * time), np.cos(3 * time)])

    fit = local_polynomial(time, value, time, 0.125, 3, least=7, max_gap=1.0)

    widened = 0
    for i, t in enumerate(time):
        run = (time < 2.5) == (t < 2.5)
        distance = np.abs(time - t)
        width = max(0.125, np.sort(distance[run])[6])
        window = run & (distance <= width)
        widened += width > 0.125
        cubic = np.polynomial.polynomial.polyfit((time[window] - t) / width, value[window], 3)
        assert fit.count[i] == window.sum()
        assert fit.half_width[i] == pytest.approx(width, abs=1e-12)
        np.testing.assert_allclose(fit.velocity[i], cubic[1] / width, rtol=1e-8, atol=1e-9)
        np.testing.assert_allclose(fit.acceleration[i], 2 * cubic[2] / width**2, rtol=1e-8, atol=1e-7)
    assert 10 < widened < len(time) - 10


def test_no_result_inside_a_hole_outside_the_data_and_in_a_run_that_is_too_short() -> None:
    time = np.concatenate([np.arange(0, 1, 0.01), np.arange(2.5, 3.5, 0.01), [5.0, 5.01, 5.02]])
    value = np.sin(time)[:, None]

    fit = local_polynomial(time, value, np.array([-0.1, 0.5, 1.7, 3.0, 3.6, 5.01, 9.0]), 0.1, 3, max_gap=1.0)

    known = np.array([False, True, False, True, False, False, False])
    np.testing.assert_array_equal(np.isfinite(fit.acceleration[:, 0]), known)
    np.testing.assert_array_equal(np.isfinite(fit.half_width), known)
    np.testing.assert_array_equal(fit.count > 0, known)
    np.testing.assert_array_equal(fit.centred, known)


def test_a_window_reaches_over_a_hole_that_is_short_enough() -> None:
    time = np.concatenate([np.arange(0, 1, 0.01), np.arange(1.5, 2.5, 0.01)])
    value = time[:, None] ** 3

    assert np.isnan(local_polynomial(time, value, np.array([1.2]), 0.4, 3, max_gap=0.4).velocity).all()
    reached = local_polynomial(time, value, np.array([1.2]), 0.4, 3, max_gap=0.6)
    assert reached.velocity[0, 0] == pytest.approx(3 * 1.2**2)


def test_what_lies_beyond_a_long_hole_does_not_matter() -> None:
    time = np.concatenate([np.arange(0, 1, 0.05), np.arange(2.5, 3.5, 0.05)])
    value = np.sin(time)[:, None]
    other = np.where(time[:, None] > 2, 99.0, value)
    at = time[:20]

    one = local_polynomial(time, value, at, 0.1, 3, least=9)
    two = local_polynomial(time, other, at, 0.1, 3, least=9)

    np.testing.assert_array_equal(one.acceleration, two.acceleration)
    assert np.isfinite(one.acceleration).all()


def test_one_sided_windows_are_marked_and_noisy() -> None:
    rng = np.random.default_rng(0)
    time = np.arange(240) / 120
    noise = rng.normal(size=(240, 300)) * 5e-4

    fit = local_polynomial(time, noise, time, 0.2, 3)

    np.testing.assert_array_equal(fit.centred, (time > 0.2 - 1e-6) & (time < time[-1] - 0.2 + 1e-6))
    assert np.std(fit.acceleration[0]) > 20 * np.std(fit.acceleration[120])


def test_quoted_noise_of_a_quintic_over_a_quarter_second() -> None:
    """0.5 mm at 120 Hz becomes 1.9 mm/s and 24 mm/s^2; 99.2 % of an acceleration at 1 Hz passes."""
    rng = np.random.default_rng(1)
    time = np.arange(1200) / 120
    noise = rng.normal(size=(1200, 20)) * 5e-4
    wave = np.sin(2 * np.pi * time)[:, None]

    fit = local_polynomial(time, noise, time, 0.25, 5)
    passed = local_polynomial(time, wave, time, 0.25, 5)

    assert np.std(fit.velocity[fit.centred]) == pytest.approx(1.9e-3, rel=0.05)
    assert np.std(fit.acceleration[fit.centred]) == pytest.approx(24e-3, rel=0.05)
    gain = passed.acceleration[passed.centred] / (-((2 * np.pi) ** 2) * wave[passed.centred])
    assert np.median(gain) == pytest.approx(0.992, abs=1e-3)


@pytest.mark.parametrize("shift", [0.0, 0.1, 1234.5678])
def test_samples_on_the_edge_belong_to_the_window_whatever_the_clock(shift: float) -> None:
    time = np.arange(1200) / 120 + shift
    middle = slice(100, -100)

    fit = local_polynomial(time, np.zeros((1200, 1)), time, 0.125, 3)

    np.testing.assert_array_equal(fit.count[middle], 31)


def test_far_from_the_origin_and_late_in_the_day_is_as_accurate() -> None:
    time = jittered(600, 120.0)
    value = np.column_stack([np.sin(time), np.cos(time)])

    near = local_polynomial(time, value, time, 0.25, 5)
    far = local_polynomial(time + 1800, value + 500, time + 1800, 0.25, 5)

    inner = near.centred
    np.testing.assert_allclose(far.velocity[inner], near.velocity[inner], atol=1e-9)
    np.testing.assert_allclose(far.acceleration[inner], near.acceleration[inner], atol=1e-7)


def test_stamps_may_come_in_any_order_and_input_is_left_as_it_was() -> None:
    time, at = jittered(300, 100.0), np.array([2.0, 0.5, 1.0, 0.5])
    value = np.column_stack([np.sin(time), time])
    for array in (time, value, at):
        array.setflags(write=False)

    fit = local_polynomial(time, value, at, 0.2, 3)
    ordered = local_polynomial(time, value, np.sort(at), 0.2, 3)

    np.testing.assert_array_equal(fit.velocity, ordered.velocity[[3, 0, 2, 1]])


def test_nan_spreads_to_its_windows_only() -> None:
    time = np.arange(200) / 100
    value = np.sin(time)[:, None].copy()
    value[100] = np.nan

    fit = local_polynomial(time, value, time, 0.1, 3)

    np.testing.assert_array_equal(np.isnan(fit.velocity[:, 0]), np.abs(np.arange(200) - 100) <= 10)


def test_nothing_in_nothing_out() -> None:
    fit = local_polynomial(np.zeros(0), np.zeros((0, 4)), np.array([1.0]), 0.2, 3)
    assert np.isnan(fit.velocity).all()
    assert fit.velocity.shape == (1, 4)
    assert local_polynomial(np.arange(9.0), np.zeros((9, 2)), np.zeros(0), 0.2, 3).value.shape == (0, 2)


TIME = np.arange(20) / 10


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"value": np.zeros(20)}, "shapes"),
        ({"value": np.zeros((19, 1))}, "shapes"),
        ({"degree": 1}, "degree 1"),
        ({"least": 3}, "least 3"),
        ({"half_width": 0.0}, "half_width 0.0"),
        ({"half_width": np.nan}, "half_width nan"),
        ({"max_gap": 0.0}, "max_gap 0.0"),
        ({"time": TIME[::-1].copy()}, "increase strictly"),
        ({"at": np.array([np.nan])}, "finite"),
    ],
)
def test_what_cannot_be_meant_is_refused(change: dict[str, object], words: str) -> None:
    arguments = {"time": TIME, "value": np.zeros((20, 1)), "at": TIME, "half_width": 0.5, "degree": 3} | change
    with pytest.raises(ValueError, match=words):
        local_polynomial(**arguments)  # type: ignore[arg-type]
