"""Commands that make a flight tell its coefficients: the paper's two sines."""

from collections.abc import Sequence

import numpy as np

from rotorfit.frames import AXES, Array

PAPER_AMPLITUDE = (0.1, 0.1, 0.1, 0.6)
"""Amplitude of each of the two sines on x, y, z and yaw, as a fraction of full scale. Source: paper, eq. (7)."""


def two_sines(t: Array, axes: Sequence[str] = AXES, amplitude: float = 1.0) -> Array:
    """The paper's commands: two sines whose frequencies, 1 and 1.3 rad/s, are no multiples of each other.

    The paper flies x and y together, z alone, and yaw alone. The axes that are not flown are commanded zero: the
    vehicle hovers there. y starts at its full 0.2 (cosines), the others at 0.

    Args:
        t: Time since the start of the excitation, shape (N,) [s].
        axes: Which of `x`, `y`, `z`, `yaw` are excited.
        amplitude: Factor on the paper's amplitudes; 1 is the paper's flight.

    Returns:
        Commands u_x, u_y, u_z, u_psi in the heading frame, shape (N, 4), fractions of full scale.

    Raises:
        ValueError: An axis that does not exist.

    Source: paper, eq. (7).
    """
    unknown = sorted(set(axes) - set(AXES))
    if unknown:
        raise ValueError(f"no such axis: {', '.join(unknown)}; the axes are {', '.join(AXES)}")
    sines = np.sin(1.3 * t) + np.sin(t)
    cosines = np.cos(1.3 * t) + np.cos(t)
    commands: Array = amplitude * np.array(PAPER_AMPLITUDE) * np.stack([sines, cosines, sines, sines], axis=1)
    commands[:, [axis not in axes for axis in AXES]] = 0.0
    return commands
