"""Tests of the innovations: are they white, independent of past commands, and of unit variance?

An innovation is the part of a block of poses that the model did not predict. In a feedback loop later commands respond
to it, so only earlier commands can be tested; the innovations must not follow those, loop or no loop.
All three tests allow for a variance that changes during a flight, as it does in gusts. Whiteness and independence are
tested with the flight's own disturbance levels: different wind is not an error of the model. The variance ratio shows
how different it is.

Source: L. Ljung, System Identification, 2nd ed., 1999, chapter 16; T. Soderstrom, P. Stoica, System Identification,
1989, chapter 11; G. M. Ljung, G. E. P. Box, Biometrika 65 (1978), pp. 297-303.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from rotorfit.core.finding import Finding
from rotorfit.core.frames import Array
from rotorfit.core.model import COEFFICIENTS, NORMAL
from rotorfit.core.residuals import Correlogram, Innovations, ResidualTests, told_p
from rotorfit.core.results import student_quantile
from rotorfit.dynamics.long_run import frequencies, variance_of_mean
from rotorfit.estimation.regression.paper import newey_west

REACH = 1.0
"""Longest lag of the tests [s]."""

COMMAND_EVERY = 0.1
"""Spacing of the past commands that are tested together [s]."""

LEVEL = 0.05
"""p-value below which a test rejects the model."""

FINDING_LEVEL = 0.001
"""p-value below which it is a finding: flights have several axes, and a finding must not come by chance."""

LARGE = 0.05
"""Share of the innovations' variance above which what follows past commands hides itself, see `_as_noise`. Of 60
axes of models of the same simulated vehicle one had more than 0.04, of 16 of another vehicle none less than 0.09."""

BY_CHANCE = 6.0
"""Times by which that share must also exceed (2 m)^0.5 / n, the standard deviation of what m commands explain of n
white innovations by chance: in flights of 5 s it is often more than 0.05, and what such commands leave is less than the
noise. Of 1389 axes of right models on flights of 5 to 10 s 35 were findings without it, none from 4 times on; of axes
of another vehicle on 10 s it costs none."""

OPTIMISTIC = 1.1
"""Factor by which intervals must be too narrow for the finding to be a warning."""

LINEAR, LINEAR_DELAY = 0.5, 0.1
"""Largest relative steps of input and damping, and of the delay [s], that one linear step can tell."""

GAP = 1.75
"""Number of median steps between two blocks from which on poses are missing between them."""

LEAST_BLOCKS = 100
"""Number of innovations below which nothing is tested."""

TOGETHER = 8
"""Number of lags whose correlations are computed together: more would take more memory than all else."""

DISTINCT = 1e-3
"""Share of the largest variance below which a combination of past commands is left out as a copy of the others."""


def autocorrelation(time: Array, innovation: Array, reach: float = REACH) -> Correlogram:
    """Autocorrelation of innovations, without pairs across gaps, with bands that allow for a changing variance.

    Args:
        time: Shape (B,) [s].
        innovation: Shape (B,).
        reach: Longest lag [s].

    Source: V. Dalla, L. Giraitis, P. C. B. Phillips, Econometric Theory 38 (2022), pp. 913-941, for the bands; of
    constant variance they are 1.96 over the root of N.
    """
    e = innovation - innovation.mean()
    power, piece = float(e @ e), _pieces(time)
    lags = np.arange(1, _lag_count(time, reach) + 1)
    value, band = np.zeros(lags.size), np.zeros(lags.size)
    for i, k in enumerate(lags):
        product = (e[k:] * e[:-k])[piece[k:] == piece[:-k]]
        if product.size:
            size = power * product.size / (e.size - k)
            value[i], band[i] = product.sum() / size, NORMAL * np.sqrt(product @ product) / size
    return Correlogram(np.asarray(_step(time) * lags, float), value, band)


def cross_correlation(innovations: Innovations, covariance: Array) -> Correlogram:
    """Correlation of innovations with earlier commands, with bands that also hold for coloured innovations.

    Args:
        innovations: Innovations of one axis.
        covariance: Covariance of the parameters, as for `residual_tests`.

    Source: Ljung 1999, section 16.6: the variance is the sum of the products of both autocovariances, here estimated
    from the products themselves (W. K. Newey, K. D. West, Econometrica 55 (1987), pp. 703-708).
    """
    u = innovations.past - innovations.past.mean(axis=0)
    e = innovations.innovation - innovations.innovation.mean()
    left = _as_noise(innovations, covariance)
    size = np.sqrt(float(e @ e) * np.sum(u**2, axis=0))
    value, band = np.zeros(size.size), np.zeros(size.size)
    told = np.flatnonzero(size > 0)
    for first in range(0, told.size, TOGETHER):
        some = told[first : first + TOGETHER]
        total, spread = _with_command(innovations, u[:, some], covariance, left)
        value[some], band[some] = total / size[some], NORMAL * np.sqrt(np.diag(spread)) / size[some]
    lag = _step(innovations.time) * np.arange(1, size.size + 1)
    return Correlogram(np.asarray(lag, float), value, band)


def residual_tests(
    innovations: Innovations, at_fitted_levels: Array, covariance: Array, training_share: float
) -> ResidualTests | None:
    """All tests of one axis on one flight; None for fewer than 100 innovations.

    Args:
        innovations: Innovations at this flight's own disturbance levels.
        at_fitted_levels: Innovations at the levels of the fit, shape (B,).
        covariance: Covariance of the parameters of the sensitivities, shape (P, P), for a model from other flights;
            zeros if it was fitted to this one.
        training_share: Duration of this flight over that of the flights of the fit, to allow for the error of its
            levels.
    """
    e = innovations.innovation
    if e.size < LEAST_BLOCKS:
        return None
    found = autocorrelation(innovations.time, e)
    n, lags = e.size, found.lag.size
    classic = float(n * (n + 2) * np.sum(found.value**2 * _pair_shares(innovations.time, lags)))
    told = found.band > 0  # a predictor without any error has no band, nor has a lag longer than every piece
    robust = float(np.sum((NORMAL * found.value[told] / found.band[told]) ** 2))
    command_p, freedom = _independence(innovations, covariance)
    with_command = cross_correlation(innovations, covariance)
    size, band = np.abs(with_command.value), with_command.band
    if min(band[band > 0], default=0.0) >= 1:  # coefficients so uncertain that any correlation could be theirs
        command_p, freedom = None, 0
    share = np.divide(size, band, out=np.zeros_like(size), where=band > 0)  # no band without a command
    peak = int(np.argmax(share))
    white_p = _chi_squared(robust, max(int(np.sum(told)), 1))
    count, ratio = frequencies(n), float(np.mean(at_fitted_levels**2))
    spread = float(variance_of_mean(at_fitted_levels[:, None] ** 2, count)[0, 0]) * (1 + training_share)
    half = student_quantile(count) * spread**0.5
    own_p, own_step = _with_own(innovations) if command_p is not None and command_p < LEVEL else (None, {})
    return ResidualTests(
        n=n,
        lags=lags,
        ljung_box=classic,
        ljung_box_p=_chi_squared(classic, lags),
        white_p=white_p,
        command_freedom=freedom,
        command_p=command_p,
        command_peak=float(share[peak]) if freedom else None,
        command_peak_lag=float(with_command.lag[peak]) if freedom else None,
        variance_ratio=ratio,
        variance_ci95=(max(0.0, ratio - half), ratio + half),
        optimism=_optimism(innovations, found.value),
        white=white_p >= LEVEL,
        follows_command=None if command_p is None else command_p < LEVEL,
        own_p=own_p,
        own_step=own_step,
    )


def _with_own(innovations: Innovations) -> tuple[float | None, dict[str, float]]:
    """p-value of independence from past commands with parameters of the flight's own, and the step to them.

    What other parameters can do is removed from the innovations and from the commands.
    """
    e, past, S = innovations.innovation, innovations.past, innovations.sensitivity
    step = np.linalg.lstsq(S, e)[0]
    own = replace(innovations, innovation=e - S @ step, past=past - S @ np.linalg.lstsq(S, past)[0])
    p, _ = _independence(own, np.zeros((step.size, step.size)))
    return p, dict(zip(COEFFICIENTS, step.tolist(), strict=False))


def _independence(innovations: Innovations, covariance: Array) -> tuple[float | None, int]:
    """p-value of no correlation with any of the past commands jointly, and how many of these are independent."""
    u = _distinct(innovations)
    if not u.size:
        return None, 0
    total, spread = _with_command(innovations, u, covariance, _as_noise(innovations, covariance))
    return _chi_squared(float(total @ np.linalg.solve(spread, total)), total.size), total.size


def _distinct(innovations: Innovations) -> Array:
    """Combinations of past commands that are no copies of each other, shape (B, m)."""
    every = max(1, round(COMMAND_EVERY / _step(innovations.time)))
    u = innovations.past[:, ::every] - innovations.past[:, ::every].mean(axis=0)
    size, directions = np.linalg.eigh(u.T @ u)
    return np.asarray(u @ directions[:, (size > 0) & (size > DISTINCT * size[-1])])


def _as_noise(innovations: Innovations, covariance: Array) -> Array:
    """The innovations as they count in the covariance of their products with commands, shape (B,).

    Where they follow past commands widely, also with the parameters moved within their uncertainty, it is what these
    commands leave of them: else their own products would make any correlation plausible.
    """
    e, u, S = innovations.innovation - innovations.innovation.mean(), _distinct(innovations), innovations.sensitivity
    n, m = u.shape
    moved = e - S @ covariance @ np.linalg.solve(np.eye(len(covariance)) + S.T @ S @ covariance, S.T @ e)
    large = max(LARGE, BY_CHANCE * np.sqrt(2 * m) / n)
    return _left(u, e) if m and _share(u, moved) > large else e


def _with_command(innovations: Innovations, u: Array, covariance: Array, left: Array) -> tuple[Array, Array]:
    """Products of innovations and past commands (B, m), summed, and the covariance of the sums.

    The covariance includes the uncertainty of the model's own parameters.

    Args:
        innovations: Innovations of one axis.
        u: Past commands, without their means, shape (B, m).
        covariance: Covariance of the parameters, as for `residual_tests`.
        left: From `_as_noise`.

    Source: lags of the kernel by W. K. Newey, K. D. West, Rev. Econ. Stud. 61 (1994), pp. 631-653: 4 (B / 100)^(2/9).
    """
    scores = u * left[:, None]
    lag = (int(4 * (len(scores) / 100) ** (2 / 9)) + 1) * _step(innovations.time)
    through = u.T @ innovations.sensitivity
    spread = newey_west(innovations.time, scores - scores.mean(axis=0), lag)
    total = u.T @ (innovations.innovation - innovations.innovation.mean())
    return total, spread + through @ covariance @ through.T


def _share(u: Array, e: Array) -> float:
    """Share of the variance of e (n,) that the commands u (n, m) explain, adjusted for their number."""
    n, m = u.shape
    left = _left(u, e)
    return float(1 - left @ left / (e @ e) * (n - 1) / max(n - m - 1, 1))


def _left(u: Array, e: Array) -> Array:
    """What the commands u (n, m) leave of e (n,)."""
    return np.asarray(e - u @ np.linalg.lstsq(u, e)[0])


def _optimism(innovations: Innovations, colour: Array) -> dict[str, float]:
    """Ratio of each coefficient's standard deviation with innovations of this colour to that with white ones.

    Without those of which the flight says nothing.

    Source: Bartlett's formula: the sum over the lags of the products of both autocorrelations, here of the innovations
    and of their weights in the estimate, up to the reach of the tests.
    """
    X = innovations.sensitivity
    out, fading = {}, 1 - np.arange(1, colour.size + 1) / (colour.size + 1)
    for name, weight in zip(COEFFICIENTS, (X @ np.linalg.pinv(X.T @ X, hermitian=True)).T, strict=False):
        power = float(weight @ weight)
        if not power:  # no command changes during the flight, which then says nothing of the delay
            continue
        own = np.array([float(weight[k:] @ weight[:-k]) / power for k in range(1, colour.size + 1)])
        out[name] = float(np.sqrt(max(0.0, 1 + 2 * float(np.sum(fading * colour * own)))))
    return out


def _step(time: Array) -> float:
    """Mean duration of the blocks: whole poses do not fill blocks of one length, 0.03, 0.03 and 0.04 s at 50 Hz."""
    steps = np.diff(time)
    return float(np.mean(steps[steps < GAP * np.median(steps)]))


def _pieces(time: Array) -> Array:
    """Number of the piece between gaps that each block lies in, shape (B,)."""
    steps = np.diff(time)
    return np.concatenate([[0], np.cumsum(steps >= GAP * np.median(steps))])


def _pair_shares(time: Array, lags: int) -> Array:
    """Pairs within a piece at lags 1, 2, ..., over the square of all pairs at the lag, shape (lags,)."""
    piece, n = _pieces(time), time.size
    return np.array([np.sum(piece[k:] == piece[:-k]) / (n - k) ** 2 for k in range(1, lags + 1)])


def _lag_count(time: Array, reach: float) -> int:
    return max(1, min(round(reach / _step(time)), time.size // 4))


def _chi_squared(statistic: float, freedom: int) -> float:
    from scipy.special import chdtrc

    return float(chdtrc(freedom, statistic))


def narrows_intervals(tests: ResidualTests) -> bool:
    """Whether the innovations' colour certainly makes intervals too narrow."""
    return tests.white_p < FINDING_LEVEL and max(tests.optimism.values(), default=1.0) >= OPTIMISTIC


def has_own_coefficients(tests: ResidualTests) -> bool:
    """Whether coefficients of the flight's own explain why its innovations follow past commands."""
    return tests.own_p is not None and tests.own_p >= LEVEL


def _own_words(step: Mapping[str, float]) -> str:
    """The step to coefficients of the flight's own, as far as one linear step can tell it."""
    if abs(step["input"]) > LINEAR or abs(step["damping"]) > LINEAR or abs(step["delay"]) > LINEAR_DELAY:
        return "far from these"
    input_times, damping_times = 1 + step["input"], np.exp(step["damping"])
    return f"input {input_times:.2f} times, damping {damping_times:.2f} times, delay {step['delay']:+.3f} s"


def findings_of_residuals(axis: str, tests: ResidualTests, where: str) -> Iterator[Finding]:
    """Findings from the tests of one axis on one flight.

    Args:
        axis: Name of the axis.
        tests: Tests of its innovations.
        where: Name of the flight, for the evidence.
    """
    factor = max(tests.optimism.values(), default=1.0)
    if tests.white_p < FINDING_LEVEL:
        narrow = narrows_intervals(tests)
        yield Finding(
            "residuals_not_white",
            "warning" if narrow else "info",
            f"{where}: the innovations of {axis} are correlated over {tests.lags} lags ({told_p(tests.white_p)}; "
            f"Ljung-Box {tests.ljung_box:.0f}, expected {tests.lags})",
            f"intervals of {axis} are optimistic by about the factor {factor:.2f}"
            if narrow
            else f"little: intervals of {axis} would change by about the factor {factor:.2f}"
            if factor * OPTIMISTIC > 1
            else f"none that harms: intervals of {axis} could be narrower, by about the factor {factor:.2f}",
            f"multiply the half widths of {axis} by {factor:.2f}, or judge by flight-to-flight scatter "
            "(fit --leave-one-out)"
            if narrow
            else "nothing for the coefficients; the disturbance has a colour of its own",
            axis,
        )
    if tests.command_p is not None and tests.command_p < FINDING_LEVEL and tests.command_peak_lag is not None:
        yield Finding(
            "residuals_follow_command",
            "warning",
            f"{where}: the innovations of {axis} follow its own past commands ({told_p(tests.command_p)}), "
            + (
                f"most those of {tests.command_peak_lag:.2f} s before, by {tests.command_peak:.1f} times the 95 % band"
                if tests.command_peak and tests.command_peak > 1
                else "all of the last second together, those of no single moment"
            ),
            *(
                (
                    f"other coefficients than the model's ({_own_words(tests.own_step)}) describe {axis} on this "
                    "flight, with nothing left that follows the command: the vehicle differs on this flight, or its "
                    "answer depends on the size or speed of the commands",
                    "if its commands are of other size or speed than those of the fit, fit a flight that holds both; "
                    "else compare settings, payload, battery and wind, and fit the flights together: several tell how "
                    "much flights differ",
                )
                if has_own_coefficients(tests)
                else (
                    f"the model leaves out part of the response of {axis}: its coefficients may be off beyond their "
                    "intervals",
                    "look where predictions fail in the report; fit the flight by itself, or a richer structure",
                )
            ),
            axis,
        )
