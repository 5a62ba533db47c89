"""Signals that make a flight tell its coefficients, as functions of time: sums of sines, sweeps, steps."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rotorfit.frames import AXES, Array

PAPER_AMPLITUDE = (0.1, 0.1, 0.1, 0.6)
"""Amplitude of each of the two sines on x, y, z and yaw, as a fraction of full scale. Source: paper, eq. (7)."""


@dataclass(frozen=True)
class Sines:
    """sum_k amplitude_k sin(frequency_k t + phase_k).

    Attributes:
        amplitude: Shape (K,), in the unit of the signal.
        frequency: Shape (K,) [rad/s].
        phase: Shape (K,) [rad].
    """

    amplitude: tuple[float, ...]
    frequency: tuple[float, ...]
    phase: tuple[float, ...]


@dataclass(frozen=True)
class Chirp:
    """A sine whose frequency moves from one end to the other at a constant rate of its logarithm.

    Attributes:
        amplitude: In the unit of the signal.
        frequency: Start and end [rad/s].
        duration: Over which the frequency moves [s].
    """

    amplitude: float
    frequency: tuple[float, float]
    duration: float


@dataclass(frozen=True)
class Steps:
    """Levels, each held from its time on until the next one; 0 before the first.

    Attributes:
        time: Increasing, shape (K,) [s].
        level: Shape (K,), in the unit of the signal.
    """

    time: tuple[float, ...]
    level: tuple[float, ...]


Signal = Sines | Chirp | Steps


def value(signal: Signal, t: Array) -> Array:
    """The signal at times t since its own start, shape (N,) [s]."""
    if isinstance(signal, Sines):
        amplitude, frequency, phase = (np.array(each) for each in (signal.amplitude, signal.frequency, signal.phase))
        return np.asarray(np.sin(np.multiply.outer(t, frequency) + phase) @ amplitude)
    if isinstance(signal, Chirp):
        low, high = signal.frequency
        rate = np.log(high / low) / signal.duration
        return np.asarray(signal.amplitude * np.sin(low * np.expm1(rate * t) / rate))
    levels = np.array([0.0, *signal.level])
    return np.asarray(levels[np.searchsorted(np.array(signal.time), t, side="right")])


def motion(signal: Signal, t: Array) -> tuple[Array, Array, Array]:
    """The signal at times t, shape (N,) [s], with its first and second derivative; those of steps are 0."""
    if isinstance(signal, Sines):
        amplitude, frequency, phase = (np.array(each) for each in (signal.amplitude, signal.frequency, signal.phase))
        angle = np.multiply.outer(t, frequency) + phase
        first = np.cos(angle) @ (amplitude * frequency)
        return (
            np.asarray(np.sin(angle) @ amplitude),
            np.asarray(first),
            np.asarray(-np.sin(angle) @ (amplitude * frequency**2)),
        )
    if isinstance(signal, Chirp):
        low, high = signal.frequency
        rate = np.log(high / low) / signal.duration
        angle, speed = low * np.expm1(rate * t) / rate, low * np.exp(rate * t)
        sine, cosine = signal.amplitude * np.sin(angle), signal.amplitude * np.cos(angle)
        return sine, speed * cosine, rate * speed * cosine - speed**2 * sine
    return value(signal, t), np.zeros(t.shape), np.zeros(t.shape)


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
    columns = [value(paper_sines(axis, amplitude), t) if axis in axes else np.zeros(t.shape) for axis in AXES]
    return np.stack(columns, axis=1)


def paper_sines(axis: str, amplitude: float = 1.0) -> Sines:
    """The paper's two sines on one axis; cosines on y. Source: paper, eq. (7)."""
    size = amplitude * PAPER_AMPLITUDE[AXES.index(axis)]
    return Sines((size, size), (1.3, 1.0), (np.pi / 2,) * 2 if axis == "y" else (0.0, 0.0))
