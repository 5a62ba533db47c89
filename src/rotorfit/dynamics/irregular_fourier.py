"""Fourier sums over irregular points, in a time that grows with their number, not with its square.

Each point is spread over the nearest points of a regular grid by a kernel of finite width, the grid is transformed by
the FFT, and the result is divided by the kernel's own transform; the reverse for sums at irregular points. With this
width the error is some 1e-14 of the largest sum that such coefficients could have.

Source: A. H. Barnett, J. Magland, L. af Klinteberg, SIAM J. Sci. Comput. 41 (2019), pp. C479-C504.
"""

from functools import lru_cache

import numpy as np

from rotorfit.core.frames import Array
from rotorfit.core.frequency_response import Spectrum

WIDTH = 16
"""Number of grid points over which one point is spread."""

SHAPE = 2.3 * WIDTH
"""Shape of the kernel exp(shape (sqrt(1 - z^2) - 1)), for a grid with twice as many points as there are sums."""

NODES = 64
"""Number of nodes of the quadrature for its transform."""


class IrregularFourier:
    """Products of the matrix exp(-i m x_j), m = 0 ... count - 1, of some points x_j, with vectors.

    Args:
        points: x, shape (J,) [rad].
        count: M.
    """

    def __init__(self, points: Array, count: int) -> None:
        from scipy.fft import next_fast_len

        self._size = int(next_fast_len(2 * count + WIDTH))
        place = points * (self._size / (2 * np.pi))
        first = np.ceil(place - WIDTH / 2)
        self._at, self._weight = np.empty((WIDTH, points.size), np.int32), np.empty((WIDTH, points.size))
        for w in range(WIDTH):  # one after the other: all points at once take much memory
            self._at[w] = np.mod(first + w, self._size)
            self._weight[w] = _kernel((first + w - place) / (WIDTH / 2))
        self._bin = np.mod(np.arange(count) - count // 2, self._size)
        self._transform = _transform(count, self._size)
        self._turn = np.exp(-1j * (count // 2) * points)  # the middle sum is number zero of the grid

    def over_points(self, coefficient: Array | Spectrum) -> Spectrum:
        """Sum over j of c_j exp(-i m x_j), shape (M,), of coefficients of shape (J,)."""
        turned, grid = coefficient * self._turn, np.zeros(self._size, np.complex128)
        for at, weight in zip(self._at, self._weight, strict=True):
            grid.real += np.bincount(at, weight * turned.real, self._size)
            grid.imag += np.bincount(at, weight * turned.imag, self._size)
        return np.asarray(np.fft.fft(grid)[self._bin] / self._transform)

    def at_points(self, coefficient: Array | Spectrum) -> Spectrum:
        """Sum over m of c_m exp(-i m x_j), shape (J,), of coefficients of shape (M,)."""
        grid, total = np.zeros(self._size, np.complex128), np.zeros(self._turn.size, np.complex128)
        grid[self._bin] = coefficient / self._transform
        spectrum = np.fft.fft(grid)
        for at, weight in zip(self._at, self._weight, strict=True):
            total += weight * spectrum[at]
        return np.asarray(self._turn * total)


@lru_cache(maxsize=4)  # the axes of a flight have the same numbers of samples
def _transform(count: int, size: int) -> Array:
    """Transform of the kernel at the sums, that of number zero in the middle, shape (count,)."""
    nodes, weights = (part[NODES // 2 :] for part in np.polynomial.legendre.leggauss(NODES))  # half: it is even
    rate = np.arange(count // 2 + 1) * (np.pi * WIDTH / size)
    half = np.zeros(rate.size)
    for node, weight in zip(nodes, WIDTH * weights * _kernel(nodes), strict=True):
        half += weight * np.cos(rate * node)
    return half[np.abs(np.arange(count) - count // 2)]


def _kernel(z: Array) -> Array:
    return np.asarray(np.exp(SHAPE * (np.sqrt(np.maximum(1 - z**2, 0.0)) - 1)))
