"""Checks of the commands of a flight alone: saturation, slowness, collinearity, implausible units, smoothing."""

from collections.abc import Iterator, Mapping
from itertools import combinations

import numpy as np

from rotorfit.core.card import Card
from rotorfit.core.finding import Finding
from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES, Array
from rotorfit.diagnosis.recording import Recording

SATURATED_SHARE = 0.1
"""Share of the commands at the largest value above which they count as saturated."""

SATURATED_LEVELS = 5
"""Commands with at most this many distinct values are steps, whose largest value is not a limit."""

SATURATED_EXCESS = 3.0
"""Least ratio of how often a limit is held to how often any smaller value but zero is: steps hold each size alike."""

SLOW_FREQUENCY = 0.1
"""Frequency [Hz] above which some power must lie. The paper's sines are at 0.16 and 0.21 Hz, and with them the delay
has a standard error of 0.01 to 0.07 s; at half their frequency it is not identifiable on simulated flights."""

SLOW_SHARE = 0.05
"""Share of power below which commands count as slow."""

ALIKE = 0.95
"""Correlation above which two commands count as one: at 0.95 the standard errors of two regressors are 3.2 times those
of independent ones. Independent steps over 40 s stay below 0.5 on simulated flights."""

FRACTION_LIMIT = 3.0
"""Largest plausible command that is a fraction of a limit. Controllers without limits overshoot 1, up to 2.3 on
simulated flights; per cent and degrees exceed 5."""

MEANING_LIMITS: Mapping[str, tuple[float, str]] = {
    "tilt": (1.4, "rad"),
    "velocity": (40.0, "m/s"),
    "vertical_speed": (20.0, "m/s"),
    "yaw_rate": (20.0, "rad/s"),
}
"""Largest plausible command for each meaning in SI: 80 degrees of tilt, a racer's speed, 3 turns per second."""


BLANKS = 50
"""Least number of single commands between zeros for the zeros to be filled blanks: nobody flies so many such pulses."""

BLANK_SHARE = 0.8
"""Least share of those among all commands that are not zero: two of them may follow each other."""

BLANK_TIME = 0.5
"""Longest median time between such commands [s]; a pilot's pulses of one sample are rarer."""

TOGETHER, CLOCKED = 20, 0.5
"""Number of such commands whose common time is compared, and least share of such times that are the median to 1.5
samples: a program sends by a clock, a pilot's taps wander."""

EVEN, MOST = 0.2, 0.8
"""How far the times between samples may be from their median, and share of them, in a log that is no log of changes."""

REPEATED = 0.1
"""Share of the zeros that follow a zero from which on it is no log of changes."""


def command_findings(recording: Recording) -> Iterator[Finding]:
    """Findings on the commands of one flight."""
    card, flight = recording.card, recording.flight
    for axis in flight.axes:
        command = flight.command[:, AXES.index(axis)]
        if np.any(command):
            yield from _saturated(axis, command)
            yield from _slow(axis, flight.command_time, command)
            yield from _units(axis, card, command)
    yield from _zeros_between(flight)
    yield from _alike(flight)
    yield from _low_passed(flight)


def spectrum(time: Array, values: Array) -> tuple[Array, Array]:
    """Power spectrum of held values about their mean.

    Args:
        time: Stamps, at least 2, shape (N,) [s].
        values: Shape (N,), each held until the next.

    Returns:
        Frequencies [Hz] and the power at each, both of shape (F,).
    """
    period = float(np.median(np.diff(time)))
    grid = np.arange(time[0], time[-1], period)
    held = values[np.searchsorted(time, grid + 1e-9, side="right") - 1]
    power: Array = np.abs(np.fft.rfft(held - np.mean(held))) ** 2
    return np.asarray(np.fft.rfftfreq(len(grid), period), np.float64), power


def share_above(time: Array, values: Array, frequency: float) -> float:
    """Share of the power of held values above a frequency [Hz]; 0 for constant ones and for fewer than 8."""
    if len(time) < 8:
        return 0.0
    at, power = spectrum(time, values)
    total = float(np.sum(power))
    return float(np.sum(power[at > frequency])) / total if total > 0 else 0.0


def saturated_share(command: Array) -> float:
    """Share of samples at the largest magnitude, if that is a limit; 0 for steps."""
    size = np.abs(command)
    top = size >= size.max() * (1 - 1e-9)
    below = np.unique(command[~top & (size > 0)], return_counts=True)[1]
    steps = np.unique(command).size <= SATURATED_LEVELS or top.sum() < SATURATED_EXCESS * below.max(initial=0)
    return 0.0 if steps else float(top.mean())


def _saturated(axis: str, command: Array) -> Iterator[Finding]:
    share = saturated_share(command)
    if share > SATURATED_SHARE:
        yield Finding(
            "saturated_commands",
            "info",
            f"the {axis} command stands at its largest value, {np.abs(command).max():.3g}, in {100 * share:.0f} % of "
            "the samples",
            f"none on {axis} if the vehicle received what was logged; else its input gain comes out too small",
            "log the command as sent, after its limits",
            axis,
        )


def _slow(axis: str, time: Array, command: Array) -> Iterator[Finding]:
    share = share_above(time, command, SLOW_FREQUENCY)
    if np.ptp(command) > 0 and share < SLOW_SHARE:
        yield Finding(
            "slow_commands",
            "warning",
            f"{100 * share:.2g} % of the power of the {axis} command lies above {SLOW_FREQUENCY:g} Hz; a damping b "
            "shows about b/(2 pi), 0.03 to 0.6 Hz for multirotors, a delay of 0.2 s about 1/(2 pi 0.2) = 0.8 Hz",
            f"delay and damping of {axis} can hardly be separated; of gain and damping only the ratio is known",
            f"command {axis} with steps of about a second, or with sines up to 0.8 Hz",
            axis,
        )


def _units(axis: str, card: Card, command: Array) -> Iterator[Finding]:
    channel, largest = card.command.get(axis), float(np.abs(command).max())
    if channel is None:  # x or y alone, given along the world: turned, it moves the vehicle along both
        return
    if channel.full_scale:
        limit, what = FRACTION_LIMIT, f"a fraction of the {channel.full_scale} limit"
    elif channel.meaning:
        limit, unit = MEANING_LIMITS[channel.meaning]
        what = f"a {channel.meaning.replace('_', ' ')} in {unit}"
    else:
        return
    if largest > limit:
        yield Finding(
            "unit_mistake",
            "warning",
            f"the {axis} command reaches {largest:.3g}, which cannot be {what}; more than {limit:g} is implausible",
            f"the input gain of {axis} is per that command: too small by the ratio of the units",
            f"give the {axis} channel of [command] its unit (deg, deg/s, cm/s), or the scale that makes it a fraction",
            axis,
        )


def _zeros_between(flight: Flight) -> Iterator[Finding]:
    """Zeros of all axes between commands that last for a single sample each, as of blank cells that were filled."""
    given = np.any(flight.command, axis=1)
    single = given & ~np.append(False, given[:-1]) & ~np.append(given[1:], False)
    if single.sum() < max(BLANKS, BLANK_SHARE * given.sum()) or given.all():
        return
    at, steps = flight.command_time[single], np.diff(flight.command_time)
    step, spans = float(np.median(steps)), at[TOGETHER:] - at[:-TOGETHER]
    again = float(np.sum(~given[1:] & ~given[:-1]) / np.sum(~given))
    sampled = again > REPEATED or np.mean(np.abs(steps - step) < EVEN * step) > MOST
    clocked = np.mean(np.abs(spans - np.median(spans)) < 1.5 * step) > CLOCKED
    if not sampled or not clocked or np.median(np.diff(at)) > BLANK_TIME:
        return
    lasts = np.append(steps, step)
    factor = float(np.sum(lasts) / np.sum(lasts[given]))
    yield Finding(
        "zeros_between_commands",
        "error",
        f"{single.sum()} commands last for one sample each, and all axes are exactly 0 in between, in "
        f"{100 * (1 - given.mean()):.0f} % of the samples: blank cells filled with 0?",
        f"input gains are too large by the share of time of the zeros, {factor:.2g} times if they were blank",
        "leave cells without a command blank, or repeat the last command there; do not fill them with 0",
    )


def _low_passed(flight: Flight) -> Iterator[Finding]:
    """Commands smoothed by the logger, according to the notes of the flight."""
    told = {note.code: note.text for note in flight.notes}
    if "commands_unfiltered" in told:
        yield Finding(
            "commands_low_pass",
            "info",
            told["commands_unfiltered"],
            "none: the coefficients are those of the commands that were sent",
            "log each command as it is sent",
        )
    elif "commands_low_pass" in told:
        yield Finding(
            "commands_low_pass",
            "warning",
            told["commands_low_pass"],
            "if the logger smooths them, input gain and damping are wrong beyond their intervals, and the delay is too "
            "short",
            "log each command as it is sent, or fly more steps",
        )


def _alike(flight: Flight) -> Iterator[Finding]:
    """Pairs of commanded axes with commands proportional up to a constant."""
    moving = [axis for axis in flight.axes if np.ptp(flight.command[:, AXES.index(axis)]) > 0]
    weight = np.minimum(np.diff(flight.command_time, append=np.inf), np.median(np.diff(flight.command_time)) * 3)
    pairs = {}
    for one, other in combinations(moving, 2):
        r = _correlation(flight.command[:, AXES.index(one)], flight.command[:, AXES.index(other)], weight)
        if abs(r) > ALIKE:
            pairs[one, other] = r
    if pairs:
        plane = ("x", "y") in pairs
        told = ", ".join(f"{one} and {other} {r:+.2f}" for (one, other), r in pairs.items())
        yield Finding(
            "collinear_commands",
            "warning" if plane else "info",
            f"commands are proportional to each other; correlations: {told}",
            "the effect of one axis on another cannot be separated from its own response"
            + ("; exchanged or turned x and y cannot be noticed" if plane else ""),
            "fly the axes one after the other, or with frequencies of their own",
        )


def _correlation(one: Array, other: Array, weight: Array) -> float:
    """Correlation of two series, weighted by the time for which each value is held."""
    a, b = (values - np.average(values, weights=weight) for values in (one, other))
    return float(np.sum(weight * a * b) / np.sqrt(np.sum(weight * a**2) * np.sum(weight * b**2)))
