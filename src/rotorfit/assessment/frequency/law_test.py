"""Bands -> can a law have the frequency response that they show?

The part of the motion that a law does not explain must, in each band, not follow the command: with the commands U, the
law's response G(w; theta) and the instrument Z of each band,

    q = Z^T (V - G U) / s

is noise of unit power, whatever the flight, the loop and the strength of the instrument. The coefficients theta are
free, and separate for each flight, so that the law is tested and not its numbers: the least sum of q^2 over all bands,
Q, is compared with its distribution for noise alone, with s estimated from few frequencies. That distribution is drawn,
with as many degrees of freedom as there are, and matched by c F(D, f) through its mean and variance.

Source: T. W. Anderson, H. Rubin, Ann. Math. Stat. 20 (1949), pp. 46-63 (the test that needs no strong instrument);
B. L. Welch, Biometrika 38 (1951), pp. 330-336, S. Johansen, Biometrika 67 (1980), pp. 85-92 (weights that are
estimated).
"""

from collections.abc import Sequence

import numpy as np

from rotorfit.assessment.frequency.bands import Band
from rotorfit.core.frames import Array
from rotorfit.core.frequency_response import LawTest, Spectrum
from rotorfit.core.laws import Structure
from rotorfit.core.model import Predictor
from rotorfit.core.results import student_quantile
from rotorfit.dynamics.transfer_function import law_response

DRAWS, SEED = 4000, 20
"""Number of draws of Q under the law, and their seed."""

NOTHING = 1e-6
"""Ratio to the largest singular value below which a combination of coefficients has no effect."""

SLOWEST, FASTEST = 1e-3, 300.0
"""Range of dampings that is searched [1/s]."""

DELAYS = (-0.2, 1.5)
"""Range of delays that is searched [s]."""

# The coefficients as the search moves them


def coordinates(structure: Structure, point: Predictor) -> Array:
    """log |g|, log b, tau if there is one, and the estimated further parameters, shape (P,)."""
    extras = [one.coordinate(point.extra[one.name]) for one in structure.extras if one.estimated]
    main = [np.log(max(abs(point.input), 1e-9)), np.log(np.clip(point.damping, SLOWEST, FASTEST))]
    return np.array([*main, *([point.delay] if structure.delayed else []), *extras])


def point_at(structure: Structure, like: Predictor, at: Array) -> Predictor:
    """The parameters at coordinates; the input has the sign of that of `like`."""
    rest = iter(at[2 + structure.delayed :].tolist())
    extra = {one.name: one.value(next(rest)) if one.estimated else like.extra[one.name] for one in structure.extras}
    delay = float(at[2]) if structure.delayed else like.delay
    return Predictor(float(np.copysign(np.exp(at[0]), like.input)), float(np.exp(at[1])), delay, extra)


def _limits(structure: Structure) -> tuple[Array, Array]:
    extras = [(one.coordinate(one.low), one.coordinate(one.high)) for one in structure.extras if one.estimated]
    main = [(-20.0, 20.0), (np.log(SLOWEST), np.log(FASTEST)), *([DELAYS] if structure.delayed else [])]
    low, high = zip(*main, *extras, strict=True)
    return np.array(low), np.array(high)


# The test


def law_test(bands: Sequence[Band], structure: Structure, start: Predictor) -> LawTest | None:
    """Tests whether a law, with any coefficients, can have the response that the bands of a flight show.

    Args:
        bands: Bands of one axis.
        structure: A law with a transfer function.
        start: Coefficients from which the search begins.

    Returns:
        The test; None without bands, without noise, or without degrees of freedom left.
    """
    from scipy.optimize import least_squares
    from scipy.special import chdtrc, fdtrc

    if not bands:
        return None
    low, high = _limits(structure)
    spread = [np.sqrt(band.noise) for band in bands]
    if min(spread) <= 0:
        return None

    def missed(at: Array) -> Array:
        point = point_at(structure, start, at)
        q = [_left(band, law_response(structure, point, band.frequency)) / s
             for band, s in zip(bands, spread, strict=True)]  # fmt: skip
        return np.asarray(np.concatenate(q), np.float64)

    first = np.clip(coordinates(structure, start), low + 1e-6, high - 1e-6)
    best = least_squares(missed, first, bounds=(low, high), x_scale=np.full(first.size, 0.1), method="trf")
    singular = np.linalg.svd(best.jac, compute_uv=False)
    freedom = best.fun.size - int(np.sum(singular > NOTHING * singular[0]))
    if freedom < 1:
        return None
    noise = np.repeat([band.freedom for band in bands], [2 * band.knots.size for band in bands])
    c, f = _null(best.jac, noise, [band.knots.size for band in bands])
    Q = float(best.fun @ best.fun)
    point = point_at(structure, start, best.x)
    sigmas = np.concatenate([_sigmas(band, law_response(structure, point, band.knots)) for band in bands])
    shares = sigmas / np.repeat([student_quantile(band.freedom) for band in bands], [band.knots.size for band in bands])
    worst = int(np.argmax(shares))
    knots = np.concatenate([band.knots for band in bands])
    p = float(fdtrc(freedom, f, Q / (c * freedom)) if np.isfinite(f) else chdtrc(freedom, Q / c))
    return LawTest(Q / freedom, freedom, p, float(knots[worst]), float(sigmas[worst]), float(shares[worst]))


def _left(band: Band, response: Spectrum) -> Array:
    """Component along the instrument of the motion minus that of a response at the band's frequencies, shape (2 J,)."""
    return np.asarray(band.instrument.T @ (band.motion - band.moved_by(response)))


def _sigmas(band: Band, response: Spectrum) -> Array:
    """Distance of a response at the knots from the band's, in standard errors, the larger of both parts, shape (J,)."""
    off = band.response - response
    errors = np.sqrt(np.diag(band.covariance)).reshape(2, -1)
    return np.asarray(np.max(np.abs([off.real, off.imag]) / errors, axis=0), np.float64)


def _null(slope: Array, noise: Array, sizes: Sequence[int]) -> tuple[float, float]:
    """c and f for which Q under the law is approximately c D F(D, f), where D are its degrees of freedom.

    Args:
        slope: Derivative of the residuals with respect to the coefficients, shape (2 J, P).
        noise: Real degrees of freedom of the variance estimate of each residual, shape (2 J,).
        sizes: Number of knots of each band, whose residuals share that variance.
    """
    rng = np.random.default_rng(SEED)
    owner = np.repeat(np.arange(len(sizes)), 2 * np.asarray(sizes))
    first = np.searchsorted(owner, np.arange(len(sizes)))
    variance = rng.chisquare(noise[first], (DRAWS, len(sizes))) / noise[first]
    weight = 1 / np.sqrt(variance[:, owner])
    basis, size, _ = np.linalg.svd(slope, full_matrices=False)
    X = basis[:, size > NOTHING * size[0]]
    r = weight * rng.standard_normal((DRAWS, noise.size))
    through = (weight * r) @ X
    gram = (weight**2 @ (X[:, :, None] * X[:, None, :]).reshape(len(X), -1)).reshape(DRAWS, X.shape[1], X.shape[1])
    told = np.einsum("dp,dp->d", through, np.linalg.solve(gram, through[..., None])[..., 0])
    Q, D = np.sum(r**2, axis=1) - told, noise.size - X.shape[1]
    return matched(float(Q.mean()) / D, float(Q.var()) / D**2, D)


def matched(mean: float, variance: float, D: int) -> tuple[float, float]:
    """c and f of c F(D, f) with a given mean and variance; f is infinite if the tail is no heavier than chi-squared's.

    The variance of F(D, f) over its squared mean is 2 (D + f - 2) / (D (f - 4)).
    """
    ratio = D * variance / mean**2 / 2
    if ratio <= 1.0:
        return mean, np.inf
    f = (D - 2 + 4 * ratio) / (ratio - 1)
    return mean * (f - 2) / f, f
