"""Motions from many starts side by side equal those computed one by one."""

import numba
import numpy as np

from rotorfit.core.frames import Array
from rotorfit.core.laws import FIRST_ORDER_DELAY, law_of
from rotorfit.dynamics.filter_bank import logarithm
from rotorfit.dynamics.free_runs import STATE, cosine_sine, free_runs
from rotorfit.dynamics.predictor import free_run


def test_runs_side_by_side_equal_single_ones() -> None:
    """More starts than fit side by side, and one of them after a hole in which no run is active."""
    rng = np.random.default_rng(1)
    time = np.append(np.arange(0.0, 12.0, 0.02), np.arange(20.0, 24.0, 0.02))
    command_time = np.arange(-0.5, 24.0, 0.11)
    command = rng.normal(size=(command_time.size, 2))
    law = np.array([law_of(FIRST_ORDER_DELAY, g, b, tau, {}) for g, b, tau in ((5.0, 0.4, 0.07), (4.0, 0.6, 0.15))])
    first = np.append(np.arange(1, 500, 11), 601)
    last, E = first + 60, 60
    state = np.zeros((first.size, STATE))
    state[:, :4] = rng.normal(size=(first.size, 4))
    heading = 0.8 * time + 3.0 * np.sin(time)
    in_force = np.stack(
        [np.searchsorted(command_time + d, time[first - 1], side="right") - 1 for d in law[:, 2]], axis=1
    )
    nothing = np.empty((first.size, 0, 6)), np.empty((1, 24, 0)), np.zeros(time.size, np.int64)

    found = free_runs(
        command_time, command, law, time, first, last, in_force, state, heading[first - 1],
        heading[first[:, None] + np.arange(E)], *nothing,
    )  # fmt: skip

    for s, (begin, end) in enumerate(zip(first - 1, last, strict=True)):
        alone = free_run(
            command_time, command, law, state[s, :2], state[s, 2:4], time[begin:end], heading[begin:end]
        )  # fmt: skip
        np.testing.assert_allclose(found[s], alone[1:], atol=1e-11)


@numba.njit
def _tabulated(x: Array, angle: Array, out: Array) -> None:
    for i in range(x.size):
        out[0, i] = logarithm(x[i])
        out[1, i], out[2, i] = cosine_sine(angle[i])


def test_functions_for_vectors_are_exact() -> None:
    x, angle = np.geomspace(1e-300, 1e300, 5001), np.linspace(-300.0, 300.0, 5001)
    out = np.empty((3, x.size))
    _tabulated(x, angle, out)
    np.testing.assert_allclose(out[0], np.log(x), rtol=1e-15, atol=1e-15)
    np.testing.assert_allclose(out[1:], [np.cos(angle), np.sin(angle)], atol=1e-15)
