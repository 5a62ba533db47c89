"""Fly: executes a plan over a link, under guard, and records it. One loop for simulated and real time.

take-off (if asked) -> hover (until the vehicle obeys commands) -> approach (if the start is not near) -> the plan
-> hover -> landing (if asked)

Whatever ends a flight, the first command sent is zero: hover.
"""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from rotorfit.core.errors import LinkError
from rotorfit.core.flight_plan import Ending, Flown, Four, Jitter, Plan, Status
from rotorfit.core.frames import AXES
from rotorfit.files.cards import card_from_mapping
from rotorfit.flying.approach import approach, led, measured
from rotorfit.flying.guard import (
    Coasting,
    GuardVerdict,
    Limits,
    Watch,
    braking,
    coasting_axes,
    judged,
    limits_of,
    nothing_on_the_way,
    observed,
    room_left,
)
from rotorfit.flying.links.link import Link
from rotorfit.flying.operator import Abort, hurried
from rotorfit.flying.preflight import NEAR, TURNED, can_approach, from_start
from rotorfit.flying.recorder import Recorder
from rotorfit.planning.plan_control import begin, instants, largest_command, obeyed, tracker_of
from rotorfit.planning.plan_control import observed as tracked

OnStatus = Callable[["Status"], None]

HOVER: Four = (0.0, 0.0, 0.0, 0.0)

HOVERING = 1.0
"""How long hover is sent at the end [s]."""

WATCHING = 3.0
"""How long a landing is recorded [s]."""

ARRIVED, RESTING = 0.1, 0.5
"""Distance to the start at which an approach ends [m], and time that the vehicle must rest there [s]."""

SETTLING = 45.0
"""How long the vehicle may take to rest at the start once its reference does [s]."""

TAKE_OFF, CLIMBED = 15.0, 0.3
"""Longest take-off [s]; it ends after a second at rest above the floor by more than this height [m]."""

OBEYING, ANSWERING = 10.0, 10.0
"""How long the vehicle may take until it obeys commands, and until it answers the order to land [s]."""

ORDERS = 5
"""How often the order to land is given to a link that does not take it."""

BRAKING, BRAKED = 3.0, 0.1
"""Longest active braking [s], and the speed that ends it [m/s]."""

STALE = 0.15
"""Largest age of a pose that may be used for braking [s]."""

ASKED = 1e-3
"""Commands below this count as zero [unit of the command]."""

LATE = 3.0
"""Delay from which a command counts as late [periods]."""

SLOW, MEMORY = 0.9, 50
"""Share of the planned rate below which a note is made; number of commands over which a rate below half ends the
flight."""

MOST_TEXTS = 20
"""Largest number of different texts of the vehicle in the notes; the recording has all."""

PROGRESS_EVERY = 0.2
"""Time between two reports of progress [s]."""


def fly(
    plan: Plan,
    link: Link,
    recorder: Recorder,
    land: bool = True,
    take_off: bool = False,
    abort: Abort = lambda: "",
    progress: OnStatus | None = None,
) -> Flown:
    """Flies a plan after its preflight.

    Args:
        plan: The plan.
        link: An open link; it is left open.
        recorder: A recorder; it is closed at the end.
        land: Whether the vehicle is asked to land at the end, whatever ended the flight; otherwise it hovers.
        take_off: Whether it is asked to take off first.
        abort: Called once a period; returns what the operator did to end the flight, or an empty string.
        progress: Called a few times a second; it must return at once.

    Returns:
        How the flight ended; by then the vehicle hovers or lands.

    Raises:
        PlanError: The plan cannot be flown: it has feedback but no belief.
        CardError: Its card is wrong.
    """
    flight = _Flight(plan, link, recorder, abort, progress)
    ending, landed = Ending("error", "an error in rotorfit itself"), False
    with hurried(link.live) as note:
        try:
            ending = flight.performed(take_off)
        except LinkError as error:
            ending = Ending("link_lost", str(error))
        except _RefusedError as error:
            ending = Ending("command", str(error))
        except KeyboardInterrupt:
            ending = Ending("operator", "Ctrl-C")
        finally:
            landed = flight.left(ending, land)
    if recorder.fault and ending.reason == "completed":
        ending = Ending("disk", recorder.fault)
    return Flown(
        ending.reason, ending.text, flight.flown, flight.jitter(), flight.late, recorder.commands, recorder.poses,
        flight.watch.outliers, landed, recorder.path, tuple(filter(None, (note, *flight.notes))),
    )  # fmt: skip


class _RefusedError(Exception):
    """A command that is not a number or exceeds full scale; it was not sent."""


class _Flight:
    """The state of a flight, and the steps that change it."""

    def __init__(self, plan: Plan, link: Link, recorder: Recorder, abort: Abort, progress: OnStatus | None) -> None:
        self.plan, self.link, self.recorder = plan, link, recorder
        self.abort, self.progress = abort, progress
        self.limits, self.watch = limits_of(plan), Watch()
        self.tracker, self.tracking = tracker_of(plan), begin(np.zeros(4))
        card = card_from_mapping(plan.card, f"of plan {plan.name}")
        self.most = tuple(largest_command(card, axis) * (1 + 1e-9) for axis in AXES)
        self.period = round(1e9 / plan.rate)
        self.due = link.now
        self.flown, self.late, self.notes = 0.0, 0, list[str]()
        self._lateness: list[int] = []
        self._excess = 0.0  # of the intervals between commands over the period, the latest most [ns]
        self._planned = self._zero = self._stamp = 0  # when the command was due; stamps of first pose, last command
        self._first = self._asked = self._last = self._began = self._progressed = link.now
        self._phase, self._steering = "", False

    def performed(self, take_off: bool) -> Ending:
        """The flight up to its ending."""
        for sample in self.link.receive(self.link.now):  # what arrived before the flight
            self.watch, _ = observed(self.watch, sample, self.limits)
        self._first = self._last = self.due = self.link.now
        self.watch = replace(self.watch, heard=self.due, received=self.due, suspicion=0.0)
        self.recorder.window(self.due, False)
        for part in (*([self._taken_off] if take_off else []), self._obeyed, self._approached, self._excited):
            if (ending := part()) is not None:
                return ending
        return Ending("completed", "completed")

    def left(self, ending: Ending, land: bool) -> bool:
        """Hover, active braking if the vehicle needs it, hover, landing if asked, end of the log; whether it lands."""
        self._phase, self._steering = "", False
        try:
            self._hover(ending)
        finally:  # an error of a driver keeps its trace, and the vehicle lands
            try:
                landed = land and self._land()
            finally:
                self.recorder.close()
        return landed

    def _hover(self, ending: Ending) -> None:
        """Ends the motion of the vehicle, and keeps it where it is for `HOVERING`."""
        try:
            self._try(self._send, HOVER)
        finally:
            self.recorder.window(self._stamp, False)
            self.recorder.event(self._stamp, f"end: {ending.text}")
        if ending.reason not in ("error", "command", "link_lost"):  # braking must not rely on what has just failed
            self._try(self._brake, coasting_axes(self.tracker))
        for _ in range(max(10, round(HOVERING * self.plan.rate))):
            self._try(self._listen)
            self._try(self._send, HOVER)

    def _land(self) -> bool:
        """Asks the vehicle to land, and records its way down; whether it lands."""
        link, ordered = self.link, False
        for _ in range(ORDERS if self.link.live else 1):
            if ordered := self._try(link.act, "land"):
                break
        if not ordered:
            self.notes.append("the link did not take the order to land: land by other means")
            return False
        self.recorder.event(link.now, "landing")
        until, latest = (link.now + round(seconds * 1e9) for seconds in (WATCHING, ANSWERING))
        while link.now < until or (link.undone and link.now < latest):
            if not self._try(self._listen) and not (link.live and link.undone):
                break
        if link.undone:
            self.notes.append(f"the vehicle was asked to land and does not ({link.undone}): land by other means")
        return not link.undone

    def jitter(self) -> Jitter:
        """How late the commands of the flight were."""
        if not self._lateness:
            return Jitter(0.0, 0.0, 0.0)
        p50, p99, most = np.quantile(np.array(self._lateness), [0.5, 0.99, 1.0]) / 1e9
        return Jitter(float(p50), float(p99), float(most))

    # Phases

    def _taken_off(self) -> Ending | None:
        """Take-off; no commands are sent while the vehicle climbs by itself."""
        self._enter("take-off")
        self.link.act("take_off")
        floor, rest = None, 0
        limits = replace(self.limits, lower=(*self.limits.lower[:2], -math.inf), climb=math.inf)
        while rest < self.plan.rate:
            if (ending := self._wait(limits)) is not None:
                return ending
            self._asked = self.link.now
            if self.watch.pose is None:
                continue
            height, speed = self.watch.pose[2], math.hypot(*self.watch.velocity[:3])
            floor = height if floor is None else min(floor, height)
            rest = rest + 1 if height - floor > CLIMBED and speed < 2 * BRAKED else 0
            if self._since() > TAKE_OFF:
                return Ending("take_off", f"the vehicle has not taken off within {TAKE_OFF:g} s")
        return None

    def _obeyed(self) -> Ending | None:
        """Hover, until the vehicle obeys commands; what it does not obey must not be fitted."""
        if self.link.undone:
            self._enter("hover")
        while self.link.undone:
            if (ending := self._wait(self.limits)) is not None:
                return ending
            if self._since() > OBEYING:
                return Ending("not_obeyed", f"the vehicle does not obey commands: {self.link.undone}")
            self._send(HOVER)
        return None

    def _approached(self) -> Ending | None:
        """Leads the vehicle to rest at the plan's start, unless it is near already."""
        while self.watch.pose is None:
            if (ending := self._wait(self.limits)) is not None:
                return ending
        distance, angle = from_start(self.plan, self.watch)
        if distance <= NEAR and angle <= TURNED:
            return None
        if not can_approach(self.plan):
            return Ending(
                "start", f"the vehicle is {distance:.2f} m from the plan's start, and the plan has no feedback"
            )
        self._enter("approach")
        loop, guess = approach(self.plan, np.array(self.watch.pose), np.array(self.watch.velocity))
        seen, rest = self.watch.stamp, 0
        while rest < RESTING * self.plan.rate:
            if (ending := self._wait(self.limits)) is not None:
                return ending
            if self.watch.stamp > seen:
                guess = measured(loop, guess, np.array(self.watch.pose), (self.watch.stamp - seen) / 1e9)
                seen = self.watch.stamp
            since = self._since()
            guess, command = led(loop, guess, since)
            self._send(command.tolist())
            distance, angle = from_start(self.plan, self.watch)
            there = since > loop.duration and distance <= ARRIVED and angle <= TURNED and self._speed() < BRAKED
            rest = rest + 1 if there else 0
            if since > loop.duration + SETTLING:
                return Ending(
                    "start", f"the start was not reached: still {distance:.2f} m away, {self._speed():.2f} m/s"
                )
        return None

    def _excited(self) -> Ending | None:
        """Flies the plan."""
        self._enter("plan")
        self._steer_from_here(self.plan.feedback is not None)
        count = math.ceil(self.plan.duration * self.plan.rate - 1e-9)
        wanted = instants(self.tracker.plan, np.arange(count) / self.plan.rate)
        begun, before = self.due + self.period, len(self._lateness)
        while (number := (self.due + self.period - begun) // self.period) < count:
            if (ending := self._wait(self.limits)) is not None:
                return ending
            number = min((self.due - begun) // self.period, count - 1)
            if not self.flown:
                self.recorder.window(self.link.now, True)
            self.tracking, command = obeyed(self.tracker, self.tracking, wanted[number])
            self._send(command.tolist())
            self.flown = (number + 1) / self.plan.rate
        sent = (len(self._lateness) - before) / self.flown
        if sent < SLOW * self.plan.rate:
            self.notes.append(f"the link took {sent:.0f} commands a second, {self.plan.rate:g} were planned")
        return self._wait(self.limits)

    # Steps

    def _wait(self, limits: Limits) -> Ending | None:
        """Waits for the next instant at which a command is due, takes in the samples until then, and judges."""
        self._planned = self.due = self.due + self.period
        if (behind := self.link.now - self.due) > 0:  # missed instants are skipped, never made up for
            self.due += behind // self.period * self.period
        self._take(self.due)
        now = self.link.now
        held_up, self._last = now - self._last - self.period, now
        self.late += held_up > LATE * self.period
        self._excess += (min(held_up, LATE * self.period) - self._excess) / MEMORY
        if pressed := self.abort():
            return Ending("operator", f"ended by the operator: {pressed}")
        if self.recorder.fault or self.recorder.stalled():
            return Ending("disk", self.recorder.fault or f"{self.recorder.path}: the disk takes nothing any more")
        if self.progress and now - self._progressed > PROGRESS_EVERY * 1e9:
            self._progressed = now
            left = room_left(self.watch, limits, now)
            duration, battery = self.plan.duration, self.watch.battery
            self.progress(Status(self._phase, self._since(), duration, self.watch.pose, left, battery))
        flying, moving = (now - self._first) / 1e9, (now - self._asked) / 1e9
        verdict = self._starved(limits, held_up) or judged(self.watch, limits, now, flying, moving)
        return Ending(verdict.code, verdict.text) if verdict else None

    def _starved(self, limits: Limits, late: int) -> GuardVerdict | None:
        if late > limits.overdue * 1e9:
            return GuardVerdict("starved", f"the loop was held up for {late / 1e9:.2f} s: is the computer overloaded?")
        if self.late >= limits.starved:
            text = f"{self.late} commands came more than {LATE:g} periods late: is the computer overloaded?"
            return GuardVerdict("starved", text)
        if self._excess > self.period:
            taken = 1e9 / (self.period + self._excess)
            text = f"the link takes {taken:.0f} of {self.plan.rate:g} commands a second: lower `rate` in the plan"
            return GuardVerdict("starved", text)
        return None

    def _take(self, until: int) -> None:
        """Receives samples up to a time [ns], records them, and updates watch and tracking."""
        for sample in self.link.receive(until):
            self.recorder.sample(sample)
            if sample.text and sample.text not in self.notes and len(self.notes) < MOST_TEXTS:
                self.notes.append(sample.text)
            self.watch, believed = observed(self.watch, sample, self.limits)
            if believed and self._steering and self.watch.pose is not None:
                since = (self.watch.stamp - self._zero) / 1e9
                self.tracking = tracked(self.tracker, self.tracking, since, np.array(self.watch.pose))

    def _send(self, command: Sequence[float]) -> None:
        """Sends a command and records it."""
        for axis, value, most in zip(AXES, command, self.most, strict=True):
            if not abs(value) <= most:  # NaN, too
                raise _RefusedError(f"a command of {value:g} on {axis} was not sent: {most:g} is the largest")
        self._stamp = self.link.now
        self.recorder.command(self._stamp, self.link.send(command))
        if self._phase:
            self._lateness.append(self._stamp - self._planned)
        if max(map(abs, command)) < ASKED:
            self._asked = self._stamp

    def _brake(self, axes: Sequence[Coasting]) -> None:
        """Brakes the coasting axes, as long as the poses are fresh."""
        on_the_way = nothing_on_the_way(axes, self.period / 1e9)
        for _ in range(round(BRAKING * self.plan.rate) if axes else 0):
            self._listen()
            pose, velocity = self.watch.pose, self.watch.velocity
            if pose is None or self.link.now - self.watch.received > STALE * 1e9:
                return
            if math.hypot(velocity[0], velocity[1]) < BRAKED:
                return
            command, on_the_way = braking(axes, on_the_way, pose, velocity, self.period / 1e9)
            self._send(command)

    def _listen(self) -> None:
        """Takes in the samples of one period, without a command."""
        self.due = max(self.due + self.period, self.link.now)
        self._take(self.due)

    def _try(self, step: Callable[..., None], *arguments: Any) -> bool:
        """Tries a step of the exit: if the link fails, the other steps are still tried; whether it succeeded."""
        try:
            step(*arguments)
        except (LinkError, _RefusedError) as error:
            if str(error) not in self.notes:
                self.notes.append(str(error))
            if self.link.live:
                time.sleep(self.period / 1e9)
            return False
        return True

    def _enter(self, phase: str) -> None:
        self._phase, self._began, self._asked = phase, self.link.now, self.link.now
        self.recorder.event(self._began, f"{phase} begins")

    def _since(self) -> float:
        """Time since the phase began [s]."""
        return (self.link.now - self._began) / 1e9

    def _speed(self) -> float:
        return math.hypot(*self.watch.velocity[:3])

    def _steer_from_here(self, steering: bool) -> None:
        """Starts the tracking at the vehicle's pose; `steering`: whether poses update it."""
        assert self.watch.pose is not None
        here = begin(np.array(self.watch.pose))
        self.tracking, self._zero = replace(here, velocity=np.array(self.watch.velocity)), self.watch.stamp
        self._steering = steering
