"""The step of the motion: the response to an impulse against matrix exponentials, however long the step is."""

import numpy as np
import pytest
from scipy.linalg import expm, expm_frechet

from rotorfit.core.compiled import kernel
from rotorfit.core.frames import Array
from rotorfit.core.laws import STRUCTURES, law_of
from rotorfit.dynamics.general_step import impulse, lag_series

INTEGRATED = np.array([[0.0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1], [0, 0, 0, 0]])
"""H, J, G and the derivative of G: each is the derivative of the one before."""


POWERS = np.array([1.0, 2, 3, 2, 3, 4, 5])
"""Of time in G, J, H, dG/dA, dJ/dA, dJ/dB and dH/dB."""


@kernel()
def fill(series: Array, A: float, B: float, dt: float, out: Array) -> None:
    """Compiled functions that others inline cannot be called from here."""
    out[0], out[1], out[2], out[3], out[4], out[5], out[6] = impulse(series, 0, A, B, dt)


def by_exponential(A: float, B: float, dt: float) -> Array:
    """G, J, H, dG/dA, dJ/dA, dJ/dB, dH/dB."""
    motion = INTEGRATED - np.outer([0, 0, 0, 1], [0, 0, B * dt**2, A * dt])  # in units of the step
    by_A, by_B = (-np.outer([0, 0, 0, 1], np.eye(4)[at]) for at in (3, 2))
    H, J, G = expm(motion)[:3, 3]
    _, JA, GA = expm_frechet(motion, by_A)[1][:3, 3]
    HB, JB, _ = expm_frechet(motion, by_B)[1][:3, 3]
    return np.array([G, J, H, GA, JA, JB, HB]) * dt**POWERS


@pytest.mark.parametrize("damping", [-5.0, -0.3, 0.01, 1.2, 100.0])
@pytest.mark.parametrize("lag", [0.005, 0.05, 0.3, 2.0])
@pytest.mark.parametrize("name", ["first_order_delay_lag", "second_order"])
def test_the_response_to_an_impulse_is_exact_for_steps_of_any_length(name: str, lag: float, damping: float) -> None:
    structure, rate = STRUCTURES[name], 1 / lag
    series = lag_series(law_of(structure, 1.0, damping, 0.0, {"lag": lag})[None])
    A, B = rate + damping * (structure.order == 1), rate * damping

    found: Array = np.zeros(7)
    for dt in (1e-5, 1e-3, 0.03, 0.3, 3.0):
        fill(series, A, B, dt, found)
        expected = by_exponential(A, B, dt)
        allowed = 5e-9 * np.abs(expected) + 1e-13 * dt**POWERS
        assert np.all(np.abs(found - expected) < allowed), dt
