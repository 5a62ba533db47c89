"""Checks of commands and motion together before any fit: wind, commands without effect, velocity proportional to the
command."""

from collections.abc import Iterator

import numpy as np

from rotorfit.core.finding import Finding
from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES, Array, Mask, heading_from_world
from rotorfit.core.results import Motion
from rotorfit.diagnosis.recording import Recording

GRID = 0.05
"""Step of the grid on which command and acceleration are compared [s]."""

WINDOW = 10.0
"""Length of the windows of the spectra [s]: the paper's slower sine has a period of 6.3 s."""

LEAST_WINDOWS = 3
"""Least number of half-overlapping windows for a coherence: with few, noise alone is coherent."""

EXCITED_SHARE = 0.9
"""The excited frequencies are the strongest ones that together hold this share of the command's power."""

EXPLAINED = 0.4
"""Explained share of the acceleration's variance there below which something else dominates. Clean simulated flights
stay above 0.8; commands without effect give 0.1 to 0.35 with 3 to 10 windows."""

FOLLOWS = 0.995
"""Correlation of command and later velocity above which they are one regressor, so that input gain and damping are
known only by their ratio. Simulated flights of the fastest published servo (b = 4.7 1/s) under steps stay below 0.97,
the paper's slow sines on yaw give 0.993, real ones without an identifiable damping 0.997 to 0.999."""

LAGS = np.arange(0.0, 0.401, 0.04)
"""Delays that are tried [s]."""

LATCH_TIME = 5.0
"""Shortest interval of a constant command that may be latched [s]: pilots hold a stick for 3 s, and what is left after
settling is too short to tell gusts from motion."""

LATCH_CHANGES = 20.0
"""Least length of such an interval, in median times between changes."""

LATCH_MOTION = 0.7
"""Ratio of the unexplained change of the velocity in that interval, beyond that elsewhere, to what changing commands
explain, above which the vehicle no longer obeys the command."""

LATCH_UNEXPLAINED = 2.0
"""Least ratio of the mean squares of what is unexplained there and elsewhere. Sticks held for 5 s and more in gusts
give up to 1.4 in simulated flights outdoors; commands that were latched, 2.2 and more in 153 of 161."""

LATCH_SETTLING = 1.0
"""Time after which the response to the last change has settled except for its damping [s]."""

LATCH_STEP = 0.5
"""Time over which the velocity's change is taken [s]."""

LATCH_LAGS = np.arange(0.0, 1.21, 0.2)
"""Ages of the commands that may explain such a change [s]: an outdoor velocity loop with a GPS pose trails by 1 s."""

LATCH_ROWS = 10
"""Least number of changes for each coefficient that explains them."""


def motion_findings(recording: Recording) -> Iterator[Finding]:
    """Findings on commands and motion of one flight."""
    flight, motion = recording.flight, recording.motion
    along = motion.acceleration.copy()
    along[:, :2] = heading_from_world(along[:, :2], motion.yaw)
    for axis in flight.axes:
        k = AXES.index(axis)
        if np.ptp(flight.command[:, k]) > 0 and len(motion.time) > LEAST_WINDOWS:
            yield from _wind(axis, flight, motion.time, along[:, k], k)
            yield from _follows(axis, flight, motion, k)
    yield from _latched(flight, motion)


def lagged_command(flight: Flight, time: Array, lag: float) -> Array:
    """The command sent `lag` before each time, shape (N, 4); before the first command, the first one.

    Args:
        flight: The flight that provides the commands.
        time: Shape (N,) [s].
        lag: Lag [s].
    """
    index = np.searchsorted(flight.command_time, time - lag, side="right") - 1
    return np.asarray(flight.command[np.maximum(index, 0)])


def explained_share(flight: Flight, time: Array, acceleration: Array, k: int) -> float | None:
    """Share of the variance of an acceleration explained by a command, at the frequencies that the command excites.

    It is their coherence, which no delay, damping or gain changes, weighted by the spectrum of the acceleration.

    Args:
        flight: The flight that provides commands and segments.
        time: Stamps of the acceleration, shape (N,) [s].
        acceleration: Along the axis, shape (N,).
        k: Index of the axis.

    Returns:
        0 to 1; None where there are too few windows or no acceleration.

    Source: J. S. Bendat, A. G. Piersol, Random Data, 4th ed. (2010), section 6.1.
    """
    n = round(WINDOW / GRID)
    taper = np.hanning(n + 1)[:n]
    spectra = []
    for part in flight.segments:
        inside = time[(time >= part.start) & (time <= part.end)]
        if not inside.size:
            continue
        grid = np.arange(inside[0], inside[-1], GRID)
        a = np.interp(grid, time, acceleration)
        u = lagged_command(flight, grid, 0.0)[:, k]
        for first in range(0, len(grid) - n + 1, n // 2):
            rows = slice(first, first + n)
            spectra.append([np.fft.rfft(taper * (s[rows] - s[rows].mean())) for s in (u, a)])
    if len(spectra) < LEAST_WINDOWS:
        return None
    U, A = np.array(spectra).transpose(1, 0, 2)
    uu, aa = np.sum(np.abs(U) ** 2, axis=0), np.sum(np.abs(A) ** 2, axis=0)
    order = np.argsort(-uu)
    excited = order[: 1 + np.searchsorted(np.cumsum(uu[order]), EXCITED_SHARE * np.sum(uu))]
    told = np.abs(np.sum(A * U.conj(), axis=0))[excited] ** 2 / np.maximum(uu[excited], 1e-300)
    return float(np.sum(told) / np.sum(aa[excited])) if np.sum(aa[excited]) > 0 else None


def _wind(axis: str, flight: Flight, time: Array, acceleration: Array, k: int) -> Iterator[Finding]:
    share = explained_share(flight, time, acceleration, k)
    if share is not None and share < EXPLAINED:
        yield Finding(
            "wind_dominates",
            "warning",
            f"the command explains {100 * share:.0f} % of the acceleration of {axis} at the frequencies it excites",
            f"the rest is wind, wobble or pose noise: the coefficients of {axis} come out wide, if at all",
            f"fly larger commands on {axis}, or in still air; if the air was still, check the card's column for {axis}",
            axis,
        )


def _follows(axis: str, flight: Flight, motion: Motion, k: int) -> Iterator[Finding]:
    v = motion.velocity[:, k]
    correlations = []
    for lag in LAGS:
        u = lagged_command(flight, motion.time, float(lag))[:, k]
        correlations.append(abs(float(np.corrcoef(u, v)[0, 1])) if np.ptp(u) > 0 and np.ptp(v) > 0 else 0.0)
    best = int(np.argmax(correlations))
    if correlations[best] > FOLLOWS:
        yield Finding(
            "velocity_follows_command",
            "warning",
            f"the velocity of {axis} is proportional to its command {1e3 * LAGS[best]:.0f} ms before: correlation "
            f"{correlations[best]:.4f}",
            f"input gain and damping of {axis} are known by their ratio, the steady gain, not by themselves",
            f"command {axis} with steps, or with sines fast enough that the vehicle cannot follow",
            axis,
        )


def _latched(flight: Flight, motion: Motion) -> Iterator[Finding]:
    """Intervals in which all commands are constant while the vehicle moves as it did under changing ones."""
    changes = np.flatnonzero(np.any(np.diff(flight.command, axis=0) != 0, axis=1)) + 1
    if len(changes) < 10 or not len(motion.time):
        return
    starts = flight.command_time[np.concatenate([[0], changes])]
    ends = np.append(starts[1:], flight.segments[-1].end)
    values = flight.command[np.concatenate([[0], changes])]
    longest = max(LATCH_TIME, LATCH_CHANGES * float(np.median(np.diff(starts))))
    still = ends - starts > longest
    suspects = np.flatnonzero(still & np.any(values != 0, axis=1))
    time, velocity, change = _velocity_changes(motion)
    elsewhere = ~_within(time, starts[suspects], ends[suspects])
    if not suspects.size or np.sum(elsewhere) < LATCH_ROWS * (len(LATCH_LAGS) + 2):
        return
    moved = np.sum(change**2, axis=1)
    left = np.sum(_unexplained(flight, time, velocity, change, elsewhere) ** 2, axis=1)
    # Gusts and noise of the pose change the velocity everywhere: they do not tell that a command has ended.
    usual = np.mean(left[elsewhere])
    changing = ~_within(time, starts[still], ends[still])
    commanded = np.mean(moved[changing] - left[changing]) if np.any(changing) else 0.0
    for i in suspects:
        inside = (time > starts[i] + LATCH_SETTLING) & (time < ends[i] - LATCH_STEP)
        there = np.mean(left[inside]) if np.any(inside) else 0.0
        if there > LATCH_UNEXPLAINED * usual and there - usual > LATCH_MOTION**2 * commanded > 0:
            last = ends[i] >= flight.segments[-1].end - 1e-9
            yield Finding(
                "latched_command",
                "warning",
                f"all commands stand still for {ends[i] - starts[i]:.1f} s from {starts[i]:.2f} s on"
                f"{' to the end' if last else ''}, while the velocity changes otherwise than they ask for, "
                f"{np.sqrt((there - usual) / commanded):.2g} times as much as changing commands change it",
                "motion that this command did not cause pulls input gain and damping of every commanded axis towards 0",
                f"give the span before it, --span :{starts[i]:.1f}" if last else "leave the stretch out by --span",
            )


def _within(time: Array, starts: Array, ends: Array) -> Mask:
    """Whether each time lies in one of the intervals."""
    return np.asarray(np.any((time > starts[:, None]) & (time < ends[:, None]), axis=0))


def _unexplained(flight: Flight, time: Array, velocity: Array, change: Array, known: Mask) -> Array:
    """What velocity and recent commands leave of a change of the velocity, by a regression on the known ones alone."""
    commands = np.stack([lagged_command(flight, time, lag) for lag in LATCH_LAGS], axis=1)
    left = np.empty_like(change)
    for k in range(change.shape[1]):
        regressors = np.column_stack([np.ones(len(time)), velocity[:, k], commands[:, :, k]])
        coefficients, *_ = np.linalg.lstsq(regressors[known], change[known, k], rcond=None)
        left[:, k] = change[:, k] - regressors @ coefficients
    return left


def _velocity_changes(motion: Motion) -> tuple[Array, Array, Array]:
    """Start of the changes of the velocity over half a second, the velocity there, and the changes; x, y and z."""
    after = np.searchsorted(motion.time, motion.time + LATCH_STEP)
    there = after < len(motion.time)
    there[there] &= motion.time[after[there]] - motion.time[there] < 0.7
    world = motion.velocity[:, :3].copy()
    world[:, :2] = heading_from_world(world[:, :2], -motion.yaw)
    change = world[after[there]] - world[there]
    change[:, :2] = heading_from_world(change[:, :2], motion.yaw[there])
    return motion.time[there], motion.velocity[there, :3], change
