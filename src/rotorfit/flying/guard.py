"""Guard: decides when a flight must end. Pure functions: the watched state of the vehicle, and one verdict on it.

The fence takes the braking distance into account. A vehicle at p with velocity v that is told to stop now comes to rest
near

    p + v t + v |v| / (2 a)

with t the time until the command acts and a the believed deceleration. The flight ends when that point leaves the box.
The velocity comes from filtered differences of the measured poses; a pose that cannot be true (markers swapped) is left
out, and several of them in a row end the flight.

Braking: stops a vehicle that coasts on a command of zero, using its measured velocity.

A tilt of zero does not stop a multirotor. Some autopilots then hover by themselves; for the others

    u = -k (v + g sum of u on the way x period) / g          on the axes that coast, heading frame

with g the believed acceleration per command. The sum is the change of speed by commands that have not acted yet;
without it the delay would make the vehicle oscillate. Source: O. J. M. Smith, "Closer control of loops with dead time",
Chemical Engineering Progress 53 (1957), 217-219.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

from rotorfit.core.flight_plan import Four, Plan
from rotorfit.core.frames import AXES
from rotorfit.core.limits import meaning_of
from rotorfit.core.log import Sample
from rotorfit.files.cards import card_from_mapping
from rotorfit.planning.plan_control import Tracker, full_scale
from rotorfit.planning.stopping import FILTER, SERVO, SHARE, UNKNOWN_DELAY, Three, braking_of

Code = Literal[
    "fence", "speed", "climb", "pose_lost", "link_lost", "pose_frozen", "pose_jumps", "battery", "too_long", "starved"
]

SPARE = 120.0
"""How much longer than its plan a flight may last, for the approach [s]."""

JUMP, TURN = 0.2, 0.6
"""Largest deviation of a pose from its prediction [m, rad], beyond what the vehicle can do in the meantime."""

TURN_RATE = 6.0
"""Bound on the yaw rate of the vehicles [rad/s]."""

STEPPED = 1.0
"""Time by which the stamps run ahead of the arrivals of poses if their clock was set [s]."""

UNSEEN = 0.03
"""Time for which a vehicle may have been unseen beyond that since the last pose that arrived, doubted ones included:
jitter of their arrival [s]."""

SUSPECT = 5.0
"""Number of impossible poses in a row that ends a flight; each plausible one between them subtracts 0.1."""


@dataclass(frozen=True)
class Limits:
    """The limits of a flight.

    Attributes:
        lower: Lower corner of the box, world x, y, z [m].
        upper: Upper corner [m].
        speed: Largest horizontal speed [m/s].
        climb: Largest vertical speed [m/s].
        reaction: Time from an order to stop until it acts, along x, y, z: delay, lag of a velocity loop, and lag of
            the guard's velocity [s].
        deceleration: Deceleration after that, along x, y, z [m/s^2]; inf if the lag accounts for all of it.
        duration: Longest flight [s].
        pose_age: Longest time without a pose [s].
        frozen: Longest time in which a pose repeats while the vehicle is asked to move [s].
        battery: Least charge, 0 to 1.
        starved: Number of late commands that ends a flight.
        overdue: Delay of a single command that ends a flight [s].
    """

    lower: Three
    upper: Three
    speed: float
    climb: float
    reaction: Three
    deceleration: Three
    duration: float
    pose_age: float = 0.5
    frozen: float = 1.0
    battery: float = 0.15
    starved: int = 20
    overdue: float = 0.5


@dataclass(frozen=True)
class Watch:
    """What is known of the vehicle; times by the link's clock [ns].

    Attributes:
        pose: The last plausible pose: world x, y, z [m] and unwrapped yaw [rad]; None before the first.
        velocity: From filtered differences, world [m/s, rad/s].
        stamp: Stamp of `pose` by the sender's clock [ns].
        received: Arrival of `pose`; repetitions do not count.
        heard: Arrival of the last pose, plausible or not, new or not.
        heard_other: Arrival of the last other sample; None before the first.
        raw: The last pose as it came.
        battery: Charge, 0 to 1; None if unknown.
        suspicion: Count of impossible poses, see `SUSPECT`.
        outliers: Total number of impossible poses.
        behind: How far the stamp of the last pose lies before `stamp` [ns].
    """

    pose: Four | None = None
    velocity: Four = (0.0, 0.0, 0.0, 0.0)
    stamp: int = 0
    received: int = 0
    heard: int = 0
    heard_other: int | None = None
    raw: tuple[float, ...] = ()
    battery: float | None = None
    suspicion: float = 0.0
    outliers: int = 0
    behind: int = 0


@dataclass(frozen=True)
class GuardVerdict:
    """Why a flight ends: a code, and a text for the user."""

    code: Code
    text: str


def limits_of(plan: Plan) -> Limits:
    """The limits of a plan, with the braking to be expected from its belief, or else from its card.

    Raises:
        CardError: The plan's card is wrong.
    """
    space = plan.space
    return Limits(space.lower, space.upper, space.speed, space.climb, *braking_of(plan), plan.duration + SPARE)


def observed(watch: Watch, sample: Sample, limits: Limits) -> tuple[Watch, bool]:
    """Takes in a sample.

    Args:
        watch: The watch before it.
        sample: A sample of the stream `pose`, `velocity`, `battery` or `said`; of no other.
        limits: The limits; their speeds bound how far the vehicle can have moved.

    Returns:
        The watch after it, and whether the sample was a new, plausible pose.
    """
    if sample.stream == "battery":
        charge = sample.values[0] if math.isfinite(sample.values[0]) else watch.battery
        return replace(watch, battery=charge, heard_other=sample.received), False
    if sample.stream in ("velocity", "said"):
        return replace(watch, heard_other=sample.received), False
    if sample.values == watch.raw or (watch.pose is not None and sample.stamp <= watch.stamp):
        return replace(watch, heard=sample.received, behind=max(0, watch.stamp - sample.stamp)), False
    here = _pose(sample.values, watch.pose)
    if here is None:
        return _doubted(watch, sample), False
    if watch.pose is None:
        return _seen(watch, sample, here, watch.velocity, watch.suspicion), True
    since = (sample.stamp - watch.stamp) / 1e9
    if since > (elapsed := (sample.received - watch.received) / 1e9) + STEPPED:
        since = elapsed
    ahead = [new - old - v * since for new, old, v in zip(here, watch.pose, watch.velocity, strict=True)]
    unseen = min(since, (sample.received - watch.heard) / 1e9 + UNSEEN)  # doubted poses show the vehicle elsewhere
    reach = JUMP + 2 * (limits.speed + limits.climb) * unseen
    if math.hypot(*ahead[:3]) > reach or abs(ahead[3]) > TURN + TURN_RATE * unseen:
        return _doubted(watch, sample), False
    share = 1 / (FILTER + since)
    vx, vy, vz, turning = (v + share * off for v, off in zip(watch.velocity, ahead, strict=True))
    velocity, suspicion = (vx, vy, vz, turning), max(0.0, watch.suspicion - 0.1)
    return _seen(watch, sample, here, velocity, suspicion), True


def _seen(watch: Watch, sample: Sample, here: Four, velocity: Four, suspicion: float) -> Watch:
    """The watch after a plausible pose. Written out: it runs at every pose, and `replace` takes three times as long."""
    received = sample.received
    return Watch(
        here, velocity, sample.stamp, received, received, watch.heard_other, sample.values, watch.battery,
        suspicion, watch.outliers,
    )  # fmt: skip


def _doubted(watch: Watch, sample: Sample) -> Watch:
    doubts = replace(watch, suspicion=watch.suspicion + 1, outliers=watch.outliers + 1)
    return replace(doubts, raw=sample.values, heard=sample.received)


def _pose(values: Sequence[float], before: Four | None) -> Four | None:
    """x, y, z and unwrapped yaw from x, y, z and a quaternion w, x, y, z; None if they are not a pose."""
    x, y, z, qw, qx, qy, qz = values
    if not (math.isfinite(x + y + z + qw + qx + qy + qz) and (qw or qx or qy or qz)):
        return None
    yaw = math.atan2(2 * (qw * qz + qx * qy), qw * qw + qx * qx - qy * qy - qz * qz)
    if before is not None:
        yaw += math.tau * round((before[3] - yaw) / math.tau)
    return x, y, z, yaw


def stop_point(watch: Watch, limits: Limits, now: int) -> Three | None:
    """Where the vehicle would come to rest if told to stop now, world x, y, z [m]; None before the first pose."""
    if watch.pose is None:
        return None
    age = max(0, now - watch.received) / 1e9
    x, y, z = (
        watch.pose[k] + v * (age + limits.reaction[k]) + v * abs(v) / (2 * limits.deceleration[k])
        for k, v in enumerate(watch.velocity[:3])
    )
    return x, y, z


def room_left(watch: Watch, limits: Limits, now: int) -> float:
    """Least distance of the vehicle and of its stop point to a wall [m]; negative outside, infinite before a pose."""
    stop = stop_point(watch, limits, now)
    if stop is None or watch.pose is None:
        return math.inf
    walls = zip(watch.pose, stop, limits.lower, limits.upper, strict=False)
    return min(min(p - low, s - low, high - p, high - s) for p, s, low, high in walls)


def judged(watch: Watch, limits: Limits, now: int, flown: float, moving: float) -> GuardVerdict | None:
    """Whether a flight must end.

    Args:
        watch: What is known of the vehicle.
        limits: The limits of the flight.
        now: Time by the link's clock [ns].
        flown: Time since the flight began [s].
        moving: How long the vehicle has been asked to move without a pause [s].

    Returns:
        The most serious reason to end the flight, or None.
    """
    if (verdict := _of_pose(watch, limits, now, moving)) is not None:
        return verdict
    if room_left(watch, limits, now) < 0:
        return GuardVerdict("fence", f"the fence: {_where(watch, limits, now)}")
    speed, climb = math.hypot(watch.velocity[0], watch.velocity[1]), abs(watch.velocity[2])
    if speed > limits.speed:
        return GuardVerdict("speed", f"too fast: {speed:.2f} m/s, the limit is {limits.speed:g} m/s")
    if climb > limits.climb:
        return GuardVerdict("climb", f"too fast: {climb:.2f} m/s along z, the limit is {limits.climb:g} m/s")
    if watch.battery is not None and watch.battery < limits.battery:
        return GuardVerdict("battery", f"the battery: {watch.battery:.0%} left, the limit is {limits.battery:.0%}")
    if flown > limits.duration:
        return GuardVerdict("too_long", f"too long: {flown:.0f} s, the limit is {limits.duration:.0f} s")
    return None


def _of_pose(watch: Watch, limits: Limits, now: int, moving: float) -> GuardVerdict | None:
    """The verdict on the poses; None if nothing is wrong with them."""
    age, silent = (now - watch.received) / 1e9, (now - watch.heard) / 1e9
    if silent > limits.pose_age:
        others = watch.heard_other
        if others is not None and (now - others) / 1e9 > 2 * limits.pose_age:
            return GuardVerdict("link_lost", f"the link: nothing has come for {silent:.2f} s")
        return GuardVerdict("pose_lost", f"the pose is lost: none for {silent:.2f} s")
    if watch.suspicion >= SUSPECT:
        return GuardVerdict(
            "pose_jumps", f"the pose jumps: {watch.outliers} poses cannot be true (are markers swapped?)"
        )
    if age > limits.frozen and moving > limits.frozen:
        text = f"the pose is frozen: it has repeated for {age:.2f} s while commands were sent"
        if watch.behind:
            text = f"the clock of the poses jumped back by {watch.behind / 1e9:.2f} s: none is newer for {age:.2f} s"
        return GuardVerdict("pose_frozen", text)
    return None


def _where(watch: Watch, limits: Limits, now: int) -> str:
    """The wall that is nearest or crossed, with position, velocity and stop point along its axis, in words."""
    stop = stop_point(watch, limits, now)
    assert stop is not None
    assert watch.pose is not None
    worst = min(
        (sign * (wall - at), axis, sign, k)
        for k, axis in enumerate("xyz")
        for sign, wall in ((1, limits.upper[k]), (-1, limits.lower[k]))
        for at in (watch.pose[k], stop[k])
    )
    _, axis, sign, k = worst
    wall = limits.upper[k] if sign > 0 else limits.lower[k]
    return (
        f"{axis} is {watch.pose[k]:.2f} m at {watch.velocity[k]:+.2f} m/s and would stop at {stop[k]:.2f} m; "
        f"the wall is at {wall:g} m"
    )


GAIN = 3.0
"""Commanded deceleration over speed [1/s]."""

Waiting = tuple[tuple[float, ...], ...]
"""For each axis, the commands that were sent and do not act yet, the oldest first."""


@dataclass(frozen=True)
class Coasting:
    """An axis on which a command of zero does not stop the vehicle.

    Attributes:
        place: 0 for x, 1 for y.
        gain: Believed acceleration per command [m/s^2].
        largest: Largest command for braking, the one on which the guard's braking distance is based.
        delay: Believed delay of a command [s].
    """

    place: int
    gain: float
    largest: float
    delay: float


def coasting_axes(tracker: Tracker) -> tuple[Coasting, ...]:
    """The axes that are braked actively: those commanded by tilt, unless the belief has `brakes_on_zero`.

    Without a believed gain there are none: the vehicle is only sent zero.
    """
    belief = tracker.plan.belief
    if "gamma" not in belief or belief.get("brakes_on_zero"):
        return ()
    card = card_from_mapping(tracker.plan.card, f"of plan {tracker.plan.name}")
    delay = belief.get("delay", (UNKNOWN_DELAY,) * 4)
    return tuple(
        Coasting(place, float(tracker.gamma[2 * place]), SHARE * min(full_scale(card, axis), 1.0), float(delay[place]))
        for place, axis in enumerate(AXES[:2])
        if meaning_of(card, axis).asked == "tilt" and tracker.gamma[2 * place + 1] < SERVO
    )


def nothing_on_the_way(axes: Sequence[Coasting], period: float) -> Waiting:
    """The waiting commands before the first, for one command every `period` [s]: all zero."""
    return tuple((0.0,) * max(1, round(axis.delay / period)) for axis in axes)


def braking(
    axes: Sequence[Coasting], waiting: Waiting, pose: Four, velocity: Four, period: float
) -> tuple[Four, Waiting]:
    """The command that brakes now.

    Args:
        axes: The coasting axes.
        waiting: The commands that do not act yet.
        pose: Measured pose, world [m, rad].
        velocity: Measured velocity, world [m/s, rad/s].
        period: Time between commands [s].

    Returns:
        Forward, left, 0, 0 in the heading frame; and the commands that do not act yet, including this one.
    """
    c, s = math.cos(pose[3]), math.sin(pose[3])
    heading = (c * velocity[0] + s * velocity[1], c * velocity[1] - s * velocity[0])
    command = [0.0, 0.0]
    for axis, sent in zip(axes, waiting, strict=True):
        ahead = heading[axis.place] + axis.gain * sum(sent) * period
        command[axis.place] = max(-axis.largest, min(axis.largest, -GAIN * ahead / axis.gain))
    then = tuple((*sent[1:], command[axis.place]) for axis, sent in zip(axes, waiting, strict=True))
    return (command[0], command[1], 0.0, 0.0), then
