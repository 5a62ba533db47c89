"""Commands alone: what is a limit, what is slow, what is alike."""

import numpy as np
import pytest

from flights import by_hand
from rotorfit.diagnosis.command_checks import _zeros_between, saturated_share, share_above, spectrum


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


@pytest.mark.parametrize(
    ("name", "told"), [("filled", True), ("changes", False), ("taps", False), ("held", False), ("pauses", True)]
)
def test_zeros_between_commands_are_filled_blanks_and_neither_taps_nor_a_log_of_changes(name: str, told: bool) -> None:
    rng, time = np.random.default_rng(1), np.arange(0.0, 60.0, 0.02)
    wave = np.sin(time)
    filled = np.where(np.isin(np.arange(time.size), np.round(np.arange(1, 1200) * 2.5).astype(int)), wave, 0.0)
    pauses = np.where((time % 10 < 3), 0.0, filled)
    slow = np.arange(0.0, 60.0, 0.1)
    taps = np.zeros(slow.size)
    taps[(at := np.cumsum(rng.integers(2, 5, 300)))[at < slow.size]] = 0.3
    pressed = np.cumsum(rng.uniform(0.1, 0.3, 400))
    logs = {
        "filled": (time, filled), "pauses": (time, pauses), "taps": (slow, taps), "held": (time, wave),
        "changes": (pressed, np.where(np.arange(400) % 2, 0.3, 0.0)),
    }  # fmt: skip
    stamps, command = logs[name]
    flight = by_hand(np.arange(0.0, 60.0), np.zeros((60, 4)), stamps, command[:, None] * [1.0, 0.5, 0.0, 0.0])

    assert [one.severity for one in _zeros_between(flight)] == ["error"] * told


def test_the_power_of_a_sine_lies_at_its_frequency() -> None:
    t = np.arange(0.0, 50.0, 0.02)
    frequency, power = spectrum(t, np.sin(2 * np.pi * 0.4 * t))

    assert frequency[np.argmax(power)] == pytest.approx(0.4, abs=0.01)
    assert share_above(t, np.sin(2 * np.pi * 0.4 * t), 0.38) > 0.99
    assert share_above(t, np.sin(2 * np.pi * 0.4 * t), 0.42) < 0.01
    assert share_above(t, np.full(t.size, 0.3), 0.1) == 0.0
