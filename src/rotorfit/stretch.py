"""Flight -> stretches: what the regressions on filtered signals see, on one fine grid in world axes.

Between the edges of the grid only means are used: of a held, delayed command the exact mean, of the velocity the
difference of positions. A velocity that is resolved along a turning heading is filtered as the product that eq. (5)
holds, R P R^T v, since a filter does not commute with the turning; so every term of the equation passes through one
linear operator, and whatever that is, it leaves the coefficients alone.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from rotorfit.flight import Flight, Segment
from rotorfit.frames import AXES, Array
from rotorfit.record import DELAY_RANGE

GRID = 0.005
"""Step of the grid [s]. A mean over it lacks (omega GRID)^2 / 24 of a sine: 4e-5 at 1 Hz."""

LONGEST_HOLE = 0.25
"""A hole between two poses longer than this, and than three periods, ends a stretch [s]."""

SHORTEST = 1.0
"""Stretches shorter than this are left out [s]."""


@dataclass(frozen=True)
class Stretch:
    """A run of a flight without holes in which every command that may act is known. E + 1 cells, C world axes (1 or 2).

    The terms of the equation of motion stand at the E inner edges between the cells.

    Attributes:
        flight: Its place among the flights.
        edge: Edges of the cells, shape (E + 2,) [s].
        heading: At the middle of each cell, shape (E + 1,) [rad]; 0 for z and yaw.
        position: World, at the edges, shape (E + 2, C).
        switch: Stamps of the commands of its segment, and the segment's end, shape (M + 1,) [s].
        command: Commands of its segment, shape (M, C).
        commanded: Which axes the flight commands at all, shape (C,).
        reference: What a position controller was told, held onto the commands' stamps, shape (M, C); None without.
    """

    flight: int
    edge: Array
    heading: Array
    position: Array
    switch: Array
    command: Array
    commanded: tuple[bool, ...]
    reference: Array | None

    @property
    def size(self) -> int:
        """Number of inner edges."""
        return len(self.edge) - 2

    @property
    def axes(self) -> int:
        """Number of world axes."""
        return int(self.position.shape[1])


def stretches(flights: Sequence[Flight], axes: Sequence[str]) -> tuple[Stretch, ...]:
    """Cuts flights into stretches for z, yaw, or x and y together.

    A stretch starts as late after its segment as the longest delay that is searched, so that every command that may act
    is known, and ends as early as the shortest.

    Args:
        flights: The flights.
        axes: `("z",)`, `("yaw",)` or `("x", "y")`.
    """
    found = []
    for number, flight in enumerate(flights):
        t = flight.pose_time
        hole = max(LONGEST_HOLE, 3 * float(np.median(np.diff(t)))) if t.size > 1 else LONGEST_HOLE
        for segment in flight.segments:
            first, last = np.searchsorted(t, [segment.start + DELAY_RANGE[1], segment.end + DELAY_RANGE[0]])
            cuts = [first, *(first + 1 + np.flatnonzero(np.diff(t[first:last]) > hole)), last]
            for low, high in pairwise(cuts):
                if high - low >= 4 and t[high - 1] - t[low] >= SHORTEST:
                    found.append(_stretch(number, flight, segment, slice(int(low), int(high)), axes))
    return tuple(found)


def _stretch(number: int, flight: Flight, segment: Segment, poses: slice, axes: Sequence[str]) -> Stretch:
    from scipy.interpolate import CubicSpline

    column = [AXES.index(axis) for axis in axes]
    t, pose = flight.pose_time[poses], np.column_stack([flight.position, flight.yaw])[poses]
    edge = t[0] + GRID * np.arange(int((t[-1] - t[0]) / GRID + 1e-6) + 1)
    spline = CubicSpline(t, pose - pose[0])  # through every pose: only what the grid asks for between them is its own
    middle = (edge[:-1] + edge[1:]) / 2
    heading = spline(middle)[:, 3] + pose[0, 3] if "x" in axes else np.zeros(middle.size)
    begin, end = np.searchsorted(flight.command_time, [segment.start, segment.end])
    acting = slice(int(begin), int(end))
    return Stretch(
        flight=number,
        edge=edge,
        heading=heading,
        position=np.ascontiguousarray(spline(edge)[:, column]),
        switch=np.append(flight.command_time[acting], segment.end),
        command=np.ascontiguousarray(flight.command[acting][:, column]),
        commanded=tuple(axis in flight.axes and bool(np.any(flight.command[:, AXES.index(axis)])) for axis in axes),
        reference=_known(flight.reference, acting, column),
    )


def _known(reference: Array | None, acting: slice, column: Sequence[int]) -> Array | None:
    """The reference of these axes, None where one of them has none."""
    if reference is None or not np.isfinite(reference[acting][:, column]).all():
        return None
    return np.ascontiguousarray(reference[acting][:, column])


def command_term(stretch: Stretch, k: int, delay: float, command: Array | None = None) -> Array:
    """The command u_k(t - delay) along the heading, in the world, at the edges, shape (E, C).

    Args:
        stretch: Where.
        k: Which axis.
        delay: [s].
        command: Other values at the same stamps, shape (M, C).
    """
    values = stretch.command if command is None else command
    total = np.concatenate([[0.0], np.cumsum(values[:, k] * np.diff(stretch.switch))])
    mean = np.diff(np.interp(stretch.edge - delay, stretch.switch, total)) / GRID
    return _at_edges(_turned(stretch, k, mean))


def delay_term(stretch: Stretch, k: int, delay: float, command: Array | None = None) -> Array:
    """Derivative of `command_term` with respect to the delay, shape (E, C) [1/s]."""
    values = stretch.command if command is None else command
    place = np.clip(np.searchsorted(stretch.switch, stretch.edge - delay, side="right") - 1, 0, len(values) - 1)
    return _at_edges(_turned(stretch, k, -np.diff(values[place, k]) / GRID))


def velocity_term(stretch: Stretch, k: int, position: Array | None = None) -> Array:
    """The velocity along axis k of the heading, in the world, at the edges, shape (E, C).

    Args:
        stretch: Where.
        k: Which axis.
        position: Other positions at the edges of the cells, shape (E + 2, C); by default those that were measured.
    """
    velocity = np.diff(stretch.position if position is None else position, axis=0) / GRID
    if stretch.axes == 1:
        return _at_edges(velocity)
    c, s = np.cos(stretch.heading), np.sin(stretch.heading)
    along = c * velocity[:, 0] + s * velocity[:, 1] if k == 0 else c * velocity[:, 1] - s * velocity[:, 0]
    return _at_edges(_turned(stretch, k, along))


def trim_term(stretch: Stretch, k: int) -> Array:
    """A constant of one along axis k of the heading, in the world, at the edges, shape (E, C)."""
    return _at_edges(_turned(stretch, k, np.ones(stretch.heading.size)))


def acceleration_term(stretch: Stretch) -> Array:
    """Second difference of the position at the edges, shape (E, C): only ever used under a smooth kernel."""
    return np.diff(stretch.position, 2, axis=0) / GRID**2


def _turned(stretch: Stretch, k: int, along: Array) -> Array:
    """A quantity along axis k of the heading as world components, shape (E + 1, C)."""
    if stretch.axes == 1:
        return along[:, None]
    c, s = np.cos(stretch.heading), np.sin(stretch.heading)
    return np.stack([c * along, s * along] if k == 0 else [-s * along, c * along], axis=1)


def _at_edges(cells: Array) -> Array:
    return (cells[1:] + cells[:-1]) / 2
