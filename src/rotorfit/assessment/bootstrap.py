"""Block bootstrap: flights drawn from the fitted model and its own innovations, and estimated again.

The fitted response to the commands is kept. The standardised innovations are resampled in blocks, with replacement,
and the inverse of the whitening filter colours them. The result is another flight of the same vehicle under the same
commands; the scatter of the estimates over many such flights is a standard error that assumes nothing about the
innovations except that blocks of them are exchangeable.

The commands stay as recorded. In a feedback loop they would have responded to the new disturbance: there the bootstrap
shows how the estimate scatters under these commands, not under those that the loop would have sent.

Source: H. R. Kuensch, Annals of Statistics 17 (1989), pp. 1217-1241 (blocks); D. S. Stoffer, K. D. Wall, J. Amer.
Statist. Assoc. 86 (1991), pp. 1024-1033 (innovations of a state-space model).
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from rotorfit.core.compiled import kernel
from rotorfit.core.frames import Array, Indices, Mask, world_from_heading
from rotorfit.dynamics.disturbance import (
    axis_start,
    fill_step_tables,
    predict_covariance,
    propagate,
    rotate,
    start_covariance,
    step_tables,
    update_covariance,
)
from rotorfit.estimation.likelihood.block_response import response
from rotorfit.estimation.likelihood.blocks import BLOCK_RATE, Record
from rotorfit.estimation.likelihood.fisher_scoring import Optimum, maximise
from rotorfit.estimation.likelihood.likelihood import fused, segments
from rotorfit.estimation.likelihood.prior import redrawn

COUNT = 200
"""Number of flights drawn: a standard error is then known to 5 %."""

SEED = 0
"""Seed of the draws."""

BLOCK_TIME = 2.0
"""Length of the blocks of innovations [s]: longer than the correlation left by an oscillation or the vehicle."""

NOT_WALKED = 0.02
"""Expected gain in log-likelihood below which the search ends: a fifth of a standard error."""

MOST = 12
"""Maximum number of iterations of a search."""


@kernel(fastmath={"contract"})
def colour_axis(steps: Array, step: Any, count: Array, fresh: Any, innovations: Array, levels: Array) -> Array:
    """Inverse of `whitening.axis_pieces`: positions (B, R) whose standardised innovations are the given ones (B, R)."""
    B, R = innovations.shape
    out = np.empty((B, R))
    F, Q = step_tables(steps, levels[2], levels[3])
    state = np.zeros((R, 3))
    P = np.zeros((3, 3))
    for i in range(B):
        if fresh[i]:
            state[:] = 0.0
            axis_start(P, levels)
        else:
            P = F[step[i]] @ P @ F[step[i]].T + levels[0] * Q[step[i]]
            state = state @ F[step[i]].T
        S = P[0, 0] + levels[1] / count[i]
        gain, root = P[:, 0] / S, np.sqrt(S)
        for j in range(R):
            e = innovations[i, j] * root
            out[i, j] = state[j, 0] + e
            for k in range(3):
                state[j, k] += gain[k] * e
        P = P - np.outer(gain, gain) * S
    return out


@kernel(fastmath={"contract"})
def colour_plane(
    steps: Array, step: Any, count: Array, fresh: Any, yaw: Array, innovations: Array, levels: Array
) -> Array:
    """Inverse of `whitening.plane_pieces`: positions (B, R, 2), heading frame, from innovations (B, R, 2)."""
    B, R, _ = innovations.shape
    out = np.empty((B, R, 2))
    F, Q = np.zeros((1, 2, steps.size, 3, 3)), np.zeros((1, 2, steps.size, 3, 3))
    for a in range(2):
        fill_step_tables(steps, levels[a, 2], levels[a, 3], F[0, a], Q[0, a])
    P = np.zeros((1, 3, 3, 3))
    state = np.zeros((R, 6))
    gain = np.empty((2, 6))
    root = np.empty(2)
    for i in range(B):
        if fresh[i]:
            state[:] = 0.0
            start_covariance(P[0], levels)
        else:
            fx, fy = F[0, 0, step[i]], F[0, 1, step[i]]
            half = 0.5 * (yaw[i] - yaw[i - 1])
            c, s = np.cos(half), np.sin(half)
            predict_covariance(P, 0, F, Q, 0, step[i], levels[0, 0], levels[1, 0], c, s)
            for j in range(R):
                rotate(state[j], c, s)
                propagate(state[j], fx, fy)
                rotate(state[j], c, s)
        for a in range(2):
            root[a] = np.sqrt(update_covariance(P, 0, a, levels[a, 1] / count[i], gain[a]))
        for j in range(R):
            for a in range(2):
                e = innovations[i, j, a] * root[a]
                out[i, j, a] = state[j, 3 * a] + e
                for k in range(6):
                    state[j, k] += gain[a, k] * e
    return out


def coloured(rec: Record, innovations: Array, levels: Array) -> Array:
    """Motion that the commands do not explain, from its standardised innovations.

    Args:
        rec: The flight: its stamps, counts and heading.
        innovations: Heading frame, shape (B, R, K).
        levels: log of q, r, alpha, kappa, shape (K, 4).

    Returns:
        World positions relative to the first of each segment, as in a record, shape (B, R, K).
    """
    common, values = (rec.steps, rec.step, rec.count, rec.fresh), np.exp(levels)
    if rec.rate is not None:
        return fused(rec, innovations, values, coloured=True)[0]
    if len(rec.axes) == 1:
        out = colour_axis(*common, np.ascontiguousarray(innovations[:, :, 0]), values[0])[:, :, None]
    else:
        heading = colour_plane(*common, rec.block_yaw, np.ascontiguousarray(innovations), values)
        yaw = np.repeat(rec.block_yaw, heading.shape[1])
        out = world_from_heading(heading.reshape(-1, 2), yaw).reshape(heading.shape)
    return np.ascontiguousarray(out)


def resampled_blocks(fresh: Mask, length: int, count: int, rng: np.random.Generator) -> Indices:
    """Index of the innovation at each place of each drawn flight, shape (B, R): runs of `length`, wrapping at the end.

    The first block of each segment keeps its place: it only sets where the flight began.
    """
    B = fresh.size
    runs = -(-B // length)
    first = rng.integers(0, B, (runs, count))
    index = ((first[:, None, :] + np.arange(length)[None, :, None]).reshape(-1, count)[:B]) % B
    index = np.where(fresh[index], (index + 1) % B, index)
    index[fresh] = np.flatnonzero(fresh)[:, None]
    return index


def bootstrap(records: Sequence[Record], optimum: Optimum, count: int = COUNT, seed: int = SEED) -> Array:
    """Estimates from resampled flights.

    Args:
        records: The flights.
        optimum: The maximum of their likelihood; all free parameters are estimated again, starting there.
        count: Number of flights to draw.
        seed: Seed of the draws.

    Returns:
        Parameters in the order of `Point.flat`, shape (count, n + 4 K).
    """
    rng = np.random.default_rng(seed)
    point, drawings = optimum.point, []
    for j, (rec, at) in enumerate(zip(records, segments(records), strict=True)):
        mean = response(rec, point, j, point.start[at])[0]
        own = optimum.score.innovations[j]
        inside = own[~rec.fresh]
        # centred, and with the variance that the levels imply: fitting the coefficients has absorbed a part of it
        own = np.where(rec.fresh[:, None], own, (own - inside.mean(axis=0)) / inside.std(axis=0))
        index = resampled_blocks(rec.fresh, max(1, round(BLOCK_TIME * BLOCK_RATE)), count, rng)
        drawings.append(mean[:, None, :] + coloured(rec, own[index], point.levels))
    out = np.empty((count, point.flat().size))
    for r in range(count):
        flights = [
            replace(rec, position=np.ascontiguousarray(drawing[:, r]))
            for rec, drawing in zip(records, drawings, strict=True)
        ]
        prior = optimum.prior and redrawn(optimum.prior, rng)
        again = maximise(flights, point, optimum.free, optimum.inverse, optimum.restricted, NOT_WALKED, MOST, prior)
        out[r] = again.point.flat()
    return out
