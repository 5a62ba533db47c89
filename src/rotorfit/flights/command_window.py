"""When commands count: the conditions of a card's window, and the pose resets of an onboard estimator."""

from collections.abc import Iterator

import numpy as np

from rotorfit.core.card import Card, Condition
from rotorfit.core.frames import Array, Mask
from rotorfit.core.log import Log
from rotorfit.flights.other_tables import state_samples
from rotorfit.flights.stamps import Stamps, fresh, held

IDLE = 3.0
"""Time without a change after which commands at the ends count as idle [s]."""

BUSY = 0.9
"""Share of a controller's commands that differ from the previous one."""

LEAST_CHANGES = 50
"""Number of changes below which commands are not recognised as a controller's."""


def conditions(log: Log, card: Card, stamps: Stamps) -> Iterator[tuple[str, Mask]]:
    """Each condition of a card's window: its text, and at which of the stamps it holds, shape (N,).

    A condition does not hold before its first value; an event that closes implies that it held before, and vice versa.

    Raises:
        CardError: A column is missing, or has no clock.
    """
    for condition in card.window:
        clock, values = state_samples(log, card, condition.channel, "window")
        if condition.opens:
            yield _text(condition), _between_events(condition, clock, values, stamps)
        else:
            yield _text(condition), _holds(condition, held(clock, values, stamps))


def resets(log: Log, card: Card, stamps: Stamps) -> Stamps:
    """Times at which a reset counter changed between the first and last of the stamps, sorted [ns].

    Raises:
        CardError: A column is missing, or has no clock.
    """
    found = [np.zeros(0, dtype=np.int64)]
    for channel in card.resets:
        clock, values = state_samples(log, card, channel, "resets")
        found.append(clock[1:][np.diff(values) != 0])
    times = np.unique(np.concatenate(found))
    return np.asarray(times[(times > stamps[0]) & (times <= stamps[-1])])


def idle_ends(stamps: Stamps, values: Array) -> Mask:
    """Which commands at the ends stand still although a controller changes them continuously in between, shape (N,).

    Loggers repeat the last command, or 0, while nobody controls. Idle ends are recognised by both: the same four values
    for at least `IDLE` seconds, and between the ends `BUSY` of the commands differ from the previous one. Commands in
    steps, or given by hand, are left alone.

    Args:
        stamps: Increasing, shape (N,) [ns].
        values: Shape (N, 4).
    """
    idle = np.zeros(len(stamps), dtype=np.bool_)
    changes = np.flatnonzero(fresh(values)[1:]) + 1
    if changes.size < LEAST_CHANGES:
        return idle
    first, last = int(changes[0]), int(changes[-1])
    if changes.size < BUSY * (last - first + 1):
        return idle
    if stamps[first] - stamps[0] >= IDLE * 1e9:
        idle[:first] = True
    if stamps[-1] - stamps[last] >= IDLE * 1e9:
        idle[last + 1 :] = True
    return idle


def _holds(condition: Condition, values: Array) -> Mask:
    if condition.equals:
        return np.asarray(np.isin(values, condition.equals))
    if condition.above is not None:
        return np.asarray(values > condition.above)
    return np.asarray(np.nan_to_num(values) != 0)


def _between_events(condition: Condition, clock: Stamps, values: Array, stamps: Stamps) -> Mask:
    """Whether the last relevant event was an opening one; without any relevant event the condition holds."""
    tells = np.isin(values, (*condition.opens, *condition.closes))
    if not np.any(tells):
        return np.ones(len(stamps), dtype=np.bool_)
    opens = np.isin(values[tells], condition.opens).astype(np.float64)
    before = 1 - opens[np.argmin(clock[tells])]
    state = held(clock[tells], opens, stamps)
    return np.asarray(np.where(np.isnan(state), before, state) == 1)


def _text(condition: Condition) -> str:
    """Why the window is closed, for a note: `SOURCE is zero`."""
    source = condition.channel.source
    if condition.equals:
        return f"{source} is not {' or '.join(f'{value:g}' for value in condition.equals)}"
    if condition.above is not None:
        return f"{source} is not above {condition.above:g}"
    if condition.opens:
        return f"the events of {source} say that it is over or has not begun"
    return f"{source} is zero or not known yet"
