"""Several filters side by side: each is what it is alone, whatever stands beside it. Theory is in test_disturbance."""

import numpy as np
import pytest

from rotorfit.core.laws import START_LEVELS
from rotorfit.dynamics import whitening
from rotorfit.dynamics.disturbance import distinct_steps
from rotorfit.dynamics.whitening import WIDTH
from whole_filters import whiten_axis, whiten_plane

Array = np.ndarray

B = 60


def blocks(seed: int) -> tuple[Array, Array, Array, Array]:
    """Steps, which of them leads to each block, poses of each, and where segments start."""
    rng = np.random.default_rng(seed)
    fresh = np.zeros(B, bool)
    fresh[[0, 23]] = True
    time = np.cumsum(rng.choice([0.02, 0.033, 0.05, 2.0], B, p=[0.4, 0.3, 0.29, 0.01]))
    return *distinct_steps(time), rng.integers(1, 5, B).astype(float), fresh


def levels(M: int, seed: int) -> Array:
    """Of two axes of M filters, shape (M, 2, 4)."""
    return np.asarray(np.exp(START_LEVELS + np.random.default_rng(seed).normal(0, 0.5, (M, 2, 4))))


@pytest.mark.parametrize("M", [1, 2, 4, 5, 9])
@pytest.mark.parametrize(("C", "few"), [(1, 1), (WIDTH - 1, 3), (WIDTH + 1, WIDTH + 1), (2 * WIDTH + 5, 4)])
def test_filters_side_by_side_are_each_alone(M: int, C: int, few: int) -> None:
    rng, common, many = np.random.default_rng(C), blocks(M), levels(M, C)
    columns, yaw = rng.standard_normal((B, 2, C)), np.cumsum(rng.normal(0, 0.1, B))
    line, plane = (
        whiten_axis(*common, columns[:, 0].copy(), many[:, 0], few),
        whiten_plane(*common, yaw, columns, many, few),
    )
    for m in range(M):
        n = C if m == 0 else few
        part = columns[:, :, :n].copy()
        alone = whiten_axis(*common, part[:, 0].copy(), many[m : m + 1, 0], 0)
        turning = whiten_plane(*common, yaw, part, many[m : m + 1], 0)
        for several, one in ((line, alone), (plane, turning)):
            rows = several[0] if m == 0 else several[1][m - 1]
            np.testing.assert_allclose(rows, one[0], rtol=0, atol=1e-9 * np.abs(several[0]).max())
            np.testing.assert_allclose(several[2][m], one[2][0], rtol=1e-11)


def test_a_vehicle_that_does_not_turn_has_two_axes_that_know_nothing_of_each_other() -> None:
    common, many = blocks(3), levels(2, 7)
    columns = np.random.default_rng(4).standard_normal((B, 2, 6))
    plane = whiten_plane(*common, np.zeros(B), columns, many, 2)
    for a in range(2):
        line = whiten_axis(*common, columns[:, a].copy(), many[:, a], 2)
        np.testing.assert_allclose(plane[0][:, a], line[0], rtol=0, atol=1e-9 * np.abs(line[0]).max())
        np.testing.assert_allclose(plane[1][:, :, a], line[1], rtol=0, atol=1e-9 * np.abs(line[0]).max())
        np.testing.assert_allclose(plane[2][:, :, a], line[2], rtol=1e-11)


def test_pieces_are_the_whole_whatever_their_length(monkeypatch: pytest.MonkeyPatch) -> None:
    common, many = blocks(5), levels(6, 2)
    columns, yaw = np.random.default_rng(6).standard_normal((B, 2, WIDTH + 3)), np.linspace(0, 2, B)

    def filtered(piece: int) -> tuple[Array, ...]:
        monkeypatch.setattr(whitening, "PIECE", piece)
        line, plane = whiten_axis(*common, columns[:, 0], many[:, 0], 4), whiten_plane(*common, yaw, columns, many, 4)
        return *line, *plane

    for found, expected in zip(filtered(7), filtered(B), strict=True):
        np.testing.assert_array_equal(found, expected)
