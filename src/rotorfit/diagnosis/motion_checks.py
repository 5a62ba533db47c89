"""Checks of commands and motion together before any fit: wind, commands without effect, velocity proportional to the
command."""

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from rotorfit.core.finding import Finding
from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES, Array, heading_from_world
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
"""Ratio of the velocity change over half a second in that interval to that under changing commands, both beyond that at
rest, above which the vehicle no longer obeys the command."""

LATCH_SETTLING = 2.0
"""Time after which the response to the last change has settled except for its damping [s]. Poses of a GPS filter add
some 0.3 s to the lag of a velocity loop."""

LATCH_STEP = 0.5
"""Time over which the velocity's change is taken [s]."""


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
    time, moved = _velocity_changes(motion)
    still = ends - starts > longest
    zero = np.all(values == 0, axis=1)
    suspects = np.flatnonzero(still & ~zero)
    quiet = _within(time, starts[still], ends[still])
    resting = _within(time, starts[still & zero] + LATCH_SETTLING, ends[still & zero] - LATCH_STEP)
    # Gusts and noise of the pose move a vehicle at rest, too: they do not tell that a command has ended.
    rest = _mean_square(moved[resting])
    usual = _mean_square(moved[~quiet]) - rest
    for i in suspects:
        inside = (time > starts[i] + LATCH_SETTLING) & (time < ends[i] - LATCH_STEP)
        excess = _mean_square(moved[inside]) - rest
        if usual > 0 and excess > LATCH_MOTION**2 * usual:
            ratio = np.sqrt(excess / usual)
            last = ends[i] >= flight.segments[-1].end - 1e-9
            yield Finding(
                "latched_command",
                "warning",
                f"all commands stand still for {ends[i] - starts[i]:.1f} s from {starts[i]:.2f} s on"
                f"{' to the end' if last else ''}, while the velocity changes {ratio:.2g} times as much as under "
                f"changing commands{', both beyond that at rest' if np.any(resting) else ''}",
                "motion that this command did not cause pulls input gain and damping of every commanded axis towards 0",
                f"give the span before it, --span :{starts[i]:.1f}" if last else "leave the stretch out by --span",
            )


def _within(time: Array, starts: Array, ends: Array) -> npt.NDArray[np.bool_]:
    """Whether each time lies in one of the intervals."""
    there: npt.NDArray[np.bool_] = np.any((time > starts[:, None]) & (time < ends[:, None]), axis=0)
    return there


def _mean_square(values: Array) -> float:
    """Mean square, 0 of nothing."""
    return float(np.mean(values**2)) if len(values) else 0.0


def _velocity_changes(motion: Motion) -> tuple[Array, Array]:
    """Start and size of the change of the velocity over half a second, x, y and z combined."""
    after = np.searchsorted(motion.time, motion.time + LATCH_STEP)
    there = after < len(motion.time)
    there[there] &= motion.time[after[there]] - motion.time[there] < 0.7
    yaw, velocity = motion.yaw, motion.velocity[:, :3].copy()
    velocity[:, :2] = heading_from_world(velocity[:, :2], -yaw)
    change = velocity[after[there]] - velocity[there]
    return motion.time[there], np.linalg.norm(change, axis=1)
