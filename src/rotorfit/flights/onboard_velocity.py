"""Onboard velocity: an additional measurement, or the only one of an axis."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from rotorfit.core.card import Card, Channel
from rotorfit.core.errors import FlightError
from rotorfit.core.flight_data import Note, Velocity
from rotorfit.core.frames import AXES, Array, world_from_heading
from rotorfit.core.log import Log
from rotorfit.flights.columns import split_source
from rotorfit.flights.other_tables import interpolate, sound_samples, state_samples
from rotorfit.flights.stamps import Stamps, coarse, fresh, grain
from rotorfit.flights.streams import NEVER, Stream, in_order, joined_note, keep_samples, numbers, read_series


def velocities_of(log: Log, card: Card) -> Stream | None:
    """Takes the onboard velocity from a log according to the card, and repairs it.

    Args:
        log: As recorded.
        card: The meaning of each column.

    Returns:
        Velocities in the card's velocity frame, z up (a NED world frame is converted to ENU), NaN for axes that the
        card does not name [m/s, rad/s]; None where none is needed: every axis has a pose, and the card does not state
        that the velocity is independent of it.

    Raises:
        CardError: A column is missing, or has no clock.
        FlightError: No velocities, one that never changes, or a clock that runs backwards.
    """
    wanted = AXES if card.velocity_independent else card.velocity_only
    channels = {axis: channel for axis, channel in card.velocity.items() if axis in wanted}
    if not channels:
        return None
    notes: tuple[Note, ...] = ()
    if card.velocity_time is not None:
        stamps, series, notes = read_series(log, card.velocity_time, channels, "velocity")
    else:
        stamps, series, notes = _on_one_clock(log, card, channels)
    values = np.stack([series.get(axis, np.zeros(len(stamps))) for axis in AXES], axis=1)
    stream = Stream("velocity", stamps, values, np.full(len(stamps), NEVER), notes)
    stream = in_order(numbers(stream, log), log)
    if not np.any(np.ptp(stream.values, axis=0)):
        raise FlightError(f"{log.path}: the velocity never changes; is [velocity] of the card the flown vehicle?")
    if not coarse(stream.values):
        why = "repeat the one before with a fresh stamp: dropped"
        stream = keep_samples(stream, fresh(stream.values), "stale_velocities", why)
    values = np.where([axis in channels for axis in AXES], stream.values, np.nan)
    if card.frame == "NED" and card.velocity_frame == "world":
        values = np.stack([values[:, 1], values[:, 0], -values[:, 2], -values[:, 3]], axis=1)
    return replace(stream, values=values)


def _on_one_clock(
    log: Log, card: Card, channels: Mapping[str, Channel]
) -> tuple[Stamps, dict[str, Array], tuple[Note, ...]]:
    """Stamps and series of the first channel's table; those in other tables are interpolated onto its stamps."""
    parts = {axis: state_samples(log, card, channel, "velocity") for axis, channel in channels.items()}
    tables = {axis: split_source(channel.source)[0] for axis, channel in channels.items()}
    others = [axis for axis, table in tables.items() if table != next(iter(tables.values()))]
    own = {axis: part for axis, part in parts.items() if axis not in others}
    shared = min(len(clock) for clock, _ in own.values())
    stamps = next(iter(own.values()))[0][:shared]
    series = {axis: values[:shared] for axis, (_, values) in own.items()}
    series |= {axis: interpolate(*sound_samples(*parts[axis]), stamps) for axis in others}
    return stamps, series, (joined_note("velocity", others, len(stamps)),) if others else ()


def in_the_world(velocities: Stream, card: Card, origin: int, pose_time: Array, yaw: Array) -> Velocity:
    """The onboard velocity in the world frame; time in seconds from the start of the common window."""
    time, value = (velocities.stamps - origin) / 1e9, velocities.values
    rounded = grain(value)
    rounded[:2] = rounded[:2].max()  # the heading frame rotates in the world
    if card.velocity_frame == "heading":
        turned = world_from_heading(value[:, :2], np.interp(time, pose_time, yaw))
        value = np.hstack([turned, value[:, 2:]])
    return Velocity(time, value, rounded, card.velocity_only, onboard=card.velocity_frame == "heading")


def moved(velocity: Velocity, late: Array, pose_time: Array, yaw: Array) -> Velocity:
    """The velocity on the clock of the poses, with x and y rotated by the heading at the corrected time.

    Args:
        velocity: As measured.
        late: Lag of each axis behind the pose, shape (4,) [s]; equal for x and y.
        pose_time: Stamps of the poses, shape (N,) [s].
        yaw: Their heading, shape (N,) [rad].
    """
    out = replace(velocity, late=late)
    if not velocity.onboard:
        return out
    before, after = (np.interp(each.true_time("x"), pose_time, yaw) for each in (velocity, out))
    turned = world_from_heading(velocity.value[:, :2], after - before)
    return replace(out, value=np.hstack([turned, velocity.value[:, 2:]]))


def with_travel(log: Log, position: Array, pose_time: Array, velocity: Velocity) -> tuple[Array, tuple[Note, ...]]:
    """Positions with the integrated velocity (trapezoids) on the axes that have nothing else, and notes.

    Args:
        log: For the error message.
        position: World x, y, z, shape (N, 3) [m].
        pose_time: Shape (N,) [s].
        velocity: In the world frame.

    Raises:
        FlightError: Fewer than two velocities where one is needed.
    """
    if not velocity.alone:
        return position, ()
    if velocity.time.size < 2:
        raise FlightError(f"{log.path}: no velocity in the common window or the span; check [velocity] of the card")
    out, step = position.copy(), np.diff(velocity.time)
    for axis in velocity.alone:
        k = AXES.index(axis)
        v = velocity.value[:, k]
        travel = np.concatenate([[0.0], np.cumsum(0.5 * step * (v[1:] + v[:-1]))])
        out[:, k] = np.interp(pose_time, velocity.time, travel)
    text = (
        f"{', '.join(velocity.alone)} have no position: {velocity.time.size} velocities replace it, and the delay "
        "includes their latency"
    )
    notes: tuple[Note, ...] = (Note("velocity_only", text, velocity.time.size),)
    for axis in velocity.alone:
        if grain := velocity.grain[AXES.index(axis)]:
            text = f"the velocity of {axis} is rounded to {grain:.3g} m/s: its error is taken to be no less than that"
            notes = (*notes, Note("velocity_rounded", text, velocity.time.size))
    return out, notes
