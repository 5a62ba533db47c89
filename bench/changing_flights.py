"""Flights of the flight room in which something changes, with the truth: for the benches of the tracker.

    python bench/changing_flights.py          what each change leaves in the pose, and how fast such flights are made

`changing_flight(seed, scenario)` flies one and returns it as read from its log. The vehicle flies a multisine on its
axes, at all multiples of one cycle (`rotorfit plan` takes the odd ones), in open loop or with the planner's soft
centring feedback on the measured pose. The seed determines the initial heading, the direction of the wind, the weak
rotor, the initial phase of the signal, and all noise.

The vehicle is one of the room's with a battery that lasts and an autopilot that does not brake at zero command. Its
autopilot learns thrust, rotors and mass within `Scenario.learning`. Closed loops run in compiled code, which gives the
same commands as `plan_control`; the flight itself is then flown by `fly_commands`, like every other one.
"""

import functools
import time
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numba
import numpy as np

from rotorfit.core.flight_data import Flight
from rotorfit.core.flight_plan import AxisExcitation, Feedback, Plan, Sines, Space, command_at
from rotorfit.core.frames import AXES, Array, yaw_from_quaternion
from rotorfit.core.limits import GRAVITY
from rotorfit.files.cards import card_from_mapping
from rotorfit.flights.assemble import flight_from_log
from rotorfit.planning.plan_control import Tracker, begin, instants, obeyed, observed, tracker_of
from rotorfit.planning.signals import multisine
from rotorfit.simulation import rigid_body
from rotorfit.simulation.air import Gusts, Rise, Wind
from rotorfit.simulation.change import Change, changed
from rotorfit.simulation.flight_room import BLOCK, Conditions, FlightRoom, RoomFlight, fly_commands, log_of_room_flight
from rotorfit.simulation.sensors import Integers, Mocap, Swap, Turn, _see_poses
from rotorfit.simulation.vehicle import Four, Linear, Vehicle, load_vehicle

Cause = Literal[
    "none", "wind", "picked_up", "dropped", "propeller", "battery", "limits", "delay", "frame", "heading", "frozen"
]
CAUSES: tuple[Cause, ...] = get_args(Cause)
"""Nothing; wind that rises; +15 % mass, and back by as much; a propeller at 90 %; 5 % less thrust within a minute; tilt
10 to 15 deg or half as much speed again; 50 ms more; the pose's frame turned by 20 deg about the vertical through the
origin; the body's heading in it alone; the pose frozen for `FROZEN`."""

PAYLOAD, WEAK, SAG, SAG_TIME, SLOWER, TURNED, FROZEN = 1.15, 0.9, 0.05, 60.0, 0.05, np.radians(20.0), 10.0
TILTS = (np.radians(10.0), np.radians(15.0))
FASTER = 1.5
RISE, RISEN_MEAN, RISEN_GUSTS = 10.0, 3.0, 4.0
"""Wind rises within so many seconds to a mean of 3 m/s, and to gusts four times as strong."""

PUSHED, LET_GO = (0.5, 2.0), (0.5, 3.0)
"""How long the pilot of `piloted_flight` pushes a stick, and lets go [s]."""

RATE, PERIOD, BAND = 50.0, 60.0, (0.9, 5.0)
"""Commands a second; period [s] and band [rad/s] of the multisine."""
AMPLITUDE = 0.5
"""Its peak, as a share of the largest command."""
CENTRING = Feedback(AXES, (0.3, 0.3, 0.6, 0.6), (0.5, 0.5, 1.0, 1.0))
"""As the planner's."""
FLOOR = -1e6
"""Nobody lands by drifting [m]."""
SPACE = Space((-4.0, -4.0, -2.0), (4.0, 4.0, 2.0), (0.0, 0.0, 0.0, 0.0), speed=1.5, climb=1.0)


@dataclass(frozen=True)
class Scenario:
    """What is flown in what.

    Attributes:
        cause: What changes.
        vehicle: Of the room: `bebop2`, `ardrone2` (tilts); `tello` (velocities as fractions), `crazyflie`, `m100` (in
            SI: another limit only cuts its commands).
        loop: Open, or closed by the feedback of plans on the measured pose.
        gusts: Standard deviation along x and y, half of it along z [m/s].
        mean: Mean wind [m/s], in a direction that the seed draws.
        duration: [s].
        time: When it changes [s].
        learning: Time constant with which the autopilot learns of it [s]. 1 s: between the room's 0.2 s and the 1.7 s
            of the slow pole of PX4's default climb loop (s^2 + 4 s + 2).
        axes: That are excited.
        rest: Interval (start, end) without excitation [s].
    """

    cause: Cause = "none"
    vehicle: str = "bebop2"
    loop: Literal["open", "closed"] = "closed"
    gusts: float = 0.0
    mean: float = 0.0
    duration: float = 120.0
    time: float = 60.0
    learning: float = 1.0
    axes: tuple[str, ...] = AXES
    rest: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True)
class ChangingFlight:
    """A flight with its truth. N poses of the flight.

    Attributes:
        flight: As from its log; its seconds are those of the scenario.
        scenario: What was flown.
        change: When it began to change [s]; None where the vehicle and its pose stayed as they were.
        before: The vehicle at the start.
        after: The vehicle at the end, its autopilot having learnt; weak rotors and batteries leave no trace in it.
        linear: Coefficients and delays before and after: what an estimator should find.
        wind: At the flight's poses, world, shape (N, 3) [m/s].
        velocity: Likewise, of the vehicle, shape (N, 3) [m/s].
        room: Everything else that the room knows.
    """

    flight: Flight
    scenario: Scenario
    change: float | None
    before: Vehicle
    after: Vehicle
    linear: tuple[Linear, Linear]
    wind: Array
    velocity: Array
    room: RoomFlight


def changing_flight(seed: int, scenario: Scenario) -> ChangingFlight:
    """Flies a scenario."""
    vehicle, conditions, start, plan = prepared(seed, scenario)
    ticks = np.arange(round(scenario.duration * RATE))
    stamps = np.round(ticks * 1e9 / RATE).astype(np.int64)
    wanted = _signals(plan, scenario, ticks / RATE + _phase(seed))
    if scenario.loop == "open":
        commands = np.clip(wanted, -_most(vehicle), _most(vehicle))
    else:
        commands = closed_commands(vehicle, conditions, stamps, wanted, tracker_of(plan), seed, start)
    room = fly_commands(vehicle, conditions, stamps, commands, scenario.duration, seed, start)
    flight = flight_from_log(log_of_room_flight(room), card_from_mapping(vehicle.card(), "room"))
    row = np.searchsorted(room.true_instant, np.round(flight.pose_time * 1e9).astype(np.int64))
    if np.abs(room.true_instant[row] * 1e-9 - flight.pose_time).max() > 1e-6:
        raise AssertionError("the seconds of the flight are not those of the room")
    after = changed(vehicle, conditions.changes)
    return ChangingFlight(
        flight, scenario, None if scenario.cause in ("none", "wind") else scenario.time, vehicle, after,
        (vehicle.linear(), after.linear()), room.true_wind[row], room.true_velocity[row], room,
    )  # fmt: skip


def piloted_flight(seed: int, gusts: float, duration: float = 120.0, brakes: bool = True) -> Flight:
    """A Bebop 2, faultless, flown by a pilot who pushes one or two sticks for a while and lets go.

    Let go of forward and left together, its autopilot brakes, which no linear law does.

    Args:
        seed: Of everything random.
        gusts: As in `Scenario` [m/s].
        duration: [s].
        brakes: Whether it does.
    """
    vehicle, conditions, start, _ = prepared(seed, Scenario("none", "bebop2", gusts=gusts, duration=duration))
    vehicle = replace(vehicle, autopilot=replace(vehicle.autopilot, brakes_on_zero=brakes))
    rng, period = np.random.default_rng((seed, 3)), 1.0 / RATE
    sticks, t = np.zeros((round(duration * RATE), 4)), 0.0
    heading = -1.0
    while t < duration:
        pushed, rests = rng.uniform(*PUSHED), rng.uniform(*LET_GO)
        heading = -heading  # there and back again
        asked = np.where(rng.random(4) < 0.6, heading * rng.uniform(0.3, 1.0, 4) * rng.choice([-1.0, 1.0], 4), 0.0)
        first, last = (round(one / period) for one in (t, t + pushed))
        sticks[first:last] = asked * AMPLITUDE * _most(vehicle)
        t += pushed + rests
    stamps = np.round(np.arange(len(sticks)) * 1e9 / RATE).astype(np.int64)
    flown = fly_commands(vehicle, conditions, stamps, sticks, duration, seed, start)
    return flight_from_log(log_of_room_flight(flown), card_from_mapping(vehicle.card(), "room"))


def prepared(seed: int, scenario: Scenario) -> tuple[Vehicle, Conditions, Four, Plan]:
    """The vehicle at the start, everything that happens to it, where it starts, and what is planned."""
    rng, at = np.random.default_rng((seed, 1)), scenario.time
    vehicle = load_vehicle(scenario.vehicle)
    battery = replace(vehicle.battery, sag=0.0, flight_time=1e9)
    pilot = replace(vehicle.autopilot, brakes_on_zero=False, learning=scenario.learning)
    vehicle = replace(vehicle, battery=battery, autopilot=pilot)
    heading, blowing = rng.uniform(-np.pi, np.pi, 2)
    towards, weak = np.array([np.cos(blowing), np.sin(blowing), 0.0]), int(rng.integers(4))
    mocap, changes, rises = Mocap(stale=0.08), (), ()
    match scenario.cause:
        case "wind":
            rises = (Rise(at, at + RISE, _three(RISEN_MEAN * towards), RISEN_GUSTS),)
        case "picked_up":
            changes = (Change(at, mass=PAYLOAD),)
        case "dropped":
            changes = (Change(at, mass=1 / PAYLOAD),)
        case "propeller":
            changes = (Change(at, rotors=tuple(WEAK if k == weak else 1.0 for k in range(4))),)  # type: ignore[arg-type]
        case "battery":
            changes = (Change(at, fade=SAG, fade_time=SAG_TIME),)
        case "limits":
            if vehicle.command.horizontal == "tilt":
                vehicle = replace(vehicle, command=replace(vehicle.command, tilt=TILTS[0]))
                changes = (Change(at, tilt=TILTS[1]),)
            else:
                changes = (Change(at, speed=FASTER * vehicle.limits()[0]),)
        case "delay":
            changes = (Change(at, latency=SLOWER),)
        case "frame":
            mocap = replace(mocap, turns=(Turn(at, TURNED),))
        case "heading":
            mocap = replace(mocap, swaps=(Swap(at, np.inf, turn=TURNED),))
        case "frozen":
            mocap = replace(mocap, frozen=((at, at + FROZEN),))
    sigma = scenario.gusts
    gusts = Gusts((sigma, sigma, sigma / 2)) if sigma else None
    wind = Wind(_three(scenario.mean * towards), gusts, rises=rises)
    conditions = Conditions(wind, mocap, floor=FLOOR, changes=changes)
    return vehicle, conditions, (0.0, 0.0, 0.0, float(heading)), _plan(vehicle, scenario)


def _three(values: Array) -> tuple[float, float, float]:
    x, y, z = map(float, values)
    return x, y, z


def _plan(vehicle: Vehicle, scenario: Scenario) -> Plan:
    """The multisine with the feedback of a planner that knows the vehicle."""
    most = _most(vehicle)
    long = scenario.duration + PERIOD
    excitations = tuple(
        AxisExcitation(axis, "command", 0.0, long, _multisine(AMPLITUDE * float(most[a]), scenario.axes.index(axis)))
        for a, axis in enumerate(AXES)
        if axis in scenario.axes
    )
    belief = {"gamma": list(vehicle.linear().gamma)}
    feedback = CENTRING if scenario.loop == "closed" else None
    return Plan("changing", "multisine", vehicle.card(), RATE, long, 0.0, excitations, feedback, SPACE, belief)


@functools.cache
def _multisine(amplitude: float, place: int) -> Sines:
    return multisine(amplitude, PERIOD, BAND, place, len(AXES))


def _most(vehicle: Vehicle) -> Array:
    """The largest commands."""
    return np.array(vehicle.limits()) / np.array(vehicle.full_scale())


def _phase(seed: int) -> float:
    """Where in its period the signal begins [s]."""
    return float(np.random.default_rng((seed, 2)).uniform(0.0, PERIOD))


def _signals(plan: Plan, scenario: Scenario, t: Array) -> Array:
    """The planned commands, none in the rest, shape (N, 4)."""
    wanted = command_at(plan, t)
    since = t - t[0]
    wanted[(since >= scenario.rest[0]) & (since < scenario.rest[1])] = 0.0
    return wanted


def closed_commands(
    vehicle: Vehicle, conditions: Conditions, stamps: Integers, wanted: Array, tracker: Tracker, seed: int, start: Four
) -> Array:
    """The commands of a closed loop: signals and feedback on the poses that have arrived, shape (M, 4).

    Args:
        vehicle: What flies.
        conditions: In what.
        stamps: When commands are sent, shape (M,) [ns].
        wanted: What the signals command then, shape (M, 4).
        tracker: Law of the feedback, which holds the start.
        seed: Of the room.
        start: x, y, z, yaw.
    """
    room, feedback = FlightRoom(vehicle, conditions, seed, start), tracker.plan.feedback
    assert feedback is not None
    while stamps[-1] >= room._blocks * BLOCK * 1e9:
        room._draw_block()
    arrival, kept = room._radio.arrivals(stamps, room._slower(stamps))
    scale, limit = np.tile(vehicle.full_scale(), (stamps.size, 1)), np.tile(vehicle.limits(), (stamps.size, 1))
    for count, change in enumerate(room._changes, start=1):
        then = changed(vehicle, room._changes[:count])
        late = arrival >= change.time * 1e9
        scale[late], limit[late] = then.full_scale(), then.limits()
    acts = np.array([axis in feedback.axes for axis in AXES], float)
    frames = room._streams[0].frames
    commands = wanted.copy()
    _close(
        *room._regimes, room._state, room._held, room._progress, stamps, arrival, kept, scale, limit, room._shot,
        room._seen, room._wind, frames.arrival, frames.stamp, frames.kept, frames.shown, frames.error, frames.shift,
        room._streams[0].row, np.array(start), acts * feedback.stiffness, acts * feedback.damping,
        feedback.filter_time, np.ascontiguousarray(tracker.gamma), tracker.full_scale, commands,
    )  # fmt: skip
    return commands


@numba.njit(cache=True)
def _close(  # type: ignore[no-untyped-def]
    starts, regimes, state, held, progress, stamps, arrival, kept, scale, limit, shot, seen, wind, frame_arrival,
    frame_stamp, frame_kept, shown, error, shift, row, origin, stiffness, damping, filter_time, gamma, most, commands,
):  # fmt: skip
    """Flies, observes and commands; adds the feedback to `commands` and cuts them at `most`."""
    arrived, kind, asked = np.empty_like(stamps), np.zeros_like(stamps), np.zeros_like(commands)
    given, pose, velocity, when = 0, origin.copy(), np.zeros(4), 0.0
    count = np.int64(0)  # for the literal, `advance` would be compiled once more
    out, change = np.empty((1, 7)), np.empty(4)
    for k in range(stamps.size):
        rigid_body.advance(
            starts, regimes, state, held, progress, stamps[k], arrived, kind, asked, count, shot, shot.size, seen,
            wind, rigid_body.MAX_STEP,
        )  # fmt: skip
        while given < frame_arrival.size and frame_arrival[given] <= stamps[k]:
            since = frame_stamp[given] * 1e-9 - when
            if frame_kept[given] and since > 0:
                _see_poses(seen, row, shown[given : given + 1], error, shift, out)
                change[:3] = out[0, :3] - pose[:3]
                w, x, y, z = out[0, 3], out[0, 4], out[0, 5], out[0, 6]
                yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
                change[3] = (yaw - pose[3] + np.pi) % (2 * np.pi) - np.pi
                for a in range(4):
                    velocity[a] += (change[a] - velocity[a] * since) / (filter_time + since)
                    pose[a] += change[a]
                when = frame_stamp[given] * 1e-9
            given += 1
        c, s = np.cos(pose[3]), np.sin(pose[3])
        off = origin - pose
        off[0], off[1] = c * off[0] + s * off[1], c * off[1] - s * off[0]
        v0, v1 = c * velocity[0] + s * velocity[1], c * velocity[1] - s * velocity[0]
        for a in range(4):
            moving = v0 if a == 0 else v1 if a == 1 else velocity[a]
            wanted = commands[k, a] + (stiffness[a] * off[a] - damping[a] * moving) / gamma[2 * a]
            commands[k, a] = min(max(wanted, -most[a]), most[a])
        if kept[k]:
            arrived[count] = arrival[k]
            for a in range(4):
                asked[count, a] = min(max(commands[k, a] * scale[k, a], -limit[k, a]), limit[k, a])
            count += 1


# What is printed


def by_plan_control(seed: int, scenario: Scenario) -> Array:
    """The commands of a closed loop by `plan_control` itself, step by step."""
    vehicle, conditions, start, plan = prepared(seed, scenario)
    tracker, room, commands = tracker_of(plan), FlightRoom(vehicle, conditions, seed, start), []
    state = begin(np.array(start))
    wanted = instants(plan, np.arange(round(scenario.duration * RATE)) / RATE + _phase(seed))
    for k, instant in enumerate(wanted):
        for sample in room.advance(round(k * 1e9 / RATE)):
            if sample.stream == "pose":
                yaw = float(yaw_from_quaternion(*map(np.array, sample.values[3:])))
                state = observed(tracker, state, sample.stamp * 1e-9, np.array([*sample.values[:3], yaw]))
        state, command = obeyed(tracker, state, instant)
        room.send(command.tolist())
        commands.append(command)
    return np.array(commands)


AFTER = (0.5, 1.0, 3.0, 10.0, 60.0)
"""Seconds after a change at which its trace is looked at."""


def traces(vehicle: str) -> None:
    """What a change adds to the path: the changed flight less the same flight without it, in still air, open loop."""
    print(f"\n{vehicle}, open loop, still air: the flight less the same one unchanged")
    print(f"{'':11}{'learning':>9}  " + "".join(f"{f'after {t:g} s':>33}" for t in AFTER))
    print(f"{'':22}" + "".join(f"{'xy mm':>10}{'z mm':>8}{'z mm/s':>8}{'yaw deg':>7}" for _ in AFTER))
    for cause in ("picked_up", "dropped", "propeller", "battery"):
        for learning in (0.2, 1.0, 1.7, np.inf):
            scenario = Scenario(cause, vehicle, "open", duration=125.0, learning=learning)
            told = []
            plain, other = (flown_exactly(replace(scenario, cause=one)) for one in ("none", cause))
            for after in AFTER:
                at = int(np.searchsorted(plain.true_instant, (scenario.time + after) * 1e9))
                way = (other.true_position - plain.true_position)[at]
                speed = (other.true_velocity - plain.true_velocity)[at, 2]
                turn = np.angle(np.exp(1j * (_yaw(other)[at] - _yaw(plain)[at])))
                told.append(
                    f"{1e3 * np.hypot(*way[:2]):10.0f}{1e3 * way[2]:8.1f}{1e3 * speed:8.1f}{np.degrees(turn):7.2f}"
                )
            print(f"{cause:11}{learning:9g}  " + "".join(told), flush=True)


def flown_exactly(scenario: Scenario, seed: int = 1) -> RoomFlight:
    """An open-loop flight of the room, not read back."""
    vehicle, conditions, start, plan = prepared(seed, scenario)
    stamps = np.round(np.arange(round(scenario.duration * RATE)) * 1e9 / RATE).astype(np.int64)
    commands = _signals(plan, scenario, stamps * 1e-9 + _phase(seed))
    return fly_commands(vehicle, conditions, stamps, commands, scenario.duration, seed, start)


def _yaw(flight: RoomFlight) -> Array:
    return np.asarray(yaw_from_quaternion(*flight.true_quaternion.T))


def carried(vehicle: str) -> None:
    """What gusts do to the path beyond what the velocity at the start foretells: root mean square."""
    print(f"\n{vehicle}, open loop: gusts move the path beyond what its velocity foretells by (root mean square)")
    print(f"{'gusts m/s':>10}" + "".join(f"{f'x, z after {t:g} s [mm]':>26}" for t in AFTER[:4]))
    for gusts in (1.0, 2.0, 3.0, 5.0):
        calm, windy = (flown_exactly(Scenario("none", vehicle, "open", one, duration=600.0)) for one in (0.0, gusts))
        off, moving = windy.true_position - calm.true_position, windy.true_velocity - calm.true_velocity
        gamma, told = prepared(1, Scenario(vehicle=vehicle))[0].linear().gamma, []
        for after in AFTER[:4]:
            n = round(after * 120)
            for axis, damping in ((0, gamma[1]), (2, gamma[5])):
                known = moving[:-n, axis] * (1 - np.exp(-damping * after)) / damping
                rest = off[n:, axis] - off[:-n, axis] - known
                told.append(1e3 * float(np.sqrt(np.mean(rest**2))))
        print(f"{gusts:10g}" + "".join(f"{x:13.0f}{z:13.0f}" for x, z in zip(told[::2], told[1::2], strict=True)))


def deflections(vehicle: Vehicle) -> None:
    """How many standard deviations a change of height is worth to the best test there can be.

    That test knows when, what and how much, and the gusts' spectrum; it sees the height alone. The change is a missing
    acceleration m(t), the gusts one of spectrum G(w), and mocap noise of variance r every h seconds looks like one of
    w^2 (w^2 + b^2) r h: d^2 is the integral of |M(w)|^2 over the sum of both, over 2 pi.
    """
    w = np.geomspace(1e-4, 1e4, 200_001)
    drag, damping, mocap = vehicle.drag[2], vehicle.linear().gamma[5], Mocap()
    seen = w**2 * (w**2 + damping**2) * mocap.noise**2 / mocap.rate
    print(f"\n{vehicle.name}: a change of height in standard deviations of the best test; learning 0.2, 1, 1.7, inf s")
    print(f"{'gusts m/s':>10}{'picked up':>34}{'battery, 60 s':>34}")
    for gusts in (0.2, 1.0, 2.0, 3.0, 5.0):
        air = (drag * gusts / 2) ** 2 * (1 + 3 * w**2) / (1 + w**2) ** 2
        told = []
        for cause in ("picked_up", "battery"):
            for learning in (0.2, 1.0, 1.7, np.inf):
                t = np.linspace(0.0, 60.0, 60_001)
                rate = GRAVITY * SAG / SAG_TIME
                if cause == "picked_up":  # learnt exponentially; or the loop sinks, and all of it stays missing
                    size = GRAVITY * (1 - 1 / PAYLOAD)
                    missing = size * np.exp(-t / learning) if np.isfinite(learning) else np.full(t.size, size)
                else:
                    missing = rate * (learning * (1 - np.exp(-t / learning)) if np.isfinite(learning) else t)
                told.append(_deflection(missing, t, w, air + seen))
        print(f"{gusts:10g}" + "".join(f"{one:8.1f}" + "  " * (k == 3) for k, one in enumerate(told)))


def _deflection(missing: Array, t: Array, w: Array, noise: Array) -> float:
    """Of a signal that is a straight line between its times, by its exact transform at a few frequencies."""
    few = np.geomspace(w[0], w[-1], 2001)
    turn = np.exp(-1j * np.multiply.outer(few, t[::20]))
    step, value = t[20] - t[0], missing[::20]
    hat = np.sinc(few * step / (2 * np.pi)) ** 2 * step
    inner = hat * (turn @ value)
    half = (1 - 1j * few * step - np.exp(-1j * few * step)) / (few**2 * step)  # the first hat has only its right half
    inner += value[0] * (half - hat)
    last = np.conj(half) * np.exp(-1j * few * t[-1])
    inner += value[-1] * (last - hat * np.exp(-1j * few * t[-1]))
    power = np.interp(np.log(w), np.log(few), np.abs(inner) ** 2)
    return float(np.sqrt(np.trapezoid(power / noise, w) / np.pi))


def main() -> None:
    for vehicle in ("bebop2", "tello"):
        scenario = Scenario("picked_up", vehicle, gusts=2.0, duration=30.0, time=15.0)
        compiled = changing_flight(3, scenario).room.command
        step_by_step = by_plan_control(3, scenario)
        print(f"{vehicle}: compiled loop and plan_control differ by {np.abs(compiled - step_by_step).max():.1e}")
    print(f"\n{'times real time':20}" + "".join(f"{f'{d:g} s':>10}" for d in (120.0, 600.0, 3600.0)))
    for loop in ("open", "closed"):
        told = []
        for duration in (120.0, 600.0, 3600.0):
            began = time.process_time()
            changing_flight(1, Scenario("picked_up", "bebop2", loop, 2.0, duration=duration))  # type: ignore[arg-type]
            told.append(duration / (time.process_time() - began))
        print(f"{loop:20}" + "".join(f"{one:10.0f}" for one in told), flush=True)
    for vehicle in ("bebop2", "tello"):
        traces(vehicle)
        carried(vehicle)
        deflections(prepared(1, Scenario(vehicle=vehicle))[0])


if __name__ == "__main__":
    main()
