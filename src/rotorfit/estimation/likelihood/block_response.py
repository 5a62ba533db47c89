"""The response of the blocks of a record to its commands, with every sensitivity that the likelihood needs.

Every law has the kernel that is made for it; the general one serves the rest. Coefficients enter as (g, log b, tau), so
the damping is positive by construction.
"""

import functools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rotorfit.core.frames import Array, Indices, Mask
from rotorfit.core.laws import (
    ASYMMETRY,
    DAMPING,
    DEAD,
    DELAY,
    FIRST_ORDER_DELAY,
    GAIN,
    LAG,
    LEVEL,
    TRIM,
    ZERO,
    Structure,
)  # fmt: skip
from rotorfit.dynamics.general_response import motion_response
from rotorfit.dynamics.general_step import COLUMNS, MEAN, NOTHING, START, demand_slopes
from rotorfit.dynamics.horizontal_response import horizontal_response
from rotorfit.dynamics.lagged_response import lagged_axis_response
from rotorfit.dynamics.response import axis_response
from rotorfit.estimation.likelihood.blocks import Record
from rotorfit.estimation.likelihood.parameters import Point

TWO_LAGS = (1.2, 0.8)
"""Factors of the two lags on their mean: of equal ones the partial fractions are infinite, and of these the motion is
within 4 % of the square of the lag in the second derivative."""


def response(rec: Record, point: Point, flight: int, start: Array) -> tuple[Array, Array]:
    """Response of the blocks to the commands, and its sensitivities.

    Args:
        rec: The flight.
        point: Coefficients and trims.
        flight: Row of the trims.
        start: Velocity at the start of its segments, world frame where K is 2, shape (S, K) [m/s or rad/s].

    Returns:
        Response in the frame of `Record.position`, shape (B, K) [m or rad; m/s or rad/s for blocks of velocities]; and
        its derivatives d/d(g, log b, tau, further parameters, c, v0) in that order with K columns each, shape
        (B, (5 + E) K, K), where v0 is that of the block's own segment.
    """
    structures = point.structures or (FIRST_ORDER_DELAY,) * len(rec.axes)
    if any(one.twice for one in structures):
        return _twice_lagged_response(rec, point, flight, start)
    laws = point.laws
    laws[:, TRIM] = point.trim[flight]
    command = rec.switches[1]
    if all(_shapes_commands(one) for one in structures):
        if not len(point.extra):
            return _plain_response(rec, laws, start, command)
        return _shaped_response(rec, structures, laws, start, command)
    if all(one.linear and not one.kicks and one.order < 2 for one in structures) and len(laws) == 2:
        return _horizontal_response(rec, laws, start, command, lagged=True)
    if not structures[0].linear or len(laws) == 2:
        return _general_response(rec, point, laws, start)
    return _lagged_response(rec, point, laws, start)


def _twice_lagged_response(rec: Record, point: Point, flight: int, start: Array) -> tuple[Array, Array]:
    """`response` where commands pass a lag twice: two lags a little apart, in partial fractions."""
    once = tuple(replace(one, twice=False) for one in point.structures)
    passed = np.array([[one.twice for one in point.structures]])
    parts = []
    for factor in TWO_LAGS:
        extra = point.extra.copy()
        extra[:1] += np.where(passed, np.log(factor), 0.0)
        parts.append(response(rec, replace(point, structures=once, extra=extra), flight, start))
    shares = np.array(TWO_LAGS) / np.subtract(*TWO_LAGS) * (1.0, -1.0)
    mean, columns = (np.tensordot(shares, np.stack(one), axes=1) for one in zip(*parts, strict=True))
    return mean, columns


def _shapes_commands(structure: Structure) -> bool:
    """Whether the law is of first order, of a command that may be limited, cut or uneven."""
    return not structure.order and {one.place for one in structure.extras} <= {ASYMMETRY, LEVEL, DEAD}


def _shaped_response(
    rec: Record, structures: Sequence[Structure], laws: Array, start: Array, command: Array
) -> tuple[Array, Array]:
    """`response` under laws that shape commands: the derivative by a shape is the response to the demand's derivative.

    The motion is linear in the demand, and g times the shaped command is the demand.
    """
    K = len(laws)
    mean, columns = _plain_response(rec, laws, start, demand_slopes(laws, (GAIN,) * K, command))
    by_shape = []
    for e in range(max(len(one.extras) for one in structures)):
        extras = [one.extras[e] if e < len(one.extras) else None for one in structures]
        slopes = demand_slopes(laws, [extra.place if extra else NOTHING for extra in extras], command)
        for k, extra in enumerate(extras):
            if extra and extra.logarithmic:
                slopes[:, k] *= laws[k, extra.place]
        by_shape.append(_plain_response(rec, laws, start, slopes)[1][:, :K])  # by the gain: to a demand as it is
    return mean, np.concatenate([columns[:, : 3 * K], *by_shape, columns[:, 3 * K :]], axis=1)


def _plain_response(rec: Record, laws: Array, start: Array, command: Array) -> tuple[Array, Array]:
    """`response` under the first-order law with a delay, to commands at the switches of the record, shape (M, K)."""
    if len(laws) == 2:
        return _horizontal_response(rec, laws, start, command, lagged=False)
    return _axis_response(rec, laws[0], start, command)


def _axis_response(rec: Record, law: Array, start: Array, command: Array) -> tuple[Array, Array]:
    """`_plain_response` of one axis."""
    command_time, _, command_range = rec.switches
    out = rec.observed(
        axis_response(
            rec.starts, rec.pose_range, command_range, rec.pose_time, rec.block, command_time, command[:, 0],
            rec.weight, law[GAIN], law[TRIM], law[DAMPING], law[DELAY], start[:, 0],
        )
    )  # fmt: skip
    mean = law[GAIN] * out[:, 0] + law[TRIM] * out[:, 1] + start[rec.segment] * out[:, 4]
    out[:, 2] *= law[DAMPING]
    return mean, out[:, [0, 2, 3, 1, 4]]


def _horizontal_response(rec: Record, laws: Array, start: Array, command: Array, lagged: bool) -> tuple[Array, Array]:
    """`response` of x and y under the first-order law with a delay, or with a lag on the input, too."""
    command_time, _, command_range = rec.switches
    out = rec.observed(
        horizontal_response(
            rec.starts, rec.pose_range, command_range, rec.pose_time, rec.block, command_time, command, rec.weight,
            rec.yaw, laws, start,
        )
    )  # fmt: skip
    out[:, 3:5] *= laws[:, DAMPING, None]
    if not lagged:
        return out[:, 0].copy(), out[:, [*range(1, 7), *range(9, 13)]]  # a view would keep all of it
    out[:, 7:9] *= laws[:, LAG, None]
    return out[:, 0], out[:, 1:]


def _general_response(rec: Record, point: Point, laws: Array, start: Array) -> tuple[Array, Array]:
    """`response` under the general law."""
    what, whose, scale = _columns(point.structures, len(point.extra))
    command_time, command, command_range = rec.switches
    out = rec.observed(
        motion_response(
            rec.starts, rec.pose_range, command_range, rec.pose_time, rec.block, command_time, command, rec.weight,
            rec.yaw, laws, what, whose, start,
        )
    )  # fmt: skip
    values = np.ones(what.size - 1)
    for j in np.flatnonzero(scale):
        values[j - 1] = laws[whose[j], what[j]]
    return out[:, 0], out[:, 1:] * values[:, None]


def _lagged_response(rec: Record, point: Point, law: Array, start: Array) -> tuple[Array, Array]:
    """`response` of one axis under a linear law with a lag."""
    command_time, command, command_range = rec.switches
    out = rec.observed(
        lagged_axis_response(
            rec.starts, rec.pose_range, command_range, rec.pose_time, rec.block, command_time, command[:, 0],
            rec.weight, law, start[:, 0],
        )
    )  # fmt: skip
    extras = [extra.place for extra in point.structures[0].extras]
    columns = [_LAGGED_COLUMNS.index(place) for place in (GAIN, DAMPING, DELAY, *extras, TRIM, START)]
    out[:, [_LAGGED_COLUMNS.index(DAMPING), _LAGGED_COLUMNS.index(LAG)]] *= law[0, [DAMPING, LAG]][:, None]
    return out[:, 0].copy(), out[:, columns]


_LAGGED_COLUMNS = (MEAN, GAIN, DAMPING, DELAY, LAG, ZERO, TRIM, START)
"""The columns of `lagged_axis_response`: the mean, then the parameters of its derivatives."""


@functools.cache
def _columns(structures: tuple[Structure, ...], E: int) -> tuple[Indices, Indices, Mask]:
    """For each column of the general response: parameter, axis, and whether the derivative is by its logarithm."""
    K = len(structures)
    what, whose = [MEAN], [0]
    for place in (GAIN, DAMPING, DELAY):
        what += [place] * K
        whose += range(K)
    scaled = [place == DAMPING for place in what]
    for e in range(E):
        for k, structure in enumerate(structures):
            there = e < len(structure.extras) and structure.extras[e].estimated
            what.append(structure.extras[e].place if there else NOTHING)
            whose.append(k)
            scaled.append(there and structure.extras[e].logarithmic)
    for place in (TRIM, START):
        what += [place] * K
        whose += range(K)
        scaled += [False] * K
    assert len(what) <= COLUMNS  # the kernel has no room for more
    return np.array(what), np.array(whose), np.array(scaled)
