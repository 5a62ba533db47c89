"""A recorded flight, tracked as if it were live: what was known at each second."""

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from rotorfit.core.flight_data import Flight, Segment
from rotorfit.core.frozen import with_frozen
from rotorfit.core.laws import AVERAGED
from rotorfit.core.model import with_findings
from rotorfit.core.tracked import Track, Tracked
from rotorfit.tracking.earlier import Earlier, check_earlier
from rotorfit.tracking.following import EVERY, FALSE_ALARMS_PER_HOUR, GLANCE, Following
from rotorfit.tracking.ground import Ground

OnState = Callable[[Tracked], None]

Stopped = Callable[[], object]


def tracked(
    flight: Flight,
    structure: str = AVERAGED,
    false_alarms_per_hour: float = FALSE_ALARMS_PER_HOUR,
    on_state: OnState = lambda _state: None,
    earlier: Earlier | None = None,
    stopped: Stopped = lambda: False,
    tuned: bool = False,
) -> Track:
    """Tracks a recorded flight.

    Args:
        flight: The whole flight; each look sees only what had arrived by then.
        structure: Model structure, as `fit` takes it.
        false_alarms_per_hour: Promised bound on their expected number [1/h].
        on_state: Called with each state as it is made.
        earlier: The model of an earlier flight; None if there is none.
        stopped: Called after each look and glance; if it returns true, the flight ends there.
        tuned: As for `Following`.

    Returns:
        All states, the last one after a final fit, and the regimes; their models carry the findings about the data.

    Raises:
        CardError: The commands of the earlier model have another meaning.
    """
    if earlier:
        check_earlier(earlier, flight.card)
    following, ground, states = Following(structure, false_alarms_per_hour, earlier, tuned), Ground(), []
    seen = 0.0
    for part, now in growing(flight, following.next_look, GLANCE):
        _stand_on(ground, part, seen)
        seen = now
        if state := following.follow(part, now, ground.stands):
            states.append(state)
            on_state(state)
        if stopped():
            flight = part
            break
    last, regimes = following.finish(flight, flight.segments[-1].end)
    on_state(last)
    regimes = tuple(
        replace(one, model=one.model and with_frozen(with_findings(one.model, (*flight.findings, *one.model.findings))))
        for one in regimes
    )
    return Track((*states, last), regimes)


def _stand_on(ground: Ground, part: Flight, since: float) -> None:
    """Feeds `ground` the commands and poses after an instant [s], in the order of their times."""
    commands, poses = (int(np.searchsorted(t, since, side="right")) for t in (part.command_time, part.pose_time))
    sent = list(zip(part.command_time[commands:], part.command[commands:].tolist(), strict=True))
    pose = np.column_stack([part.position, part.yaw])
    for time, one in zip(part.pose_time[poses:], pose[poses:], strict=True):
        while sent and sent[0][0] <= time:
            ground.command(*sent.pop(0))
        ground.pose(float(time), one)
    for command in sent:
        ground.command(*command)


def growing(flight: Flight, begin: float, every: float = EVERY) -> Iterator[tuple[Flight, float]]:
    """The flight up to each instant from `begin` [s] on, `every` [s], with that instant [s]."""
    end = flight.segments[-1].end
    for now in np.arange(begin, end, every):
        if any(part.start < now for part in flight.segments):
            yield until(flight, float(now)), float(now)


def until(flight: Flight, now: float) -> Flight:
    """The part of a flight that had arrived by an instant [s]."""
    commands, poses = (int(np.searchsorted(t, now, side="right")) for t in (flight.command_time, flight.pose_time))
    return replace(
        flight,
        span=(flight.span[0], min(flight.span[1], now)),
        command_time=flight.command_time[:commands],
        command=flight.command[:commands],
        pose_time=flight.pose_time[:poses],
        position=flight.position[:poses],
        yaw=flight.yaw[:poses],
        segments=tuple(Segment(part.start, min(part.end, now)) for part in flight.segments if part.start < now),
        reference=None if flight.reference is None else flight.reference[:commands],
        velocity=None if flight.velocity is None else flight.velocity.between(-np.inf, now),
    )
