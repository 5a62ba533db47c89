"""Preflight: the checks before a vehicle moves. All failures are reported together."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rotorfit.core.card import Card
from rotorfit.core.errors import LinkError
from rotorfit.core.flight_plan import Plan, command_at, reference_at
from rotorfit.core.frames import AXES
from rotorfit.core.limits import disagreement, expectation, meaning_of
from rotorfit.core.log import Sample
from rotorfit.files.cards import card_from_mapping
from rotorfit.files.plans import plan_from_mapping, plan_mapping
from rotorfit.flying.guard import Limits, Watch, judged, limits_of, observed, room_left
from rotorfit.flying.links.link import Link
from rotorfit.planning.belief import belief_from_mapping
from rotorfit.planning.plan_control import largest_command, tracker_of
from rotorfit.planning.precision import fly_plan, path
from rotorfit.planning.run_on import run_on
from rotorfit.simulation.paper_vehicle import noise_free

LISTENING = 1.0
"""How long the link is listened to [s]."""

SLOWEST = 8.0
"""Least rate of poses [1/s]; a Tello gives ten, of which one may come late."""

NEAR, TURNED = 0.3, math.radians(20)
"""Largest distance [m] and heading error [rad] from the plan's start at which no approach is needed."""

REST = 0.3
"""Largest speed of a vehicle that counts as hovering [m/s]."""

CHARGE = 0.30
"""Least charge of the battery before a flight, 0 to 1."""

ONE_CLOCK = (-0.002, 0.2)
"""Plausible times from stamp to arrival of a pose if sender and receiver share a clock [s]."""


@dataclass(frozen=True)
class Check:
    """One check: its name, whether it passed, and a text with the measured figure."""

    name: str
    ok: bool
    text: str


@dataclass(frozen=True)
class Ready:
    """The result of a preflight.

    Attributes:
        checks: In the order in which they were made.
        pose_clock: Column of the recording that times the poses: `header.stamp`, or `log_time` if the sender's clock
            is not the link's.
        pose_error: Half the 95 % interval of what all stamps of the poses may be off by [s]; 0 if unknown.
        notes: What a user should know although it does not prevent the flight.
    """

    checks: tuple[Check, ...]
    pose_clock: str
    pose_error: float = 0.0
    notes: tuple[str, ...] = ()


def preflight(plan: Plan, link: Link, card: Card | None = None, take_off: bool = False) -> Ready:
    """Listens to a link and checks it and a plan.

    Args:
        plan: The plan that will be flown.
        link: The open link; nothing is sent on it.
        card: The vehicle's settings now; None if they are those of the plan.
        take_off: Whether the flight begins on the floor.

    Raises:
        LinkError: The link is gone.
        CardError: The plan's card is wrong.
        PlanError: The plan has an impossible number.
    """
    plan_from_mapping(plan_mapping(plan), plan.name)  # a plan made in memory is checked as one from a file
    limits, samples, watch = limits_of(plan), [], Watch()
    until = link.now + round(LISTENING * 1e9)
    while (now := link.now) < until:
        for sample in link.receive(min(until, now + 20_000_000)):
            watch = observed(watch, sample, limits)[0]
            samples.append(sample)
    poses = [sample for sample in samples if sample.stream == "pose"]
    checks = [Check("link", bool(samples), f"{len(samples)} samples came in {LISTENING:g} s"), _rate(poses)]
    if watch.pose is not None:
        checks += [_inside(watch, limits, link.now, take_off), _start(plan, watch, take_off), _still(watch)]
    checks.append(_battery(watch))
    if card is not None:
        trouble = disagreement(card_from_mapping(plan.card, f"of plan {plan.name}"), card)
        checks.append(Check("card", not trouble, trouble or f"as planned: {card.name}"))
    checks.append(_sense(plan, limits))
    checks += _silent(plan, link)
    checks += _rehearsed(plan, limits)
    clock, notes = _clock(poses)
    stated = (card or card_from_mapping(plan.card, f"of plan {plan.name}")).pose_time.error
    error = max(stated, poses[-1].error) if poses and clock == "header.stamp" else 0.0
    said = dict.fromkeys(sample.text for sample in samples if sample.text)
    return Ready(tuple(checks), clock, error, (*notes, *said))


def refuse(ready: Ready) -> None:
    """Refuses a flight whose preflight failed.

    Raises:
        LinkError: A check failed; one line names all that did.
    """
    wrong = [f"{check.name}: {check.text}" for check in ready.checks if not check.ok]
    if wrong:
        raise LinkError(f"not flown: {'; '.join(wrong)}")


def from_start(plan: Plan, watch: Watch) -> tuple[float, float]:
    """Distance to the plan's start [m], and angle to its heading [rad]; infinite before the first pose."""
    if watch.pose is None:
        return math.inf, math.inf
    start = plan.space.start
    return math.dist(watch.pose[:3], start[:3]), abs(math.remainder(watch.pose[3] - start[3], math.tau))


def can_approach(plan: Plan) -> bool:
    """Whether the vehicle can be led to the start: the plan has feedback, or a believed gain and damping."""
    return plan.feedback is not None or "gamma" in plan.belief


def _rate(poses: Sequence[Sample]) -> Check:
    if not poses:
        return Check("pose", False, "none came; is the motion capture on, and the body in sight?")
    values = {pose.values for pose in poses}
    rate = len(poses) / LISTENING
    text = f"{rate:.0f} a second, {100 * (1 - len(values) / len(poses)):.0f} % repeated"
    if error := poses[-1].error:
        text += f", when to {1e3 * error:.1f} ms"
    if rate < SLOWEST:
        return Check("pose", False, f"{text}; at least {SLOWEST:g} a second are needed")
    return Check("pose", True, text)


def _inside(watch: Watch, limits: Limits, now: int, take_off: bool) -> Check:
    assert watch.pose is not None
    kept = replace(limits, lower=(*limits.lower[:2], -math.inf)) if take_off else limits
    left = room_left(watch, kept, now)
    place = ", ".join(f"{value:.2f}" for value in watch.pose[:3])
    if left < 0:
        low, high = (", ".join(f"{value:.2f}" for value in corner) for corner in (limits.lower, limits.upper))
        under = " or the room below it" if take_off else ""
        return Check("box", False, f"the vehicle is at ({place}) m, outside of the box ({low}) to ({high}){under}")
    to = "to the nearest side or top of the box, which it enters from below" if take_off else "from the fence"
    return Check("box", True, f"at ({place}) m, {left:.2f} m {to}")


def _start(plan: Plan, watch: Watch, take_off: bool) -> Check:
    distance, angle = from_start(plan, watch)
    text = f"{distance:.2f} m and {math.degrees(angle):.0f} deg from the plan's start"
    if take_off:
        return Check("start", True, f"{text}, before take-off")
    if distance <= NEAR and angle <= TURNED:
        return Check("start", True, text)
    if can_approach(plan):
        return Check("start", True, f"{text}: it is led there slowly first")
    return Check(
        "start", False, f"{text}; bring it within {NEAR:g} m and {math.degrees(TURNED):.0f} deg, or plan with feedback"
    )


def _still(watch: Watch) -> Check:
    speed = math.hypot(*watch.velocity[:3])
    text = f"{speed:.2f} m/s"
    more = f" over the ground, not below {REST:g} m/s: bring it to rest; does the wind carry it away?"
    return Check("rest", speed <= REST, text if speed <= REST else text + more)


def _battery(watch: Watch) -> Check:
    if watch.battery is None:
        return Check("battery", True, f"unknown: no battery report within {LISTENING:g} s; check it yourself")
    text = f"{watch.battery:.0%} left"
    ok = watch.battery >= CHARGE
    return Check("battery", ok, text if ok else f"{text}; at least {CHARGE:.0%} are needed")


def _rehearsed(plan: Plan, limits: Limits) -> list[Check]:
    """Whether the plan stays in its space: as predicted when it was made, and for the likeliest vehicle now.

    The plan may have been edited, so it is simulated again under this guard; `rotorfit plan` has simulated vehicles
    drawn from the belief. Without a belief the second check is left out.
    """
    leaving, allowed = plan.predicted.get("leaving", 0.0), plan.predicted.get("allowed", 1.0)
    if leaving > allowed:
        text = f"{leaving:.0%} of the vehicles that are believed possible leave its space; plan it again"
        return [Check("plan", False, text)]
    if "covariance" not in plan.belief:
        return []
    truth = noise_free(belief_from_mapping(plan.belief, f"plan {plan.name}").truth)
    flight = fly_plan(tracker_of(plan), truth, plan.seed)
    watch = Watch(heard_other=0)
    for time, pose, velocity in zip(
        flight.pose_stamp.tolist(), path(plan, flight).tolist(), flight.velocity.tolist(), strict=True
    ):
        watch = replace(watch, pose=tuple(pose), velocity=tuple(velocity), received=time, heard=time)
        if (verdict := judged(watch, limits, time, 0.0, 0.0)) is not None:
            text = (
                f"the likeliest vehicle would be stopped after {time / 1e9:.1f} s by {verdict.text}; "
                "plan it again with a lower --speed or --amplitude"
            )
            return [Check("plan", False, text)]
    return [Check("plan", True, "the likeliest vehicle stays inside, braking distance included")]


BEHIND = 0.5
"""Free space that users must keep around the box, see docs/flying.md [m]."""


def _silent(plan: Plan, link: Link) -> list[Check]:
    """How far the vehicle runs on when commands stop, as when this program or its computer dies.

    It must come to rest within `BEHIND` of the box if a parameter of the vehicle can ensure that. No check without a
    belief in the plan, or if the vehicle's behaviour is unknown.
    """
    goes_on, parameter = link.silence.goes_on, link.silence.parameter
    if goes_on is None or "covariance" not in plan.belief:
        return []
    far = run_on(plan, goes_on)
    ok = far.outside <= BEHIND or not (link.live and parameter)
    text = (
        f"when they stop at the worst instant, the vehicle follows the last command for {goes_on:g} s and comes to "
        f"rest {far.sideways:.1f} m sideways and {far.upright:.1f} m up or down from there, "
        + (f"{far.outside:.1f} m outside of the box (at {far.instant:.1f} s)" if far.outside else "inside of the box")
    )
    if far.outside:
        text += f"; {parameter} of the autopilot shortens it" if parameter else "; keep that room free"
    return [Check("commands", ok, text if ok else f"{text}, or give a smaller --amplitude or a larger box")]


BELIEVABLE = 5.0
"""Largest factor between the believed effect of a full tilt and the one expected from the card's limit."""

BEYOND = 5.0
"""Largest command of a plan, over full scale: small excess is clipped, but such a plan would mostly be."""


def _sense(plan: Plan, limits: Limits) -> Check:
    """Whether the numbers of the plan suit the room and the vehicle, so that the guard is effective."""
    wrong = [*_beyond_the_room(plan, limits), *_beyond_the_vehicle(plan)]
    return Check("numbers", not wrong, "; ".join(wrong) or "within what the room and the vehicle allow")


def _beyond_the_room(plan: Plan, limits: Limits) -> Iterator[str]:
    """Speed limits from which the vehicle cannot stop within its box, and references outside the box."""
    space = plan.space
    sides = [high - low for low, high in zip(space.lower, space.upper, strict=True)]
    flat = ("speed", space.speed, math.hypot(*sides[:2]), (0, 1))
    for name, speed, room, axes in (flat, ("climb", space.climb, sides[2], (2,))):
        way = max(speed * limits.reaction[k] + speed**2 / (2 * limits.deceleration[k]) for k in axes)
        if way > room:
            yield f"{name} {speed:g} m/s: stopping from there takes {way:.1f} m, and the box has {room:.1f} m"
    t = np.arange(0.0, plan.duration, max(1 / plan.rate, 0.02))
    far = np.abs(reference_at(plan, t)[0]).max(axis=0, initial=0.0)
    if math.hypot(*far[:2]) > math.hypot(*sides[:2]) or far[2] > sides[2]:
        yield f"references of {far[0]:.1f}, {far[1]:.1f}, {far[2]:.1f} m from the start lie outside of the box"


def _beyond_the_vehicle(plan: Plan) -> Iterator[str]:
    """Commands far beyond full scale, and a belief that the card contradicts."""
    card = card_from_mapping(plan.card, f"of plan {plan.name}")
    t = np.arange(0.0, plan.duration, 1 / plan.rate)
    most = np.abs(command_at(plan, t)).max(axis=0, initial=0.0)
    for a, axis in enumerate(AXES):
        scale = largest_command(card, axis)
        if most[a] > BEYOND * scale:
            yield f"a command of {most[a]:.3g} on {axis} is far beyond full scale, {scale:.3g}"
        meaning = meaning_of(card, axis)
        expected = expectation(meaning) if meaning.asked == "tilt" and "gamma" in plan.belief else None
        if expected:
            believed = abs(float(plan.belief["gamma"][2 * a])) / expected
            if not 1 / BELIEVABLE <= believed <= BELIEVABLE:
                yield f"a full tilt on {axis} is believed to do {believed:.2g} times what the card's limit makes it"


def _clock(poses: Sequence[Sample]) -> tuple[str, tuple[str, ...]]:
    """The column that times the poses in the recording, and a note if it is not their stamp."""
    if not poses:
        return "header.stamp", ()
    least = float(np.min([pose.received - pose.stamp for pose in poses])) / 1e9
    if ONE_CLOCK[0] <= least <= ONE_CLOCK[1]:
        return "header.stamp", ()
    return "log_time", (
        f"the poses' clock is {-least:+.3f} s from the link's: poses are timed by their arrival, and the delay that is "
        "fitted holds their way",
    )
