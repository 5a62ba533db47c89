"""Commands alone: what is a limit, what is slow, what is alike."""

import numpy as np
import pytest

from rotorfit.diagnosis.command_checks import saturated_share, share_above, spectrum


def test_commands_that_are_clipped_stand_at_their_limit() -> None:
    clipped = np.clip(np.random.default_rng(0).standard_normal(2000), -1.0, 1.0)

    assert saturated_share(clipped) == pytest.approx(np.mean(np.abs(clipped) == 1.0))
    assert saturated_share(clipped) == pytest.approx(0.317, abs=0.03)


def test_steps_have_no_limit_whether_of_two_sizes_or_of_many() -> None:
    rng = np.random.default_rng(0)

    assert saturated_share(0.2 * np.sign(rng.standard_normal(2000))) == 0.0
    assert saturated_share(np.repeat(np.arange(1.0, 11.0), 50)) == 0.0


def test_commands_that_touch_their_largest_value_once_are_not_saturated() -> None:
    assert saturated_share(np.random.default_rng(0).standard_normal(2000)) == 0.0


def test_the_power_of_a_sine_lies_at_its_frequency() -> None:
    t = np.arange(0.0, 50.0, 0.02)
    frequency, power = spectrum(t, np.sin(2 * np.pi * 0.4 * t))

    assert frequency[np.argmax(power)] == pytest.approx(0.4, abs=0.01)
    assert share_above(t, np.sin(2 * np.pi * 0.4 * t), 0.38) > 0.99
    assert share_above(t, np.sin(2 * np.pi * 0.4 * t), 0.42) < 0.01
    assert share_above(t, np.full(t.size, 0.3), 0.1) == 0.0
