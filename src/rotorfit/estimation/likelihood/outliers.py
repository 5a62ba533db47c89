"""Detection and removal of outlier poses, such as those from marker swaps and reflections.

The pose noise is assumed to have the tails of Student's t. A filter with the fitted levels runs over every pose, not
over blocks: a pose that is z standard deviations from its prediction enters with the weight (nu + 1) / (nu + z^2), so a
distant one hardly changes the state. The filter runs forwards and, since the disturbance is reversible in time,
backwards. A pose is an outlier if it is far off in both directions: a single filter that has just lost the vehicle, or
not yet found it, is not enough evidence. Outliers are removed, the likelihood of the rest is maximised, and both steps
are repeated until the outliers no longer change. Whole poses are removed, since a swapped marker affects all axes; the
other poses of the block are kept.

The rest is fitted by the plain likelihood, so that a clean flight gives the same result as `ml`, and intervals keep
their meaning. The likelihoods of `ml` and `robust` are of different data and are never compared.

Source: K. L. Lange, R. J. A. Little, J. M. G. Taylor, J. Amer. Statist. Assoc. 84 (1989), pp. 881-896 (the weights);
G. Agamennoni, J. I. Nieto, E. M. Nebot, IEEE Trans. Signal Processing 60 (2012), pp. 5024-5037 (in a Kalman filter).
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from rotorfit.core.compiled import kernel
from rotorfit.core.finding import Finding
from rotorfit.core.flight_data import Flight, Note
from rotorfit.core.frames import AXES, Array
from rotorfit.core.results import Outlier, Outliers
from rotorfit.dynamics.disturbance import axis_start, distinct_steps, step_tables
from rotorfit.estimation.likelihood.axis_estimate import Estimate
from rotorfit.estimation.likelihood.block_response import response
from rotorfit.estimation.likelihood.blocks import Record, record
from rotorfit.estimation.likelihood.likelihood import segments

FREEDOM = 4.0
"""nu of Student's t: tails heavy enough that a swapped marker has almost no weight."""

OUTLIER = 5.0
"""Standard deviations beyond which, in both directions, a pose is an outlier: in a clean flight none in a million."""

JUMP = 8.0
"""Robust standard deviations beyond which a step between poses is a jump."""

JUMP_POSES = 11
"""Number of steps in the running median that is subtracted from the steps."""

ALIKE = 0.3
"""Largest remaining offset, relative to the first jump, at which later jumps count as a return."""

GRAIN = 0.2
"""Share of suspects above which they are attributed to the resolution of the pose, not to bursts."""

LONGEST_BURST = 1.0
"""Longest time between a jump and the jump back [s]."""

MOST_JUMPS = 4
"""Largest number of jumps of a burst: a sum of many returns by chance."""

MOST_OF_BURST = 0.5
"""Share of suspicious poses in a burst above which all of its poses are outliers."""

ODD = 3.0
"""Standard deviations beyond which a pose of a burst is suspicious."""

MOST_ROUNDS = 8
"""Largest number of iterations of removal and maximisation."""

LISTED = 10
"""Number of outliers that a note lists, the largest first."""

SETTLING = 0.25
"""Time after the start of a filter in which its residuals are ignored [s]: it starts from the first pose."""

MANY = 0.05
"""Share of outliers above which the finding is a warning about the motion capture."""

Estimator = Callable[[Sequence[Flight]], Mapping[str, Estimate]]


@kernel()
def student_filter(steps: Array, step: Any, fresh: Any, residual: Array, levels: Array, freedom: float) -> Any:
    """Runs one axis of the disturbance filter over every pose with heavy-tailed pose noise.

    Args:
        steps: Distinct steps between poses, shape (U,) [s].
        step: Index of the step that leads to each pose, shape (N,).
        fresh: True where a segment starts, shape (N,).
        residual: Pose less the response to the commands, shape (N,) [m or rad].
        levels: q, r, alpha, kappa, not as logarithms, shape (4,).
        freedom: nu of Student's t.

    Returns:
        Difference of each pose from its prediction, shape (N,) [m or rad], and in standard deviations, shape (N,).
    """
    N = residual.size
    off, z = np.empty(N), np.empty(N)
    F, Q = step_tables(steps, levels[2], levels[3])
    state, P = np.zeros(3), np.zeros((3, 3))
    for i in range(N):
        if fresh[i]:
            state[:] = 0.0
            axis_start(P, levels)
        else:
            P = F[step[i]] @ P @ F[step[i]].T + levels[0] * Q[step[i]]
            state = F[step[i]] @ state
        off[i] = residual[i] - state[0]
        z[i] = off[i] / np.sqrt(P[0, 0] + levels[1])
        weight = (freedom + 1.0) / (freedom + z[i] * z[i])
        S = P[0, 0] + levels[1] / weight
        gain = P[:, 0] / S
        state = state + gain * off[i]
        P = P - np.outer(gain, gain) * S
    return off, z


def without_outliers(flights: Sequence[Flight], estimator: Estimator) -> tuple[tuple[Flight, ...], Outliers]:
    """Removes the outliers of flights.

    Args:
        flights: The flights as read.
        estimator: Maximises the likelihood of flights; returns axis name to estimate.

    Returns:
        The flights without their outliers, with a note where there were any; and the outliers of each flight.
    """
    bursts = [jumped(flight) for flight in flights]
    found: Outliers = tuple(tuple(one for burst in some for one in burst) for some in bursts)
    for _ in range(MOST_ROUNDS):
        estimates = estimator([_kept(flight, one) for flight, one in zip(flights, found, strict=True)])
        before = found
        rounds = zip(flights, before, bursts, strict=True)
        found = tuple(_outliers(f, _kept(f, one), estimates, some) for f, one, some in rounds)
        if [[o.time for o in one] for one in before] == [[o.time for o in one] for one in found]:
            break
    pairs = zip(flights, found, strict=True)
    return tuple(replace(_kept(f, one), notes=(*f.notes, *_notes(f, one))) for f, one in pairs), found


def jumped(flight: Flight) -> tuple[tuple[Outlier, ...], ...]:
    """Bursts of poses between a jump and a jump back, which are removed before the first fit.

    A burst that is fitted as motion increases the disturbance levels so much that the filter would accept it.
    """
    from scipy.ndimage import median_filter

    bursts = []
    for name, pose in zip(AXES, np.column_stack([flight.position, flight.yaw]).T, strict=True):
        step = np.diff(pose)
        step = step - median_filter(step, JUMP_POSES)
        jumps = np.flatnonzero(np.abs(step) > JUMP * 1.4826 * np.median(np.abs(step)))
        last = -1  # the jump that ended a burst begins none
        for i in jumps[step[jumps] != 0]:
            some = jumps[(jumps >= i) & (flight.pose_time[jumps] < flight.pose_time[i] + LONGEST_BURST)][:MOST_JUMPS]
            gone = np.cumsum(step[some])
            back = some[np.abs(gone) < ALIKE * abs(step[i])]
            if i <= last or not back.size:
                continue
            last = int(back[0])
            times, size = flight.pose_time[i + 1 : last + 1], float(np.abs(gone[some < last]).max())
            bursts.append(tuple(Outlier(float(time), name, size) for time in times))
    suspects = {one.time for burst in bursts for one in burst}
    return () if len(suspects) > GRAIN * flight.pose_time.size else tuple(bursts)


def _kept(flight: Flight, outliers: Sequence[Outlier]) -> Flight:
    """The flight without these poses."""
    keep = ~np.isin(flight.pose_time, [one.time for one in outliers])
    return replace(flight, pose_time=flight.pose_time[keep], position=flight.position[keep], yaw=flight.yaw[keep])


def _outliers(
    flight: Flight, fitted: Flight, estimates: Mapping[str, Estimate], bursts: Sequence[Sequence[Outlier]]
) -> tuple[Outlier, ...]:
    """Outliers of a flight on any axis that was estimated from it, in order of time.

    A burst counts as a whole if more than half of it is suspicious: in its middle the filter's variance is too large.
    """
    worst: dict[float, tuple[float, Outlier]] = {}
    for name, estimate in estimates.items():
        number = next((j for j, rec in enumerate(estimate.records) if rec.command_time is flight.command_time), None)
        if number is None:
            continue
        time, off, z = judged(flight, fitted, name, estimate, number)
        for i in np.flatnonzero(z > ODD):
            one = Outlier(float(time[i]), name, float(abs(off[i])))
            worst[one.time] = max(worst.get(one.time, (0.0, one)), (float(z[i]), one), key=lambda pair: pair[0])
    out = {time: one for time, (z, one) in worst.items() if z > OUTLIER}
    for burst in bursts:
        if sum(one.time in worst for one in burst) > MOST_OF_BURST * len(burst):
            out = {one.time: one for one in burst} | out
    return tuple(out[time] for time in sorted(out))


def judged(flight: Flight, fitted: Flight, name: str, estimate: Estimate, number: int) -> tuple[Array, Array, Array]:
    """Residual of each pose of a flight under the forward and the backward filter, whichever is smaller.

    Args:
        flight: The flight with all its poses.
        fitted: The flight with only the poses that were fitted.
        name: Name of the axis.
        estimate: Estimate of that axis.
        number: Index of the flight in the estimate.

    Returns:
        Time [s], residual [m or rad] and absolute residual in standard deviations, each of shape (N,), over the poses
        that enter the likelihood.
    """
    K, k = estimate.optimum.point.gain.size, estimate.place
    axes = (name,) if K == 1 else estimate.records[number].axes
    every = record(flight, axes, np.inf)
    if every is None:
        return np.empty(0), np.empty(0), np.empty(0)
    residual = (every.position - _expected(every, fitted, estimate, number))[:, k]
    levels = np.exp(estimate.optimum.point.levels)
    # for a vehicle that turns the axes are world axes: use the larger levels of the two
    own = levels[k] if K == 1 else np.append(levels[:, :2].max(axis=0), levels[levels[:, 0].argmax(), 2:])
    off, z = student_filter(every.steps, every.step, every.fresh, residual, own, FREEDOM)
    steps, step = distinct_steps(-every.pose_time[::-1])
    last = np.roll(every.fresh, -1)[::-1].copy()
    off_back, z_back = student_filter(steps, step, last, residual[::-1].copy(), own, FREEDOM)
    z, z_back = np.abs(z), np.abs(z_back[::-1])
    parts = [every.pose_time[i:j] for i, j in every.pose_range]
    z[np.concatenate([time < time[0] + SETTLING for time in parts])] = np.inf
    z_back[np.concatenate([time > time[-1] - SETTLING for time in parts])] = np.inf
    off = np.where(z <= z_back, off, off_back[::-1])
    return every.pose_time, off, np.minimum(z, z_back)


def _expected(every: Record, fitted: Flight, estimate: Estimate, number: int) -> Array:
    """Response to the commands at every pose in the frame of the estimate's record, shape (N, K) [m or rad]."""
    point, own = estimate.optimum.point, estimate.records[number]
    began = dict(zip(own.starts, point.start[segments(estimate.records)[number]], strict=True))
    start = np.array([began.get(time, np.zeros(len(every.axes))) for time in every.starts])
    mean: Array = response(every, point, number, start)[0]
    plain = record(fitted, every.axes)
    if plain is None:
        return mean
    # the coupling through the small turns of a held heading was subtracted from the estimate's record
    turns = plain.position - own.position
    mean += np.column_stack([np.interp(every.pose_time, plain.block_time, turn) for turn in turns.T])
    return mean


def _notes(flight: Flight, outliers: Sequence[Outlier]) -> tuple[Note, ...]:
    if not outliers:
        return ()
    largest = sorted(outliers, key=lambda one: -one.size)[:LISTED]
    listed = ", ".join(f"{one.size:.3g} in {one.axis} at {one.time:.2f} s" for one in largest)
    text = f"{len(outliers)} of {flight.pose_time.size} poses are outliers (m, rad: {listed}): left out"
    return (Note("outlier_poses", text, len(outliers)),)


def outlier_findings(flights: Sequence[Flight], outliers: Outliers) -> Iterator[Finding]:
    """Findings on the removed poses, one per flight with outliers; `flights` are those without their outliers."""
    if outliers and not any(outliers):
        yield Finding(
            "outliers",
            "info",
            f"0 of {sum(flight.pose_time.size for flight in flights)} poses are outliers",
            "none was left out: the numbers are those of --method ml",
            "nothing",
        )
    for flight, found in zip(flights, outliers, strict=bool(outliers)):
        if not found:
            continue
        share = len(found) / (len(found) + flight.pose_time.size)
        largest = max(found, key=lambda one: one.size)
        yield Finding(
            "outliers",
            "warning" if share > MANY else "info",
            f"{flight.path}: {len(found)} poses ({100 * share:.2g} %) are outliers, the largest by "
            f"{largest.size:.3g} {'rad' if largest.axis == 'yaw' else 'm'} in {largest.axis} at {largest.time:.2f} s",
            "they were left out; kept, they would be fitted as motion and make every interval wide or wrong",
            "look for swapped or reflecting markers in the motion capture at these times",
        )
