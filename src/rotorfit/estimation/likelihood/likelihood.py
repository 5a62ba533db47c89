"""The grey-box likelihood: residuals of the response -> whitening filter -> score, with gradients and information.

Source: the Kalman likelihood of the model (5) with delay, trim and a slow disturbance; the mean and all its
sensitivities pass through the gains of one filter, so the gradient costs one pass. Coefficients enter as
(g, log b, tau), so the damping is positive by construction.
"""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from rotorfit.core.frames import Array, Indices, Mask
from rotorfit.core.laws import ZERO
from rotorfit.dynamics.velocity_fusion import BIAS_VARIANCE, whiten_fused
from rotorfit.dynamics.whitening import Piece, axis_pieces, plane_pieces
from rotorfit.estimation.likelihood.block_response import response
from rotorfit.estimation.likelihood.blocks import Record
from rotorfit.estimation.likelihood.parameters import Point


def segments(records: Sequence[Record]) -> list[slice]:
    """The rows of `Point.start` that belong to each flight."""
    ends = np.cumsum([0, *(rec.starts.size for rec in records)])
    return [slice(int(low), int(high)) for low, high in itertools.pairwise(ends)]


def whiten(rec: Record, columns: Array, levels: Array) -> tuple[Array, Array]:
    """Passes columns (B, C, K) through the filter of log levels (K, L).

    Returns:
        Standardised rows (B, C, K), x and y in the heading frame, and variances (B, K).
    """
    rows, _, variance = whiten_under(rec, columns, levels[None])
    return rows, variance[0]


def whiten_under(rec: Record, columns: Array, levels: Array) -> tuple[Array, Array, Array]:
    """Passes all columns through the filter of the first of several levels, and the first column through each of them.

    Args:
        rec: The flight.
        columns: Shape (B, C, K), world frame.
        levels: Log levels, shape (M, K, L).

    Returns:
        Rows (B, C, K), the first column (M, B, K), and the variances (M, B, K).
    """
    B, C, K = columns.shape
    rows, first, variances = np.empty((B, K, C)), np.empty((len(levels), B, K)), np.empty((len(levels), B, K))
    for at, own, others, variance in _filtered(rec, [columns.transpose(0, 2, 1)], levels, 1):
        rows[at], first[0, at], first[1:, at], variances[:, at] = own, own[:, :, 0], others[:, :, :, 0], variance
    return rows.transpose(0, 2, 1), first, variances


def _filtered(rec: Record, columns: Sequence[Array], levels: Array, few: int) -> Iterator[Piece]:
    """Passes columns through filters of several levels, piece by piece.

    Args:
        rec: The flight.
        columns: World frame, in arrays of shape (B, K, ...) whose last dimensions add up to C.
        levels: Log levels, shape (M, K, L).
        few: Number of columns for all filters but the first, which takes all of them.

    Yields:
        The blocks of the piece, b of them, rows of the first filter (b, K, C), x and y in the heading frame, those of
        the others (M - 1, b, K, few), and the variances (M, b, K).
    """
    values = np.exp(levels)
    if rec.rate is not None:
        turned = np.concatenate(columns, axis=2).transpose(0, 2, 1)
        passed = [fused(rec, turned if m == 0 else turned[:, :few], one) for m, one in enumerate(values)]
        rows = [part.transpose(0, 2, 1) for part, _ in passed]
        others = np.array(rows[1:]).reshape(len(rows) - 1, rec.count.size, len(rec.axes), few)
        yield slice(0, rec.count.size), rows[0], others, np.array([variance for _, variance in passed])
    elif len(rec.axes) == 2:
        yield from plane_pieces(rec.steps, rec.step, rec.count, rec.fresh, rec.turn, columns, values, few)
    else:
        along = [part[:, 0] for part in columns]
        alone = axis_pieces(rec.steps, rec.step, rec.count, rec.fresh, along, values[:, 0], few)
        for at, first, others, variance in alone:
            yield at, first[:, None], others[:, :, None], variance[:, :, None]


def fused(rec: Record, columns: Array, levels: Array, coloured: bool = False) -> tuple[Array, Array]:
    """The filter of a record with velocities; see `whiten_fused`. Here `levels` (K, L) are not logarithms."""
    assert rec.rate is not None
    assert rec.rounding is not None
    noise = np.ascontiguousarray(levels[:, [1, 1 if rec.measured == "velocity" else 4]])  # compiled for one layout
    noise[:, 1] += rec.rounding
    bias = 0.0 if rec.measured == "velocity" else BIAS_VARIANCE
    columns = np.ascontiguousarray(columns)
    return whiten_fused(  # type: ignore[no-any-return]
        rec.steps, rec.step, rec.count, rec.fresh, rec.rate, rec.block_yaw, columns, levels, noise, bias, coloured
    )


@dataclass(frozen=True)
class LikelihoodScore:
    """The likelihood at a point, over the n coefficients, trims and start velocities and the L K levels.

    Attributes:
        log_likelihood: Log-likelihood of all flights together.
        adjustment: Term of the restricted likelihood, minus half the log determinant of the coefficients' information;
            and of a prior, if one was added.
        gradient: Gradient of the log-likelihood, for the levels with the adjustment, shape (n + L K,).
        information: Expected information, shape (n + L K, n + L K); block diagonal, with one block for the n parameters
            and one for the levels.
        slopes: Derivative of the coefficients' information, at the reference, by each log level, shape (L K, n, n);
            (0, n, n) where the adjustment was taken to first order.
        cross: Derivative of the coefficients' gradient, at the sensitivities of the reference, by each log level, shape
            (n, L K); (n, 0) likewise.
        innovations: Standardised innovations of each flight, heading frame, shape (B, K).
        linear: The adjustment to first order; None without a restriction.
    """

    log_likelihood: float
    adjustment: float
    gradient: Array
    information: Array
    slopes: Array
    cross: Array
    innovations: tuple[Array, ...]
    linear: "LinearAdjustment | None"

    @property
    def objective(self) -> float:
        """The maximised function: log-likelihood plus adjustment."""
        return self.log_likelihood + self.adjustment

    @property
    def exact(self) -> bool:
        """Whether the adjustment, where there is one, was not taken to first order."""
        return self.linear is None or self.slopes.size > 0


LEVEL_STEP = 1e-6
"""Step of the finite differences by the logarithm of a level."""


@dataclass(frozen=True)
class Restriction:
    """The effects that restricted likelihood projects out of the data for the levels.

    Attributes:
        active: True for the free parameters before the levels, shape (n,).
        sensitivities: Sensitivities of the response of each flight at a reference point near the maximum, shape
            (B, (5 + E) K, K). They are fixed, so that the coefficients follow the plain likelihood.
    """

    active: Mask
    sensitivities: tuple[Array, ...]


@dataclass(frozen=True)
class LinearAdjustment:
    """The adjustment of the restricted likelihood, to first order in the log levels.

    It takes filters of every sensitivity at every level, which is most of the work of a pass, and it is nearly linear:
    the information of the coefficients goes by the powers of the noises, so that its log determinant goes by their
    logarithms.

    Attributes:
        levels: Log levels where it was computed, shape (L K,).
        value: The adjustment there.
        slope: Its derivative there, shape (L K,).
    """

    levels: Array
    value: float
    slope: Array

    def at(self, levels: Array) -> float:
        """The adjustment at log levels (K, L)."""
        return self.value + float(self.slope @ (levels.ravel() - self.levels))

    def reaches(self, levels: Array, reach: float) -> bool:
        """Whether no log level (K, L) is further away than `reach`."""
        return bool(np.abs(levels.ravel() - self.levels).max() <= reach)


def restriction(records: Sequence[Record], point: Point, free: Mask) -> Restriction:
    """The restriction with a point as its reference; `free` covers all parameters, shape (n + L K,)."""
    columns = (response(rec, point, j, point.start[at])[1] for j, (rec, at) in enumerate(_flights(records)))
    return Restriction(free[: point.n], tuple(columns))


def _flights(records: Sequence[Record]) -> list[tuple[Record, slice]]:
    return list(zip(records, segments(records), strict=True))


def score(
    records: Sequence[Record], point: Point, restricted: Restriction | LinearAdjustment | None = None
) -> LikelihoodScore:
    """Log-likelihood with gradient and information in one pass over the flights.

    The levels follow the restricted likelihood: fitted coefficients absorb part of the disturbance, and the plain
    likelihood would treat the rest as all of it.

    Args:
        records: The flights.
        point: The parameters.
        restricted: The restriction, or its adjustment to first order, for half of the work or less; None leaves out
            gradient and information of the levels.

    Source: H. D. Patterson, R. Thompson, Biometrika 58 (1971), pp. 545-554; D. R. Cox, N. Reid, J. R. Statist. Soc.
    B 49 (1987), pp. 1-39.
    """
    K, n, L = point.gain.size, point.n, point.levels.size
    information, gradient = np.zeros((n + L, n + L)), np.zeros(n + L)
    exact = isinstance(restricted, Restriction)
    slopes = _Slopes.none(n, L if exact else 0)
    log_likelihood, innovations = 0.0, []
    levels, looked = _changed(point) if restricted is not None else (point.levels[None], [])
    for j, (rec, at) in enumerate(_flights(records)):
        mean, sensitivity = response(rec, point, j, point.start[at])
        columns = [(rec.position - mean)[:, None], sensitivity]
        if isinstance(restricted, Restriction):
            columns.insert(1, restricted.sensitivities[j])
        few = 1 + (columns[1].shape[1] if exact else 0)
        own = np.array([0, *range(few, few + sensitivity.shape[1])])
        innovations.append(np.empty((rec.count.size, K)))
        places = _places(rec, point, j, at)
        turned = [part.transpose(0, 2, 1) for part in columns]
        for piece, rows, others, variance in _filtered(rec, turned, levels, few):
            log_variance = np.log(variance).reshape(len(levels), -1)
            for where, part in _parts(rec, places, piece):
                product = _gram(rows[part])
                among = product[own[:, None], own]
                information[where[:, None], where] += among[1:, 1:]
                gradient[where] += among[1:, 0]
                log_likelihood -= 0.5 * float(among[0, 0])
                if exact:
                    base, changed = product[:few, :few], [_gram(one[part]) for one in others]
                    slopes.add(where, base, changed, looked, K)
            log_likelihood -= 0.5 * float(log_variance[0].sum() + log_variance[0].size * np.log(2 * np.pi))
            innovations[-1][piece] = rows[:, :, 0]
            if restricted is None:
                continue
            e = rows[:, :, 0].ravel()
            d_innovation, d_log_variance = np.empty((2, L, e.size))
            d_innovation[looked] = (others[:, :, :, 0].reshape(len(looked), -1) - e) / LEVEL_STEP
            d_log_variance[looked] = (log_variance[1:] - log_variance[0]) / LEVEL_STEP
            if 0 not in looked:  # see `_changed`
                later, scales = np.repeat(~rec.fresh[piece], K), _scales(K)[1:]
                d_innovation[0] = -0.5 * e * later - d_innovation[scales].sum(axis=0)
                d_log_variance[0] = later - d_log_variance[scales].sum(axis=0)
            raw = d_innovation + 0.5 * e * d_log_variance
            information[n:, n:] += raw @ raw.T + 0.5 * d_log_variance @ d_log_variance.T
            gradient[n:] -= d_innovation @ e + 0.5 * d_log_variance.sum(axis=1)
    linear = restricted if isinstance(restricted, LinearAdjustment) else None
    if isinstance(restricted, Restriction):
        linear = slopes.adjustment(point.levels.ravel(), restricted.active)
    adjustment = 0.0
    if linear is not None:
        adjustment = linear.at(point.levels)
        gradient[n:] += linear.slope
    return LikelihoodScore(
        log_likelihood, adjustment, gradient, information, slopes.slopes, slopes.cross, tuple(innovations), linear
    )


def linear_scores(records: Sequence[Record], points: Sequence[Point], k: int) -> list[LikelihoodScore]:
    """The scores at points with the same levels, in one pass of the filter over the flights.

    Of gradient and information only the part of the gain and the zero of axis k, the trims and the start velocities is
    computed: the motion is linear in them, if not in gain and zero together.

    Args:
        records: The flights.
        points: The parameters, equal in shape and levels.
        k: Index of the axis.
    """
    first, N = points[0], len(points)
    K, n, L = first.gain.size, first.n, first.levels.size
    information, gradient, log_likelihood = np.zeros((N, n + L, n + L)), np.zeros((N, n + L)), np.zeros(N)
    zeros = [(3 + e) * K + k for e, one in enumerate(first.extras(k)) if one.place == ZERO]
    linear = [k, *zeros, *range(-2 * K, 0)]
    for j, (rec, at) in enumerate(_flights(records)):
        columns = []
        for point in points:
            mean, sensitivity = response(rec, point, j, point.start[at])
            own = [(rec.position - mean)[:, None], sensitivity[:, linear]]
            columns += [part.transpose(0, 2, 1) for part in own]
        places = [where[linear] for where in _places(rec, first, j, at)]
        for piece, rows, _, variance in _filtered(rec, columns, first.levels[None], 1):
            each = rows.reshape(-1, K, N, 1 + len(linear)).transpose(2, 0, 1, 3)
            for where, part in _parts(rec, places, piece):
                flat = each[:, part].reshape(N, -1, 1 + len(linear))
                product = flat.transpose(0, 2, 1) @ flat
                information[:, where[:, None], where] += product[:, 1:, 1:]
                gradient[:, where] += product[:, 1:, 0]
                log_likelihood -= 0.5 * product[:, 0, 0]
            log_likelihood -= 0.5 * float(np.log(2 * np.pi * variance).sum())
    none = _Slopes.none(n, 0)
    return [
        LikelihoodScore(float(value), 0.0, slope, square, none.slopes, none.cross, (), None)
        for value, slope, square in zip(log_likelihood, gradient, information, strict=True)
    ]


def _gram(rows: Array) -> Array:
    """Products of the columns of rows (b, K, C) with each other, shape (C, C)."""
    flat = rows.reshape(-1, rows.shape[2])
    return flat.T @ flat


def _scales(K: int) -> list[int]:
    """Places of q and r of every axis among the log levels of positions."""
    return [place for k in range(K) for place in (4 * k, 4 * k + 1)]


def _changed(point: Point) -> tuple[Array, list[int]]:
    """The log levels (K, L) and, after them, those with each of them changed in turn; and which of them those are.

    All q and r of positions together only scale every variance except that of the unknown start, so the first is left
    out: its derivatives follow from those of the others.
    """
    L = point.levels.size
    looked = list(range(1 if point.measured == "position" else 0, L))
    levels = np.repeat(point.levels[None], 1 + len(looked), axis=0)
    levels.reshape(len(levels), L)[1 + np.arange(len(looked)), looked] += LEVEL_STEP
    return levels, looked


@dataclass(frozen=True)
class _Slopes:
    """The information of the coefficients at the reference, and derivatives by the levels, summed over flights.

    Attributes:
        projected: Information, shape (n, n).
        slopes: See `LikelihoodScore`, like `cross`.
        cross: Likewise.
    """

    projected: Array
    slopes: Array
    cross: Array

    @classmethod
    def none(cls, n: int, L: int) -> "_Slopes":
        """Those of no flight, for n parameters and L levels."""
        return cls(np.zeros((n, n)), np.zeros((L, n, n)), np.zeros((n, L)))

    def add(self, where: Indices, base: Array, changed: Sequence[Array], looked: Sequence[int], K: int) -> None:
        """Adds a stretch of blocks.

        Args:
            where: Places of its columns among all parameters.
            base: Products of residual and fixed sensitivities, whitened, shape (C, C).
            changed: The same with each of the levels `looked` changed.
            looked: See `_changed`.
            K: Number of axes.
        """
        square, scaling = (where[:, None], where), 0 not in looked
        self.projected[square] += base[1:, 1:]
        if scaling:  # all scales together; the shares of the others are subtracted below
            self.slopes[0][square] -= base[1:, 1:]
            self.cross[where, 0] -= base[1:, 0]
        for i, product in zip(looked, changed, strict=True):
            change = (product - base) / LEVEL_STEP
            self.slopes[i][square] += change[1:, 1:]
            self.cross[where, i] += change[1:, 0]
            if scaling and i in _scales(K):
                self.slopes[0][square] -= change[1:, 1:]
                self.cross[where, 0] -= change[1:, 0]

    def adjustment(self, levels: Array, active: Mask) -> LinearAdjustment:
        """The adjustment at log levels (L K,), to first order."""
        return LinearAdjustment(
            levels,
            -0.5 * _log_determinant(self.projected, active),
            -0.5 * np.einsum("ij,kij->k", inverted(self.projected, active), self.slopes),
        )


def _places(rec: Record, point: Point, flight: int, at: slice) -> list[Indices]:
    """For each segment of a flight, the places of its columns among all parameters."""
    K, first = point.gain.size, point.coefficients
    shared = [*range(first), *range(first + flight * K, first + (flight + 1) * K)]
    start = first + point.trim.size + at.start * K
    return [np.array([*shared, *range(start + s * K, start + (s + 1) * K)]) for s in range(rec.starts.size)]


def _parts(rec: Record, places: Sequence[Indices], piece: slice) -> list[tuple[Indices, slice]]:
    """For each segment with blocks in a piece: places of its columns, and its blocks, counted in the piece."""
    begin, end = piece.start, piece.stop
    return [
        (where, slice(max(low - begin, 0), min(high, end) - begin))
        for where, (low, high) in zip(places, rec.block_range, strict=True)
        if max(low, begin) < min(high, end)
    ]


def adjustment(records: Sequence[Record], point: Point, restricted: Restriction) -> float:
    """The adjustment of the restricted likelihood alone, exactly."""
    found = _Slopes.none(point.n, 0)
    for j, (rec, at) in enumerate(_flights(records)):
        places = _places(rec, point, j, at)
        columns = [restricted.sensitivities[j].transpose(0, 2, 1)]
        for piece, rows, _, _ in _filtered(rec, columns, point.levels[None], 1):
            for where, part in _parts(rec, places, piece):
                found.projected[where[:, None], where] += _gram(rows[part])
    return found.adjustment(point.levels.ravel(), restricted.active).value


def _log_determinant(information: Array, active: Mask) -> float:
    """Log determinant of the active block, with the ridge of `inverted`."""
    index = np.flatnonzero(active)
    block = information[index[:, None], index]
    size = np.sqrt(np.maximum(np.diag(block), 1e-12))
    scaled = block / np.outer(size, size) + 1e-10 * np.eye(size.size)
    return float(np.linalg.slogdet(scaled)[1] + 2 * np.log(size).sum())


LEAST_FREEDOM = 3.0
"""Lower limit of the degrees of freedom: below it the approximation has no finite variance and is not valid."""


def degrees_of_freedom(score_: LikelihoodScore, free: Mask, direction: Array) -> float:
    """Degrees of freedom of the variance of a combination of coefficients, at estimated levels.

    Args:
        score_: Score with the derivatives by the levels.
        free: True for the free parameters, shape (n + L K,).
        direction: Direction of the combination, shape (n,).

    Source: F. E. Satterthwaite, Biometrics Bulletin 2 (1946), pp. 110-114, as used for restricted likelihood by
    M. G. Kenward and J. H. Roger, Biometrics 53 (1997), pp. 983-997.
    """
    n = direction.size
    along = inverted(score_.information[:n, :n], free[:n]) @ direction
    slope = -np.einsum("i,kij,j->k", along, score_.slopes, along) / float(direction @ along)
    spread = float(slope @ inverted(score_.information[n:, n:], free[n:]) @ slope)
    return max(2.0 / max(spread, 1e-9), LEAST_FREEDOM)


def level_share(score_: LikelihoodScore, free: Mask, direction: Array) -> float:
    """Relative increase of the variance of a combination of coefficients due to the uncertainty of the levels.

    The estimate depends on the levels by the observed cross derivatives; this is the variance of the estimate under the
    uncertainty of the levels, relative to its variance at known levels.

    Args:
        score_: Score with the derivatives by the levels.
        free: True for the free parameters, shape (n + L K,).
        direction: Direction of the combination, shape (n,).

    Source: M. G. Kenward, J. H. Roger, Biometrics 53 (1997), pp. 983-997: the term Phi (Q - P Phi P) Phi.
    """
    n = direction.size
    along = inverted(score_.information[:n, :n], free[:n]) @ direction
    pull = along @ score_.cross
    return float(pull @ inverted(score_.information[n:, n:], free[n:]) @ pull) / float(direction @ along)


def inverted(information: Array, active: Mask) -> Array:
    """Inverse of the information over the active parameters, zero elsewhere."""
    out = np.zeros_like(information)
    index = np.flatnonzero(active)
    square = index[:, None], index  # numpy.ix_ in a tenth of its time: this runs at every step of every climb
    block = information[square]
    scale = 1 / np.sqrt(np.maximum(block.diagonal(), 1e-12))
    both = scale[:, None] * scale
    inverse = np.linalg.inv(block * both + 1e-10 * np.eye(index.size))
    out[square] = inverse * both
    return out
