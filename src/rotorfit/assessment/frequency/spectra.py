"""Flight -> spectra of command and motion of an axis, over windows without a gap.

For held commands the Fourier integral over the window is a sum, so neither their hold nor their jitter is
approximated. The velocity's integral is i w times that of the position, from which the straight line between both ends
is subtracted first; poses at irregular stamps are interpolated by cubic splines. The effect of the ends of the window
on both is a smooth function of the frequency, which `bands` leaves free.

x and y are taken along the mean heading of the window, and the commands of both are rotated into it by the measured
heading: right for a vehicle whose x and y respond alike. For other vehicles the contribution of the other axis is, to
first order, its command times the turn.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES, Array, Mask, heading_from_world
from rotorfit.core.frequency_response import Spectrum
from rotorfit.dynamics.irregular_fourier import IrregularFourier
from rotorfit.dynamics.tones import Tones, tones_of

LONGEST_HOLE = 0.4
"""Time without a pose that ends a window [s]."""

SHORTEST = 10.0
"""Shortest window [s]: a bin is then 0.6 rad/s."""

HIGHEST = 15.0
"""Highest frequency that is used [rad/s]."""

OF_NYQUIST = 0.4
"""The same as a share of half the rate of the poses."""

STEP = 0.1
"""Sampling period of the commands in which tones are searched [s]."""

TURNED = np.radians(60.0)
"""Largest deviation of the heading from its mean for which x and y are taken along it [rad]."""

TURNS = 0.05
"""Sampling period of a command that turns with the vehicle [s]."""


@dataclass(frozen=True)
class Window:
    """Command, motion and reference of an axis over a time without a gap.

    Attributes:
        time: Stamps of the poses, shape (N,) [s].
        position: Position along the axis, shape (N,) [m or rad].
        switch: When each command begins to hold, and the end of the last, shape (M + 1,) [s]; from first to last pose.
        command: Along the mean heading, shape (M,).
        sent: As it was sent, along the heading then or in the world: it does not turn with the vehicle, shape (M,).
        turned: Change of the command due to the other axis per radian of heading off its mean, times the deviation of
            the heading from its mean, shape (M,); 0 for z and yaw.
        turning: The same times the rate of the heading, shape (M,).
        reference: Input of a position controller along the axis, shape (M,); None if it was not recorded.
    """

    time: Array
    position: Array
    switch: Array
    command: Array
    sent: Array
    turned: Array
    turning: Array
    reference: Array | None

    @property
    def duration(self) -> float:
        """Time from the first to the last pose [s]."""
        return float(self.time[-1] - self.time[0])

    @property
    def samples(self) -> Array:
        """Regular times for signals that are sampled, not integrated, shape (S,) [s]."""
        return np.arange(self.time[0], self.time[-1] - STEP, STEP)

    @property
    def means(self) -> Array:
        """Mean command over the step after each of these times, shape (S,)."""
        total = np.append(0.0, np.cumsum(self.command * np.diff(self.switch)))
        ends = np.append(self.samples, self.samples[-1] + STEP)
        return np.asarray(np.diff(np.interp(ends, self.switch, total)) / STEP)


@dataclass(frozen=True)
class Spectra:
    """Fourier integrals of a window at the multiples of 2 pi over its duration.

    Attributes:
        duration: Duration of the window [s].
        frequency: Shape (F,) [rad/s].
        motion: Integral of the velocity, shape (F,) [m or rad].
        command: Shape (F,).
        instrument: Integral of what moves the command from outside any loop, shape (F,); the command itself in an open
            loop.
        turned: Contribution of the other axis for a vehicle whose x and y differ, shape (F,); 0 where it does not turn.
        turning: Change of the command for each second by which the vehicle turns it later, shape (F,).
    """

    duration: float
    frequency: Array
    motion: Spectrum
    command: Spectrum
    instrument: Spectrum
    turned: Spectrum
    turning: Spectrum

    def at(self, rows: Mask) -> "Spectra":
        """The spectra at some of the frequencies."""
        parts = (self.motion, self.command, self.instrument, self.turned, self.turning)
        return Spectra(self.duration, self.frequency[rows], *(part[rows] for part in parts))

    def scaled(self, factor: Array) -> "Spectra":
        """The spectra times a factor, shape (F,)."""
        parts = (self.motion, self.command, self.instrument, self.turned, self.turning)
        return Spectra(self.duration, self.frequency, *(part * factor for part in parts))


def windows_of(flight: Flight, axis: str) -> tuple[Window, ...]:
    """The windows of a flight that are long enough, for one axis; without x and y where the vehicle turns far."""
    return tuple(
        window for first, last in runs_of(flight) if (window := _window(flight, axis, first, last)) is not None
    )


def runs_of(flight: Flight) -> Iterator[tuple[int, int]]:
    """First pose and one past the last of each run without a hole that is long enough."""
    time = flight.pose_time
    for part in flight.segments:
        inside = np.flatnonzero((time >= part.start) & (time <= part.end))
        for run in np.split(inside, np.flatnonzero(np.diff(time[inside]) > LONGEST_HOLE) + 1):
            if run.size > 1 and time[run[-1]] - time[run[0]] >= SHORTEST:
                yield int(run[0]), int(run[-1]) + 1


def _window(flight: Flight, axis: str, first: int, last: int) -> Window | None:
    k, time, yaw = AXES.index(axis), flight.pose_time[first:last], flight.yaw[first:last]
    mean = float(yaw.mean())
    if k < 2 and np.abs(yaw - mean).max() > TURNED:
        return None
    turning = k < 2 and np.ptp(yaw) > np.radians(0.5)
    extra = np.arange(time[0], time[-1], TURNS) if turning else np.zeros(0)
    inside = (flight.command_time > time[0]) & (flight.command_time < time[-1])
    begin = np.unique(np.concatenate([time[:1], flight.command_time[inside], extra]))
    switch = np.append(begin, time[-1])
    row = np.maximum(np.searchsorted(flight.command_time, begin, side="right") - 1, 0)
    command, reference = flight.command[row], None if flight.reference is None else flight.reference[row]
    position = np.column_stack([flight.position, flight.yaw])[first:last]
    sent = command[:, k]
    turned, rate, across = (np.zeros(begin.size) for _ in range(3))
    if k < 2:
        position = heading_from_world(position[:, :2], np.full(time.size, mean))
        turned = np.interp((switch[1:] + switch[:-1]) / 2, time, yaw) - mean
        rate = np.diff(np.interp(switch, time, yaw)) / np.diff(switch)
        across = command[:, 1 - k] * (1.0 if k else -1.0) * turning
        command = heading_from_world(command[:, :2], -turned)
        sent = command[:, k] if flight.card.command_frame == "world" else sent
        if reference is not None:
            reference = heading_from_world(reference[:, :2], np.full(begin.size, mean))
    told = None if reference is None or not np.isfinite(reference[:, k]).all() else reference[:, k]
    return Window(time, position[:, k], switch, command[:, k], sent, across * turned, across * rate, told)


def highest_of(window: Window) -> float:
    """Highest frequency that the poses of a window resolve [rad/s]."""
    return min(HIGHEST, OF_NYQUIST * np.pi / float(np.median(np.diff(window.time))))


def window_tones(window: Window) -> Tones:
    """The tones of the commands of a window."""
    return tones_of(window.samples + STEP / 2, window.means, highest_of(window))


def spectra_of(window: Window, instrument: Tones | Array | None = None) -> Spectra:
    """Spectra of a window.

    Args:
        window: Command and motion.
        instrument: What moves the command from outside any loop: tones, or held values (M,); None for the command.
    """
    count = int(highest_of(window) * window.duration / (2 * np.pi))
    omega = np.asarray(2 * np.pi / window.duration * np.arange(1, count + 1), np.float64)
    held = [window.command, window.turned, window.turning]
    if instrument is not None and not isinstance(instrument, Tones):
        held.append(instrument)
    command, turned, turning, *told = held_integrals(window.switch, held, omega.size)
    outside = told[0] if told else command
    if isinstance(instrument, Tones):
        outside = _regular_integral(instrument.value(_regular(window.time)), window.duration, omega.size)
    motion = _velocity_integral(window.time, window.position, omega)
    return Spectra(window.duration, omega, motion, command, outside, turned, turning)


def held_integrals(switch: Array, values: Sequence[Array], count: int) -> list[Spectrum]:
    """Exact integrals of v(t) exp(-i w t) of values held from one switch to the next, with t from the first switch.

    Args:
        switch: Shape (M + 1,) [s].
        values: Each of shape (M,).
        count: Number of frequencies w, the first multiples of 2 pi over the time from the first switch to the last.

    Returns:
        Each of shape (count,).
    """
    lowest = 2 * np.pi / (switch[-1] - switch[0])
    sums = IrregularFourier(lowest * (switch - switch[0]), count + 1)
    s = 1j * lowest * np.arange(1, count + 1)
    return [
        sums.over_points(np.diff(value, prepend=0.0, append=0.0))[1:] / s if value.any() else np.zeros_like(s)
        for value in values
    ]


def _regular(time: Array) -> Array:
    """At least twice as many regular times as there are poses, from the first to a step before the last."""
    from scipy.fft import next_fast_len

    count = next_fast_len(2 * int(np.ceil((time[-1] - time[0]) / float(np.median(np.diff(time))))), real=True)
    return np.asarray(time[0] + (time[-1] - time[0]) / count * np.arange(count))


def _regular_integral(value: Array, duration: float, size: int) -> Spectrum:
    """The same for a smooth function at regular times, at the first multiples of 2 pi over the duration."""
    return np.asarray(np.fft.rfft(value)[1 : size + 1] * (duration / value.size))


def _velocity_integral(time: Array, position: Array, omega: Array) -> Spectrum:
    """Integral of the rate of a position, minus what the ends of the window contribute at each of these frequencies."""
    from scipy.interpolate import CubicSpline

    slope = (position[-1] - position[0]) / (time[-1] - time[0])
    rest = CubicSpline(time, position - position[0] - slope * (time - time[0]))(_regular(time))
    return np.asarray(1j * omega * _regular_integral(rest, float(time[-1] - time[0]), omega.size))
