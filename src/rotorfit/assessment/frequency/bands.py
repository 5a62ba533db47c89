"""Spectra -> bands: each with a few unknown values of the response, and with terms for what else moves the vehicle.

In a band, with the command U, the velocity V and s = i w,

    V(w) = G(w) U(w) + K D(w) + T(w) + N(w)

G is linear in w between knots once a delay and a first-order lag are removed, both found roughly from the same data: no
straight line follows 1 / (s + b) where knots are as far apart as b. D is the contribution of the other horizontal axis
when the vehicle turns, K free. T is the effect of the ends of the window: a sum of powers of s and of slow and fast
decays 1 / (s + a) with real coefficients, separate for each window. N is noise of unknown power and of the shape that
the whole flight shows. Where an instrument Z is not the command itself, only the motion that follows it counts. Bands
share no frequency, so they are independent, and N of each has its own degrees of freedom. All equations are between
real numbers: a complex one is two.

Source: R. Pintelon, J. Schoukens, System Identification: A Frequency Domain Approach, 2nd ed., 2012, chapter 7 (local
polynomial method, its variance and degrees of freedom); section 7.2.7 for the loop (instrument: the reference).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from rotorfit.assessment.frequency.spectra import Spectra
from rotorfit.core.frames import Array, Mask
from rotorfit.core.frequency_response import Spectrum

KNOT_EVERY = 4.0
"""Distance of the knots [bins] where the command has no lines."""

KNOT_SHARE = 0.15
"""The same as a share of the frequency, where that is larger."""

BINS = 12
"""Approximate number of bins in a band."""

DECAYS = (0.2, 0.6, 2.0)
"""Decays in T [1/s], besides a constant, s and s^2: any decay of 0.2 1/s or faster is matched to 1 %."""

LEAST_FREEDOM = 6
"""Degrees of freedom of the noise below which a band is left out."""

DELAYS = np.arange(0.0, 0.91, 0.1)
"""Candidates for the delay that is removed from G [s]."""

LAGS = np.append(0.0, 0.1 * 2 ** np.arange(0.0, 7.1, 0.5))
"""Candidates for the time constant of the lag that is removed from G [s]."""

TURNED_LATER = np.arange(0.0, 0.41, 0.05)
"""Candidates for the time by which the vehicle turns a command later than its stamp [s]."""

NOISE_POWERS = (-4.0, -2.0, 0.0, 2.0)
"""Powers of the frequency that add up to the velocity's noise: wind that drifts, wind, gusts, error of the pose."""

POWER = 0.99
"""Share of the instrument's power up to which bands reach."""


@dataclass(frozen=True)
class Band:
    """Equations of one band, N complex ones, with noise of equal power and T and D removed; real parts, then imaginary.

    Attributes:
        knots: Frequencies at which the response is unknown, shape (J,) [rad/s].
        frequency: Frequencies of the equations, shape (N,) [rad/s].
        duration: Duration of the window of each equation, shape (N,) [s].
        scale: Factor by which each equation was multiplied, shape (N,).
        command: Integrated and scaled command, shape (N,).
        motion: Shape (2 N,).
        share: Coefficients of the real parts of the response at the knots, then of the imaginary ones, shape (2 N, 2
            J).
        instrument: Orthonormal columns of what moves the command from outside, shape (2 N, 2 J).
        others: Orthonormal columns of T and D, shape (2 N, Q).
    """

    knots: Array
    frequency: Array
    duration: Array
    scale: Array
    command: Spectrum
    motion: Array
    share: Array
    instrument: Array
    others: Array

    @property
    def freedom(self) -> int:
        """Degrees of freedom of the noise."""
        return int(self.motion.size - self.others.shape[1] - self.share.shape[1])

    def free_of_others(self, rows: Array) -> Array:
        """Rows without the components along T and D, shape (2 N,) or (2 N, ...)."""
        return np.asarray(rows - self.others @ (self.others.T @ rows))

    def moved_by(self, response: Spectrum) -> Array:
        """Motion from a response at the band's frequencies, shape (N,), with T and D removed, shape (2 N,)."""
        return self.free_of_others(_real((response * self.command)[:, None])[:, 0])

    @property
    def parts(self) -> Array:
        """Real parts, then imaginary ones, of the response at the knots, shape (2 J,)."""
        return np.asarray(np.linalg.solve(self.instrument.T @ self.share, self.instrument.T @ self.motion), np.float64)

    @property
    def response(self) -> Spectrum:
        """The response at the knots, shape (J,)."""
        return np.asarray(self.parts[: self.knots.size] + 1j * self.parts[self.knots.size :])

    @property
    def noise(self) -> float:
        """Mean square of the residuals of the response."""
        rest = self.motion - self.share @ self.parts
        return float(rest @ rest) / self.freedom

    @property
    def left_over(self) -> Array:
        """Power of the residual of each equation, corrected for the fitted degrees of freedom, shape (2 N,)."""
        basis = np.linalg.qr(np.hstack([self.others, self.share]))[0]
        free = 1 - np.sum(basis**2, axis=1)
        power = (self.motion - self.share @ self.parts) ** 2
        return np.asarray(np.where(free > 0.05, power / np.maximum(free, 0.05), self.noise))

    @property
    def covariance(self) -> Array:
        """Covariance of the real and imaginary parts of the response, shape (2 J, 2 J)."""
        slope = np.linalg.inv(self.instrument.T @ self.share)
        return np.asarray(self.noise * slope @ slope.T)


def bands_of(spectra: Sequence[Spectra], lines: Array | None = None) -> tuple[Band, ...]:
    """The bands of some windows, from low to high frequencies.

    Args:
        spectra: Spectra of one or more windows.
        lines: Frequencies of the command's lines, shape (K,) [rad/s]; None if its spectrum is continuous.
    """
    knots = _knots(spectra) if lines is None else lines
    groups = _groups(knots, _bin(spectra))
    shapes = [np.full(part.frequency.size, part.duration**0.5) for part in spectra]

    def equations() -> list[_Equations]:
        return [one for group in groups if (one := _equations(spectra, shapes, *group)) is not None]

    before = equations()
    delay, lag = (each.ravel() for each in np.meshgrid(DELAYS, LAGS))
    known = _best(before, _Known(delay, lag))
    if any(part.turning.any() for part in spectra):
        known = _best(before, known._replace(late=TURNED_LATER))
    bands = _bands(before, known)
    for _ in range(2):
        shapes = _shapes(spectra, bands, shapes)
        bands = _bands(equations(), known)
    return bands


def _bin(spectra: Sequence[Spectra]) -> float:
    """The smallest spacing of the frequencies [rad/s]."""
    return min((float(part.frequency[0]) for part in spectra), default=np.inf)


def _knots(spectra: Sequence[Spectra]) -> Array:
    """Knots over the frequencies at which the instrument has power, shape (K,) [rad/s]."""
    step, top = _bin(spectra), 0.0
    for part in spectra:
        power = np.cumsum(np.abs(part.instrument) ** 2)
        if power.size and power[-1] > 0:
            top = max(top, float(part.frequency[np.searchsorted(power, POWER * power[-1])]))
    knots = [2.5 * step]
    while (following := knots[-1] + max(KNOT_EVERY * step, KNOT_SHARE * knots[-1])) <= top:
        knots.append(following)
    return np.array(knots)


def _groups(knots: Array, step: float) -> list[tuple[Array, float, float]]:
    """Knots of each band with its limits; neighbours meet in the middle."""
    if not knots.size:
        return []
    spacing = float(np.median(np.diff(knots))) if knots.size > 1 else BINS * step
    size = int(np.clip(round(BINS * step / spacing), 1, 4))
    parts = np.array_split(knots, max(1, knots.size // size))
    inner = [(a[-1] + b[0]) / 2 for a, b in pairwise(parts)]
    reach = [max(0.5 * spacing, BINS * step / 2 / max(part.size, 1)) for part in (parts[0], parts[-1])]
    ends = [knots[0] - reach[0], *inner, knots[-1] + reach[1]]
    return list(zip(parts, ends[:-1], ends[1:], strict=True))


@dataclass(frozen=True)
class _Equations:
    """Equations of one band before a delay, T and D are removed, scaled to noise of equal power.

    Attributes:
        knots: As in `Band`; so are `frequency`, `duration`, `scale` and `command`.
        motion: Shape (N,).
        instrument: Shape (N,); None for the command itself.
        turned: D, shape (N,).
        turning: Change of the command for each second by which it is turned later, shape (N,).
        ends: Columns of T, shape (2 N, Q).
    """

    knots: Array
    frequency: Array
    duration: Array
    scale: Array
    command: Spectrum
    motion: Spectrum
    instrument: Spectrum | None
    turned: Spectrum
    turning: Spectrum
    ends: Array


def _equations(
    spectra: Sequence[Spectra], shapes: Sequence[Array], knots: Array, low: float, high: float
) -> _Equations | None:
    """Equations between two frequencies, for noise of a given shape; None if there are too few."""
    rows: list[Mask] = [(part.frequency >= low) & (part.frequency < high) for part in spectra]
    kept = [k for k, row in enumerate(rows) if row.sum() > 4]
    if not kept:
        return None
    scaled = [spectra[k].at(rows[k]).scaled(1 / shapes[k][rows[k]]) for k in kept]
    omega, V, U, R, D, late = (
        np.concatenate([getattr(part, name) for part in scaled])
        for name in ("frequency", "motion", "command", "instrument", "turned", "turning")
    )
    sizes = [part.frequency.size for part in scaled]
    owner = np.repeat(np.arange(len(kept)), sizes)
    scale = np.concatenate([1 / shapes[k][rows[k]] for k in kept])
    return _Equations(
        knots=knots,
        frequency=omega,
        duration=np.repeat([part.duration for part in scaled], sizes),
        scale=scale,
        command=U,
        motion=V,
        instrument=None if all(spectra[k].instrument is spectra[k].command for k in kept) else R,
        turned=D,
        turning=late,
        ends=np.hstack([_transients(omega, knots[0], scale * (owner == j)) for j in range(len(kept))]),
    )


class _Known(NamedTuple):
    """What is roughly known of an axis, or D candidates for it: each of the three has 1 or D values.

    Attributes:
        delay: Delay that is removed from G, shape (1,) or (D,) [s].
        lag: Time constant of the lag that is removed from G, shape (1,) or (D,) [s].
        late: Time by which the vehicle turns a command later than its stamp, shape (1,) or (D,) [s].
    """

    delay: Array = np.zeros(1)
    lag: Array = np.zeros(1)
    late: Array = np.zeros(1)

    def removed(self, omega: Array) -> Spectrum:
        """Response of delay and lag at some frequencies (N,), shape (1, N) or (D, N)."""
        s = 1j * omega
        return np.asarray(np.exp(-self.delay[:, None] * s) / (1 + self.lag[:, None] * s))


class _Trials(NamedTuple):
    """The matrices of a `Band`, stacked, for D candidates of what is removed.

    Attributes:
        command: Shape (D, N).
        motion: Shape (D, 2 N, 1).
        share: Shape (D, 2 N, 2 J).
        instrument: Shape (D, 2 N, 2 J).
        others: Shape (D, 2 N, Q).
        determined: Which of them the instrument determines, shape (D,).
    """

    command: Spectrum
    motion: Array
    share: Array
    instrument: Array
    others: Array
    determined: Mask


def _trials(one: _Equations, known: _Known) -> _Trials | None:
    """The bands for each candidate of what is known.

    All at once, because the number of calls takes the time, not their size. None if too few equations are left to
    estimate the noise.
    """
    omega, knots = one.frequency, one.knots
    turning = bool(one.turned.any())
    removed = known.removed(omega)
    turn = ((removed if turning else removed[:1]) * one.turned)[..., None][..., : int(turning)]
    columns = [np.broadcast_to(one.ends, (len(turn), *one.ends.shape)), _real(turn), _real(1j * turn)]
    if 2 * omega.size - sum(part.shape[2] for part in columns) - 2 * knots.size < LEAST_FREEDOM:
        return None
    others = np.linalg.qr(np.concatenate(columns, axis=2))[0]
    across = others.transpose(0, 2, 1)
    hats = _hats(omega, knots) * removed[:, :, None] / known.removed(knots)[:, None]

    def free(rows: Array) -> Array:
        return np.asarray(rows - others @ (across @ rows))

    def at_knots(each: Spectrum) -> Array:
        shares = hats * each[..., None]
        return np.concatenate([_real(shares), _real(1j * shares)], axis=2)

    command = one.command + known.late[:, None] * one.turning
    share = at_knots(command)
    outside = share if one.instrument is None else at_knots(one.instrument[None])
    length, D = np.linalg.norm(outside, axis=1), len(share)
    share = free(share)
    basis, triangle = np.linalg.qr(share if one.instrument is None else free(outside))
    determined = (np.abs(np.diagonal(triangle, axis1=1, axis2=2)) > 1e-6 * length).all(axis=1)
    motion = free(_real(one.motion[None, :, None]))
    every = command, motion, share, basis, others, determined
    return _Trials(*(np.broadcast_to(part, (D, *part.shape[1:])) for part in every))


def _best(equations: Sequence[_Equations], tried: _Known) -> _Known:
    """The candidate that fits the bands best."""
    misfit = np.zeros(max(each.size for each in tried))
    for one in equations:
        trials = _trials(replace(one, knots=one.knots[:1]), tried)
        if trials is None:
            continue
        which = trials.determined
        motion, share, instrument = (part[which] for part in (trials.motion, trials.share, trials.instrument))
        across = instrument.transpose(0, 2, 1)
        rest = motion - share @ np.linalg.solve(across @ share, across @ motion)
        freedom = motion.shape[1] - trials.others.shape[2] - share.shape[2]
        misfit[which] += np.log(np.maximum(np.sum(rest[..., 0] ** 2, axis=1) / freedom, 1e-300)) * freedom
    best = int(np.argmin(misfit))
    return _Known(*(each[[best]] if each.size > 1 else each for each in tried))


def _bands(equations: Sequence[_Equations], known: _Known) -> tuple[Band, ...]:
    """Bands with enough equations, for one value of each thing that is known."""
    out = []
    for one in equations:
        trials = _trials(one, known)
        if trials is not None and trials.determined[0]:
            command, motion, share, instrument, others, _ = (part[0] for part in trials)
            common = one.knots, one.frequency, one.duration, one.scale
            out.append(Band(*common, command, motion[:, 0], share, instrument, others))
    return tuple(out)


def _real(rows: Spectrum) -> Array:
    """Real parts, then imaginary ones, along the last axis but one."""
    return np.concatenate([rows.real, rows.imag], axis=-2)


def _transients(omega: Array, unit: float, scale: Array) -> Array:
    """Columns of T of one window, shape (2 N, 6)."""
    s = 1j * omega
    terms = [np.ones_like(s), s / unit, (s / unit) ** 2, *(1 / (s + a) for a in DECAYS)]
    return _real(np.asarray(np.column_stack(terms) * scale[:, None], np.complex128))


def _hats(omega: Array, knots: Array) -> Array:
    """Weight of each knot in linear interpolation, extrapolated beyond the ends, shape (N, J)."""
    if knots.size == 1:
        return np.ones((omega.size, 1))
    left = np.clip(np.searchsorted(knots, omega, side="right") - 1, 0, knots.size - 2)
    along = (omega - knots[left]) / (knots[left + 1] - knots[left])
    unit = np.eye(knots.size)
    return np.asarray(unit[left] * (1 - along)[:, None] + unit[left + 1] * along[:, None])


def _shapes(spectra: Sequence[Spectra], bands: Sequence[Band], before: Sequence[Array]) -> list[Array]:
    """Amplitude of the noise over the frequency for each window: a sum of powers, fitted to the residuals of the bands.

    Source: P. McCullagh, J. A. Nelder, Generalized Linear Models, 2nd ed., 1989, section 8 (a gamma distribution with
    an identity link, by scoring), the sum being kept positive.
    """
    from scipy.optimize import nnls

    if not bands:
        return list(before)
    omega = np.concatenate([np.tile(band.frequency, 2) for band in bands])
    scale = np.concatenate([np.tile(band.scale, 2) for band in bands])
    power = np.concatenate([band.left_over for band in bands]) / scale**2
    duration = np.concatenate([np.tile(band.duration, 2) for band in bands])
    unit = float(np.exp(np.mean(np.log(omega))))
    terms = (omega[:, None] / unit) ** np.array(NOISE_POWERS) * duration[:, None]
    level = np.full(omega.size, power.mean())
    for _ in range(10):
        if not (level > 0).all():
            return list(before)
        level = terms @ nnls(terms / level[:, None], power / level)[0]
    weights = nnls(terms / level[:, None], power / level)[0]
    return [
        np.sqrt(part.duration * (part.frequency[:, None] / unit) ** np.array(NOISE_POWERS) @ weights)
        for part in spectra
    ]
