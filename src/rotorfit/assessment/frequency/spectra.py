"""Flight -> spectra of command and motion of an axis, over windows without a hole, exact where it matters.

Of the held commands the Fourier integral over the window is a sum, so neither their hold nor their jitter is
approximated. The velocity's is i w times that of the position, whose straight line between both ends is taken off
first; poses at irregular stamps are joined by cubic splines. What both lack at the ends of the window is a smooth
function of the frequency, and `frequency_bands` leaves it free.

x and y are taken along the mean heading of the window, and the commands of both are turned there by the measured
heading: right for a vehicle whose x and y answer alike. What the other axis adds to a vehicle of another kind goes, to
first order, with its command times the turn.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rotorfit.assessment.frequency.irregular_fourier import IrregularFourier
from rotorfit.assessment.frequency.tones import Tones, tones_of
from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES, Array, Mask, heading_from_world
from rotorfit.core.frequency_response import Spectrum

LONGEST_HOLE = 0.4
"""Time without a pose that ends a window [s]."""

SHORTEST = 10.0
"""Shortest window [s]: a bin is then 0.6 rad/s."""

HIGHEST = 15.0
"""Highest frequency that is looked at [rad/s]."""

OF_NYQUIST = 0.4
"""The same as a share of half the rate of the poses."""

STEP = 0.1
"""Time between the samples of commands in which tones are looked for [s]."""

TURNED = np.radians(60.0)
"""Deviation of the heading from its mean up to which x and y are taken along it."""

TURNS = 0.05
"""Time between the samples of a command that turns with the vehicle [s]."""


@dataclass(frozen=True)
class Window:
    """Command, motion and reference of an axis over a time without a hole.

    Attributes:
        time: Stamps of the poses, shape (N,) [s].
        position: Along the axis, shape (N,) [m or rad].
        switch: When each command begins to hold, and the end of the last, shape (M + 1,) [s]; from first to last pose.
        command: Shape (M,).
        turned: What the other axis adds for each radian that the heading is off its mean, times the heading less its
            mean, shape (M,); 0 of z and yaw.
        turning: The same times the rate of the heading, shape (M,).
        reference: What a position controller was told, along the axis, shape (M,); None where it was not recorded.
    """

    time: Array
    position: Array
    switch: Array
    command: Array
    turned: Array
    turning: Array
    reference: Array | None

    @property
    def duration(self) -> float:
        """[s]."""
        return float(self.time[-1] - self.time[0])

    @property
    def samples(self) -> Array:
        """Regular times for what is no integral, shape (S,) [s]."""
        return np.arange(self.time[0], self.time[-1] - STEP, STEP)

    @property
    def means(self) -> Array:
        """Mean command of each step after the regular times, shape (S,)."""
        total = np.append(0.0, np.cumsum(self.command * np.diff(self.switch)))
        ends = np.append(self.samples, self.samples[-1] + STEP)
        return np.asarray(np.diff(np.interp(ends, self.switch, total)) / STEP)


@dataclass(frozen=True)
class Spectra:
    """Fourier integrals of a window at whole multiples of one turn over its duration.

    Attributes:
        duration: [s].
        frequency: Shape (F,) [rad/s].
        motion: Of the velocity, shape (F,) [m or rad].
        command: Shape (F,).
        instrument: Of what moves the command from outside any loop, shape (F,); the command itself in an open loop.
        turned: Of what the other axis adds for a vehicle whose x and y differ, shape (F,); 0 where it does not turn.
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
        """Some of the frequencies."""
        parts = (self.motion, self.command, self.instrument, self.turned, self.turning)
        return Spectra(self.duration, self.frequency[rows], *(part[rows] for part in parts))

    def scaled(self, factor: Array) -> "Spectra":
        """Each times a factor, shape (F,)."""
        parts = (self.motion, self.command, self.instrument, self.turned, self.turning)
        return Spectra(self.duration, self.frequency, *(part * factor for part in parts))

    def turned_later(self, late: float) -> "Spectra":
        """With commands that turn with the heading of a time after their own [s], to first order."""
        alike = self.instrument is self.command
        command = self.command + late * self.turning
        return replace(self, command=command, instrument=command if alike else self.instrument)


def windows_of(flight: Flight, axis: str) -> tuple[Window, ...]:
    """The windows of a flight that are long enough, for one axis; without x and y where the vehicle turns far."""
    return tuple(
        window
        for part in flight.segments
        for first, last in _without_holes(flight.pose_time, part.start, part.end)
        if (window := _window(flight, axis, first, last)) is not None
    )


def _without_holes(time: Array, start: float, end: float) -> Iterator[tuple[int, int]]:
    """First and one past the last pose of each run between two times that is long enough."""
    inside = np.flatnonzero((time >= start) & (time <= end))
    if inside.size < 2:
        return
    for run in np.split(inside, np.flatnonzero(np.diff(time[inside]) > LONGEST_HOLE) + 1):
        if time[run[-1]] - time[run[0]] >= SHORTEST:
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
    turned, rate, across = (np.zeros(begin.size) for _ in range(3))
    if k < 2:
        position = heading_from_world(position[:, :2], np.full(time.size, mean))
        turned = np.interp((switch[1:] + switch[:-1]) / 2, time, yaw) - mean
        rate = np.diff(np.interp(switch, time, yaw)) / np.diff(switch)
        across = command[:, 1 - k] * (1.0 if k else -1.0)
        command = heading_from_world(command[:, :2], -turned)
        if reference is not None:
            reference = heading_from_world(reference[:, :2], np.full(begin.size, mean))
    told = None if reference is None or not np.isfinite(reference[:, k]).all() else reference[:, k]
    return Window(time, position[:, k], switch, command[:, k], across * turned, across * rate, told)


def highest_of(window: Window) -> float:
    """Highest frequency that the poses of a window show [rad/s]."""
    return min(HIGHEST, OF_NYQUIST * np.pi / float(np.median(np.diff(window.time))))


def window_tones(window: Window) -> Tones:
    """The tones of the commands of a window."""
    return tones_of(window.samples + STEP / 2, window.means, highest_of(window))


def spectra_of(window: Window, instrument: Tones | Array | None = None) -> Spectra:
    """Spectra of a window.

    Args:
        window: Command and motion.
        instrument: What moves the command from outside of any loop: tones, or held values (M,); None for the command.
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
    """Integrals of v(t) exp(-i w t) of values that are held from one switch to the next, t from the first: exact.

    Args:
        switch: Shape (M + 1,) [s].
        values: Each of shape (M,).
        count: Of the frequencies w, the first whole multiples of one turn from the first switch to the last.

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
    """Twice as many regular times as there are poses, from the first to a step before the last."""
    count = 2 * int(np.ceil((time[-1] - time[0]) / float(np.median(np.diff(time)))))
    return np.asarray(time[0] + (time[-1] - time[0]) / count * np.arange(count))


def _regular_integral(value: Array, duration: float, size: int) -> Spectrum:
    """The same of a smooth function at regular times, at the first whole multiples of one turn over the duration."""
    return np.asarray(np.fft.fft(value)[1 : size + 1] * (duration / value.size))


def _velocity_integral(time: Array, position: Array, omega: Array) -> Spectrum:
    """That of the rate of a position, less what the ends of the window add at each of these frequencies."""
    from scipy.interpolate import CubicSpline

    slope = (position[-1] - position[0]) / (time[-1] - time[0])
    rest = CubicSpline(time, position - position[0] - slope * (time - time[0]))(_regular(time))
    return np.asarray(1j * omega * _regular_integral(rest, float(time[-1] - time[0]), omega.size))
