"""The paper's commands (7)."""

import math

import numpy as np
import pytest

from rotorfit.planning.signals import two_sines

TIME = np.linspace(0.0, 200.0, 1777)


def test_two_sines_are_the_formulas_of_the_paper() -> None:
    commands = two_sines(TIME)

    expected = [
        (
            0.1 * (math.sin(1.3 * t) + math.sin(t)),
            0.1 * (math.cos(1.3 * t) + math.cos(t)),
            0.1 * (math.sin(1.3 * t) + math.sin(t)),
            0.6 * (math.sin(1.3 * t) + math.sin(t)),
        )
        for t in TIME.tolist()
    ]
    np.testing.assert_allclose(commands, expected, rtol=0, atol=1e-13)


@pytest.mark.parametrize(("axes", "columns"), [(("x", "y"), [0, 1]), (("z",), [2]), (("yaw",), [3]), ((), [])])
def test_only_the_chosen_axes_are_excited_and_the_others_are_commanded_zero(
    axes: tuple[str, ...], columns: list[int]
) -> None:
    commands = two_sines(TIME, axes)

    others = [column for column in range(4) if column not in columns]
    np.testing.assert_array_equal(commands[:, columns], two_sines(TIME)[:, columns])
    np.testing.assert_array_equal(commands[:, others], 0.0)


def test_amplitude_scales_every_axis() -> None:
    np.testing.assert_allclose(two_sines(TIME, amplitude=0.5), 0.5 * two_sines(TIME), rtol=1e-15)


def test_commands_stay_within_full_scale_except_yaw() -> None:
    peak = np.abs(two_sines(TIME)).max(axis=0)

    assert np.all(peak[:3] <= 0.2)
    assert 1.0 < peak[3] <= 1.2  # as the paper prints it: above the driver's full scale of 1


def test_an_unknown_axis_is_named() -> None:
    with pytest.raises(ValueError, match="no such axis: psi"):
        two_sines(TIME, ("x", "psi"))
