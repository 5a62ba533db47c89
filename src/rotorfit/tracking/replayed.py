"""A recorded flight, tracked as if it were live: what was known at each second."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from rotorfit.core.flight_data import Flight, Note, Segment
from rotorfit.core.laws import AVERAGED
from rotorfit.core.tracked import Alarm, Track, Tracked
from rotorfit.tracking.change_watch import GLANCE
from rotorfit.tracking.earlier import Earlier, check_earlier
from rotorfit.tracking.flight_so_far import NOTES, SHORTEST, parts_without
from rotorfit.tracking.following import EVERY, FALSE_ALARMS_PER_HOUR, Following
from rotorfit.tracking.ground import Ground
from rotorfit.tracking.pose_watch import PoseWatch

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
    watch, jumped, wild, seen = PoseWatch(), list[Alarm](), set[float](), 0.0
    for part, now in growing(flight, following.next_look, GLANCE):
        jumped += _watched(ground, watch, part, seen, wild)
        seen = now
        learnt = _in_flight(_without_poses(part, wild), ground.landed(now), watch.jumps)
        if state := following.follow(learnt, now, ground.touches, tuple(jumped)):
            states.append(state)
            jumped = []
            on_state(states[-1])
        if stopped():
            flight = part
            break
    end = flight.segments[-1].end
    learnt = _in_flight(_without_poses(flight, wild), ground.landed(end), watch.jumps)
    last, regimes = following.finish(learnt, end, tuple(jumped))
    on_state(last)
    return Track((*states, last), regimes)


def _watched(ground: Ground, watch: PoseWatch, part: Flight, since: float, wild: set[float]) -> list[Alarm]:
    """Feeds the commands and poses after an instant [s], in the order of their times; the alarms of poses that jumped.

    Reading a log drops poses that repeat: they raise no alarm here. `wild` holds the times of the poses that do not
    count so far, and is updated.
    """
    commands, poses = (int(np.searchsorted(t, since, side="right")) for t in (part.command_time, part.pose_time))
    sent = list(zip(part.command_time[commands:], part.command[commands:].tolist(), strict=True))
    pose, alarms = np.column_stack([part.position, part.yaw]), []
    for time, one in zip(part.pose_time[poses:].tolist(), pose[poses:], strict=True):
        while sent and sent[0][0] <= time:
            ground.command(*sent.pop(0))
        seen = watch.take(time, one, ground.stands)
        if seen.left_out == "wild_poses":
            wild.add(time)
        wild.difference_update(at for at, _ in seen.believed)
        if seen.alarm and seen.alarm.cause == "pose_jumped":
            alarms.append(seen.alarm)
            ground.jumped(float(seen.believed[0][1][2]))
        for believed in seen.believed:
            ground.pose(*believed)
    for command in sent:
        ground.command(*command)
    return alarms


def _without_poses(flight: Flight, times: set[float]) -> Flight:
    """The flight without its poses at these times, which a note counts."""
    if not times:
        return flight
    at = np.searchsorted(flight.pose_time, sorted(times))
    note = Note("wild_poses", f"{at.size} {NOTES['wild_poses']}", at.size)
    return replace(
        flight,
        pose_time=np.delete(flight.pose_time, at),
        position=np.delete(flight.position, at, axis=0),
        yaw=np.delete(flight.yaw, at),
        notes=(*flight.notes, note),
    )


def _in_flight(flight: Flight, landed: Sequence[tuple[float, float]], jumps: Sequence[float]) -> Flight:
    """The flight without the intervals in which it had landed [s], and split where the pose jumped [s].

    No motion leads from before a jump to after it. Other rests stay, as in the fit of a log: it may have hovered. All
    of it stays where it had landed before the first command.
    """
    if not landed and not jumps:
        return flight
    parts = parts_without(((part.start, part.end) for part in flight.segments), landed, jumps)
    seen = [part for part in parts if part.end - part.start > SHORTEST]
    notes = [Note("landed", f"{len(landed)} {NOTES['landed']}", len(landed))] if landed else []
    return replace(flight, segments=tuple(seen), notes=(*flight.notes, *notes)) if seen else flight


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
