"""Excitation signals, which make a flight informative, as functions of time: sums of sines, sweeps, steps."""

import functools
import itertools
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from rotorfit.core.flight_plan import Chirp, Signal, Sines, Steps, value
from rotorfit.core.frames import AXES, Array, Indices

PAPER_AMPLITUDE = (0.1, 0.1, 0.1, 0.6)
"""Amplitude of each of the two sines on x, y, z and yaw, as a fraction of full scale. Source: paper, eq. (7)."""


def two_sines(t: Array, axes: Sequence[str] = AXES, amplitude: float = 1.0) -> Array:
    """The paper's commands: two sines with frequencies of 1 and 1.3 rad/s, which are not multiples of each other.

    The paper flies x and y together, z alone, and yaw alone. The axes that are not flown are commanded zero: the
    vehicle hovers there. y starts at its full 0.2 (cosines), the others at 0.

    Args:
        t: Time since the start of the excitation, shape (N,) [s].
        axes: Which of `x`, `y`, `z`, `yaw` are excited.
        amplitude: Factor on the paper's amplitudes; 1 is the paper's flight.

    Returns:
        Commands u_x, u_y, u_z, u_psi in the heading frame, shape (N, 4), fractions of full scale.

    Raises:
        ValueError: An unknown axis.

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


DESIGNS = ("two_sines", "multisine", "chirp", "doublets", "3211", "prbs", "ident", "optimal", "optimal_a")
"""Names of the designs; the first six are made here, `ident` is `ident_reference`, the last two are of `optimal`."""

SPARSE = 1.0
"""Distance from one sine of an axis to the next from which on there would be too few in a band [rad/s]."""

LINES = 12
"""Largest number of frequencies in a multisine."""

PRBS_BAND = 2.8
"""Frequency up to which a sequence of clock period 1 s is flat within 3 dB [rad/s]: sinc^2(w / 2) has halved."""

TAPS = {3: (3, 2), 4: (4, 3), 5: (5, 3), 6: (6, 5), 7: (7, 6), 8: (8, 6, 5, 4), 9: (9, 5), 10: (10, 7), 11: (11, 9)}
"""Feedback taps of shift registers of n bits that run through all 2^n - 1 states: exponents of a primitive polynomial.

Source: S. W. Golomb, Shift Register Sequences (1967), table of primitive polynomials.
"""


def designed(
    design: str,
    amplitude: float,
    duration: float,
    band: tuple[float, float],
    place: int = 0,
    of: int = 1,
    seed: int = 0,
) -> Signal:
    """A signal for one axis.

    Args:
        design: `multisine`, `chirp`, `doublets`, `3211` or `prbs`.
        amplitude: Largest value of the signal [its unit].
        duration: Duration [s].
        band: Lowest and highest frequency to excite [rad/s].
        place: Index among the `of` axes flown together, which get different frequencies, signs or sequences.
        of: Number of axes flown together.
        seed: Seed of the sequence of `prbs`.

    Raises:
        ValueError: An unknown design, or an empty band.
    """
    low, high = band
    if not 0 < low < high:
        raise ValueError(f"the band {low:g} to {high:g} rad/s is empty")
    if design == "multisine":
        return multisine(amplitude, duration, band, place, of, all_odd(duration, of))
    if design == "chirp":
        shrunk = (high / low) ** (0.1 * (place // 2))  # up, down, and the same again over a little less of the band
        ends = (low * shrunk, high / shrunk)
        return Chirp(amplitude, ends if place % 2 == 0 else ends[::-1], duration)
    if design in ("doublets", "3211"):
        make = doublets if design == "doublets" else three_two_one_one
        return make(amplitude, duration, band, place)
    if design == "prbs":
        return prbs(amplitude, duration, band, seed, place)
    raise ValueError(f"no such design: {design!r}; designs are {', '.join(DESIGNS)}")


def multisine(
    amplitude: float, duration: float, band: tuple[float, float], place: int = 0, of: int = 1, odd: bool = False
) -> Sines:
    """Sines of equal amplitude, logarithmically spread over the band, with phases that keep the peak low.

    All are multiples of one cycle per `duration`. Axes flown together share no frequency, so that their effects are
    distinguishable. If all multiples are `odd`, what two axes move together, as tilt times thrust, has even ones only,
    and is no part of the answer of any axis. Phases start from Schroeder's rule; then the 2 p norm of the signal is
    minimised for p = 2, 4, 8, 16, 32, whose limit is the peak.

    Source: M. R. Schroeder, IEEE Trans. Inf. Theory 16 (1970), pp. 85-89; P. Guillaume, J. Schoukens, R. Pintelon,
    I. Kollar, IEEE Trans. Instrum. Meas. 40 (1991), pp. 982-989; odd multiples: R. Pintelon, J. Schoukens, System
    Identification: A Frequency Domain Approach (2012), chapter 3.
    """
    first = 2 * np.pi / duration
    every, rest = (2 * of, 2 * place + 1) if odd else (of, place)
    wanted = np.geomspace(band[0], band[1], LINES) / first
    harmonic = np.unique(np.maximum(np.rint((wanted - rest) / every), 0) * every + rest)
    harmonic = harmonic[harmonic > 0]
    phase = _flattened(harmonic, _schroeder(harmonic.size))
    sines = Sines((1.0,) * harmonic.size, tuple(map(float, first * harmonic)), tuple(map(float, phase)))
    size = amplitude / float(np.max(np.abs(value(sines, _fine(sines, duration)))))
    return Sines((size,) * harmonic.size, sines.frequency, sines.phase)


def all_odd(duration: float, of: int) -> bool:
    """Whether axes flown together for a duration [s] fly odd multiples: more than two, where enough fit the band."""
    return of > 2 and 2 * of * 2 * np.pi / duration < SPARSE


def _schroeder(count: int) -> Array:
    """Schroeder phases of equal sines, whose sum is nearly flat."""
    k = np.arange(1, count + 1)
    return np.asarray(-np.pi * k * (k - 1) / count)


def _flattened(harmonic: Array, phase: Array) -> Array:
    """Phases after minimising the 2 p norm over one period of 2 pi."""
    from scipy.optimize import minimize

    t = 2 * np.pi * np.arange(int(16 * harmonic[-1])) / int(16 * harmonic[-1])
    turn = np.multiply.outer(t, harmonic)
    for p in (2, 4, 8, 16, 32):

        def norm(phase: Array, p: int = p) -> tuple[float, Array]:
            """The 2p-norm of the signal, and its gradient."""
            angle = turn + phase
            signal = np.sin(angle).sum(axis=1)
            top = np.max(np.abs(signal))
            share = signal / top
            power = np.mean(share ** (2 * p))
            slope = (share ** (2 * p - 1)) @ np.cos(angle) / t.size / power
            return float(top * power ** (1 / (2 * p))), top * power ** (1 / (2 * p)) * slope / top

        phase = minimize(norm, phase, jac=True, method="L-BFGS-B").x
    return np.asarray(phase)


def crest_factor(signal: Signal, duration: float) -> float:
    """Peak over root mean square: 1 for a two-level sequence, 1.41 for a sine; low values are informative."""
    sample = value(signal, _fine(signal, duration))
    return float(np.max(np.abs(sample)) / np.sqrt(np.mean(sample**2)))


def _fine(signal: Signal, duration: float) -> Array:
    """Times dense enough to resolve every peak [s]."""
    fastest = max(signal.frequency) if isinstance(signal, Sines | Chirp) else 2 * np.pi * 10
    return np.linspace(0.0, duration, max(int(duration * fastest / (2 * np.pi) * 64), 512), endpoint=False)


def doublets(amplitude: float, duration: float, band: tuple[float, float], place: int = 0) -> Steps:
    """Pairs of opposite pulses, each followed by its mirror image, so that the vehicle returns; wide ones first.

    The half width of a pair cycles through half the periods of five frequencies of the band. Axes flown together change
    their signs from one pattern to the next, each in its own order (`_sign`).
    """
    widths = np.pi / np.geomspace(band[0], band[1], 5)
    pattern = (1, -1, 0, -1, 1, 0)
    blocks = ((width, _sign(place, number)) for number, width in enumerate(itertools.cycle(widths)))
    return _steps(((width, sign * level) for width, sign in blocks for level in pattern), amplitude, duration)


def _sign(place: int, number: int) -> int:
    """Sign of a pattern on one of up to four axes: Walsh functions, orthogonal over any four consecutive patterns."""
    return -1 if (place & number).bit_count() % 2 else 1


def three_two_one_one(amplitude: float, duration: float, band: tuple[float, float], place: int = 0) -> Steps:
    """Steps of 3, 2, 1 and 1 units with alternating sign, a rest of 2, the mirror image, a rest; repeated.

    Signs of axes flown together as for `doublets`.

    The unit is a third of the period of the frequency in the middle of the band: the steps of 3, 2 and 1 are then half
    periods of 0.5, 0.75 and 1.5 times that frequency.

    Source: the sequence is that of R. V. Jategaonkar, Flight Vehicle System Identification (2006), chapter 2.
    """
    unit = 2 * np.pi / (3 * np.sqrt(band[0] * band[1]))
    pattern = ((3, 1), (2, -1), (1, 1), (1, -1), (2, 0), (3, -1), (2, 1), (1, -1), (1, 1), (2, 0))
    signs = (_sign(place, number) for number in itertools.count())
    return _steps(((units * unit, sign * level) for sign in signs for units, level in pattern), amplitude, duration)


def _steps(held: Iterable[tuple[float, int]], amplitude: float, duration: float) -> Steps:
    """Levels held one after the other, up to the last that ends within the duration, then 0."""
    time, level, now = [], [], 0.0
    for long, sign in held:
        if now + long > duration:
            break
        time.append(float(now))
        level.append(float(sign * amplitude))
        now += long
    return Steps((*time, float(now)), (*level, 0.0))


def prbs(amplitude: float, duration: float, band: tuple[float, float], seed: int = 0, place: int = 0) -> Steps:
    """A maximum-length binary sequence: two levels that alternate pseudo-randomly, with a known flat spectrum.

    The clock follows from the highest frequency; the register is the shortest that covers the duration, up to 11 bits;
    the seed draws its initial state. Axes that are flown together take it a quarter of the period apart, where a
    maximum-length sequence has no correlation with itself.
    """
    clock = PRBS_BAND / band[1]
    ticks = int(duration / clock)
    bits = next((n for n in TAPS if 2**n - 1 >= ticks), max(TAPS))
    sequence = np.roll(maximum_length_sequence(bits, seed), -place * (2**bits - 1) // len(AXES))
    level = amplitude * (2.0 * np.resize(sequence, ticks) - 1)
    change = np.flatnonzero(np.diff(level, prepend=0.0))
    return Steps((*map(float, clock * change), float(duration)), (*map(float, level[change]), 0.0))


def maximum_length_sequence(bits: int, seed: int) -> Indices:
    """One period of a maximum-length sequence of 0 and 1, shape (2^bits - 1,); the seed draws the initial state."""
    state = int(np.random.default_rng(seed).integers(1, 2**bits))
    out = np.empty(2**bits - 1, np.int64)
    for n in range(out.size):
        out[n] = state & 1
        fed = functools.reduce(lambda a, tap: a ^ (state >> (bits - tap)), TAPS[bits], 0) & 1
        state = (state >> 1) | (fed << (bits - 1))
    return out


IDENT_SPEED = 0.4
"""Frequency of the slower sine of the ident manoeuvre [rad/s]: mean velocity 0.2 m/s over amplitude 0.5 m."""

IDENT_AMPLITUDE = (0.5, 0.5, 0.5, 1.05)
"""Amplitude of the ident manoeuvre on x, y, z [m] and yaw [rad], as configured and in its source code."""


def ident_reference(axis: str) -> Sines:
    """The position reference of drone_dev's `ident`: half the amplitude times the sum of two sines, cosines on yaw.

    x and y move together by 0.5 A (sin w t + sin t), then z alone by the same, then yaw by 0.5 B (cos w t + cos t), and
    w is the mean velocity over A. A is 0.5 m and the mean velocity 0.2 m/s as configured there, B is 1.05 rad.

    Args:
        axis: `x`, `y`, `z` or `yaw`.

    Source: jrsbenevides/drone_dev, src/planner/genTrajectory.cpp (trajectory `ident`), config/bebopParameters.yaml.
    """
    half = 0.5 * IDENT_AMPLITUDE[AXES.index(axis)]
    return Sines((half, half), (IDENT_SPEED, 1.0), (np.pi / 2,) * 2 if axis == "yaw" else (0.0, 0.0))


def scaled(signal: Signal, factor: float) -> Signal:
    """The signal multiplied by a factor."""
    if isinstance(signal, Sines):
        return replace(signal, amplitude=tuple(factor * each for each in signal.amplitude))
    if isinstance(signal, Chirp):
        return replace(signal, amplitude=factor * signal.amplitude)
    return replace(signal, level=tuple(factor * each for each in signal.level))
