"""Commands against motion, and poses by themselves: shares, leaps, stretches, against what is known of them."""

import numpy as np
import pytest

from flights import by_hand
from rotorfit.core.frames import Array
from rotorfit.diagnosis.motion_checks import explained_share
from rotorfit.diagnosis.pose_checks import LEAP_FLOORS, PEAKS, leaps


def band(t: Array, seed: int) -> Array:
    """Noise below 1 Hz of unit variance."""
    white = np.random.default_rng(seed).standard_normal(t.size)
    spectrum = np.fft.rfft(white)
    spectrum[np.fft.rfftfreq(t.size, t[1] - t[0]) > 1.0] = 0
    slow = np.fft.irfft(spectrum, t.size)
    return np.asarray(slow / slow.std())


@pytest.mark.parametrize("noise", [0.0, 0.5, 1.0, 2.0])
@pytest.mark.parametrize("delay", [0.0, 0.3])
def test_the_explained_share_is_that_of_the_variance_and_no_delay_changes_it(noise: float, delay: float) -> None:
    t = np.arange(0.0, 400.0, 0.02)
    u = band(t, 1)
    flight = by_hand(t, np.zeros((t.size, 4)), t, np.stack([u, u, u, u], axis=1))

    a = 3.0 * np.interp(t - delay, t, u) + 3.0 * noise * band(t, 2)
    assert explained_share(flight, t, a, 0) == pytest.approx(1 / (1 + noise**2), abs=0.05)


def test_a_flight_of_less_than_three_windows_has_no_share() -> None:
    t = np.arange(0.0, 15.0, 0.02)
    flight = by_hand(t, np.zeros((t.size, 4)), t, np.tile(np.sin(t)[:, None], 4))

    assert explained_share(flight, t, np.sin(t), 0) is None


def test_leaps_are_found_where_they_are_with_their_size_and_motion_is_none() -> None:
    t = np.arange(0.0, 20.0, 0.01)
    path = np.stack([np.sin(2 * t), np.cos(2 * t), 0.5 * np.sin(5 * t)], axis=1)
    noisy = path + 0.0005 * np.random.default_rng(0).standard_normal(path.shape)
    assert len(leaps(t, noisy, LEAP_FLOORS[0], PEAKS[0])[0]) == 0

    noisy[500:520] += [0.1, 0.0, 0.0]
    when, by = leaps(t, noisy, LEAP_FLOORS[0], PEAKS[0])
    np.testing.assert_allclose(when, [5.0, 5.2], atol=1e-9)
    np.testing.assert_allclose(by[:, 0], [0.1, -0.1], atol=0.005)


def test_a_flight_of_a_few_poses_has_no_leaps() -> None:
    assert len(leaps(np.arange(10.0), np.ones((10, 3)), LEAP_FLOORS[0], PEAKS[0])[0]) == 0
