"""The virtual flight room: a vehicle, air, motion capture, radio and clocks; step by step, or a whole flight at once.

Both forms run the same compiled kernel over the same nodes with the same random numbers, so they agree bit for bit.
The simulator imports nothing from the estimator.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np

from rotorfit.core.frames import Array
from rotorfit.core.log import Log, Sample, Table
from rotorfit.simulation import rigid_body
from rotorfit.simulation.air import GustSource, Wind, wind_at_nodes
from rotorfit.simulation.change import Change, changed
from rotorfit.simulation.sensors import (
    BATTERY_RATE,
    FrameStream,
    Integers,
    Mocap,
    RadioSource,
    SenderClock,
    battery_frames,
    charges,
    mocap_frames,
    poses,
    velocities,
    velocity_frames,
)
from rotorfit.simulation.vehicle import Four, Radio, Vehicle

BLOCK = 10.0  # s of frames and wind that are drawn at a time

WIND_PERIOD = rigid_body.WIND_STEP * 1e-9

MODES = ("grounded", "taking_off", "flying", "landing")


@dataclass(frozen=True)
class Conditions:
    """Conditions of a flight, apart from the vehicle.

    Attributes:
        wind: Motion of the air.
        mocap: Motion capture.
        radio: Transmission of commands; None for the vehicle's own.
        mocap_clock: Clock of the poses.
        vehicle_clock: Clock of onboard velocities and of the battery.
        charge: Charge of the battery at the start, 0 to 1.
        floor: Height of the floor, world [m].
        changes: Changes of the vehicle in flight.
    """

    wind: Wind = field(default_factory=Wind)
    mocap: Mocap = field(default_factory=Mocap)
    radio: Radio | None = None
    mocap_clock: SenderClock = field(default_factory=SenderClock)
    vehicle_clock: SenderClock = field(default_factory=SenderClock)
    charge: float = 1.0
    floor: float = 0.0
    changes: tuple[Change, ...] = ()


@dataclass(frozen=True)
class TrueState:
    """The true state, which no sensor measures.

    Attributes:
        position: World [m].
        velocity: World [m/s].
        quaternion: Body to world, w, x, y, z.
        rates: Body rates [rad/s].
        charge: Charge of the battery, 0 to 1.
        mode: `grounded`, `taking_off`, `flying` or `landing`.
    """

    position: tuple[float, float, float]
    velocity: tuple[float, float, float]
    quaternion: Four
    rates: tuple[float, float, float]
    charge: float
    mode: str


@dataclass(frozen=True)
class RoomFlight:
    """A recorded flight, with the truth at the poses; M commands, N poses, K velocities, B battery samples.

    Attributes:
        vehicle: The vehicle flown.
        conditions: Its conditions.
        seed: Seed of all randomness.
        command_stamp: When each command was sent, shape (M,) [ns since the start].
        command: In the unit of the vehicle's commands, shape (M, 4).
        pose_stamp: By the mocap's clock, shape (N,) [ns].
        pose_received: When it arrived, shape (N,) [ns since the start].
        pose: x, y, z [m], quaternion w, x, y, z, world, shape (N, 7).
        velocity_stamp: By the vehicle's clock, shape (K,) [ns].
        velocity_received: Shape (K,) [ns since the start].
        velocity: Forward, left, up [m/s], yaw rate [rad/s], heading frame, shape (K, 4).
        battery_stamp: By the vehicle's clock, shape (B,) [ns].
        battery_received: Shape (B,) [ns since the start].
        battery: Remaining charge, 0 to 1, shape (B,).
        true_instant: When each frame was truly taken, shape (N,) [ns since the start].
        true_position: At that instant, world, shape (N, 3) [m].
        true_velocity: At that instant, world, shape (N, 3) [m/s].
        true_quaternion: At that instant, body to world, w, x, y, z, shape (N, 4).
        true_wind: Air velocity at that instant, world, shape (N, 3) [m/s].
    """

    vehicle: Vehicle
    conditions: Conditions
    seed: int
    command_stamp: Integers
    command: Array
    pose_stamp: Integers
    pose_received: Integers
    pose: Array
    velocity_stamp: Integers
    velocity_received: Integers
    velocity: Array
    battery_stamp: Integers
    battery_received: Integers
    battery: Array
    true_instant: Integers
    true_position: Array
    true_velocity: Array
    true_quaternion: Array
    true_wind: Array


class FlightRoom:
    """A vehicle in a room, step by step. Deterministic: everything follows from the arguments and the calls.

    Attributes:
        vehicle: The vehicle.
        conditions: Air, mocap, radio, clocks, battery, floor.
        seed: Seed of all randomness.
        now: True time since the start, which is also the clock of the ground station [ns].
    """

    def __init__(
        self,
        vehicle: Vehicle,
        conditions: Conditions,
        seed: int,
        start: Four = (0.0, 0.0, 1.5, 0.0),
        flying: bool = True,
        max_step: int = rigid_body.MAX_STEP,
    ) -> None:
        """The vehicle hovers at the start, or stands on the floor below it.

        Args:
            vehicle: The vehicle.
            conditions: Air, mocap, radio, clocks, battery, floor.
            seed: Seed of all randomness.
            start: x, y, z [m] and yaw [rad], world.
            flying: False: on the floor, rotors at rest.
            max_step: Longest step of the integration [ns].

        Raises:
            ValueError: A start below the floor, or a step that does not divide the interval between nodes of the wind.
        """
        if start[2] < conditions.floor:
            raise ValueError(f"the start is at {start[2]:g} m, below the floor at {conditions.floor:g} m")
        if rigid_body.WIND_STEP % max_step:
            raise ValueError(f"a step of {max_step} ns does not divide {rigid_body.WIND_STEP} ns")
        self.vehicle, self.conditions, self.seed, self.now = vehicle, conditions, seed, 0
        gusts, *frames, radio = np.random.SeedSequence(seed).spawn(4)
        self._radio = RadioSource(conditions.radio or vehicle.radio, radio)
        self._streams = _streams(vehicle, conditions, *map(np.random.default_rng, frames))
        self._gusts = GustSource(conditions.wind.gusts, WIND_PERIOD, np.random.default_rng(gusts))
        self._changes = sorted(conditions.changes, key=lambda change: change.time)
        self._regimes = rigid_body.regimes(rigid_body.parameters(vehicle, conditions.floor), self._changes)
        self._max_step = max_step
        self._state = rigid_body.initial_state(vehicle, start, flying, conditions.charge, conditions.floor)
        self._held, self._progress = np.zeros(4), np.zeros(rigid_body.PROGRESS, np.int64)
        self._progress[rigid_body.MODE] = rigid_body.FLYING if flying else rigid_body.GROUNDED
        self._event, self._events = _no_events(64), 0
        self._shot, self._seen = np.empty(0, np.int64), np.empty((0, rigid_body.SEEN))
        self._wind, self._blocks = np.empty((0, 3)), 0
        self._fly(0)  # loads every kernel, so that no later call has to wait
        for stream in self._streams:
            stream.values(self._seen, np.empty(0, np.int64))

    def send(self, command: Sequence[float]) -> None:
        """Sends forward, left, up, counter-clockwise, in the unit of the vehicle's commands, now.

        The command arrives late, or never. The autopilot holds the last one that arrived and hovers after
        `command_timeout`.

        Raises:
            ValueError: Not four finite numbers.
        """
        self._send(np.array([self.now]), np.array([command], np.float64))

    def take_off(self) -> None:
        """Requests a take-off, which a vehicle on the floor obeys; it ignores commands until it hovers."""
        self._ask(rigid_body.TAKE_OFF)

    def land(self) -> None:
        """Requests a landing, which a vehicle in the air obeys; it ignores commands from then on."""
        self._ask(rigid_body.LAND)

    def advance(self, until: int) -> list[Sample]:
        """Advances the simulation.

        Args:
            until: True time since the start [ns], not before `now`.

        Returns:
            The samples that arrived since the last call, in the order of their arrival.

        Raises:
            ValueError: `until` is before `now`.
        """
        self._fly(until)
        samples = []
        for stream in self._streams:
            index = stream.arrived(until)
            if index.size:
                stamp, arrival = stream.frames.stamp[index].tolist(), stream.frames.arrival[index].tolist()
                values = stream.values(self._seen, index).tolist()
                rows = zip(stamp, arrival, values, strict=True)
                samples += [Sample(stream.name, sent, received, tuple(value)) for sent, received, value in rows]
        return sorted(samples, key=lambda sample: sample.received)

    def truth(self) -> TrueState:
        """The true state now."""
        state, held, progress = self._state.copy(), self._held.copy(), self._progress.copy()
        if self.now > 0:  # the kernel stops at its last node: a copy continues to a shot at the present time
            progress[rigid_body.NEXT_SHOT] = 0
            shot, seen = np.array([self.now]), np.empty((1, rigid_body.SEEN))
            self._run(state, held, progress, self.now, shot, seen)
        s = state.tolist()
        return TrueState(
            (s[0], s[1], s[2]), (s[3], s[4], s[5]), (s[6], s[7], s[8], s[9]), (s[10], s[11], s[12]),
            s[rigid_body.CHARGE], MODES[progress[rigid_body.MODE]],
        )  # fmt: skip

    def wind(self, instant: Integers) -> Array:
        """Air velocity at instants up to `now`, shape (N,) [ns]: world, shape (N, 3) [m/s]."""
        row, rest = np.divmod(instant, rigid_body.WIND_STEP)
        place = (rest / rigid_body.WIND_STEP)[:, None]
        return np.asarray((1 - place) * self._wind[row] + place * self._wind[row + 1])

    def _send(self, sent: Integers, commands: Array) -> None:
        """Sends commands at instants not before `now`, in order, clipped at the vehicle's limits.

        Raises:
            ValueError: Commands that are not four finite numbers each.
        """
        if commands.shape != (sent.size, 4) or not np.isfinite(commands).all():
            raise ValueError("a command is four finite numbers: forward, left, up, counter-clockwise")
        arrival, kept = self._radio.arrivals(sent, self._slower(sent))
        asked = _asked(self.vehicle, commands)
        for count, change in enumerate(self._changes, start=1):
            if change.limits():
                after = arrival >= change.time * 1e9
                asked[after] = _asked(changed(self.vehicle, self._changes[:count]), commands[after])
        self._queue(arrival[kept], rigid_body.COMMANDED, asked[kept])

    def _ask(self, kind: int) -> None:
        slower = float(self._slower(np.array([self.now]))[0])
        self._queue(np.array([self._radio.arrival_of_request(self.now, slower)]), kind, np.zeros((1, 4)))

    def _slower(self, sent: Integers) -> Array:
        """Additional latency of what is sent at some instants, due to changes of the radio, shape (N,) [s]."""
        slower = np.zeros(sent.size)
        for change in self._changes:
            slower[sent >= change.time * 1e9] += change.latency
        return slower

    def _queue(self, arrival: Integers, kind: int, asked: Array) -> None:
        end = self._events + arrival.size
        while end > self._event[0].size:
            (a, b, c), (d, e, f) = self._event, _no_events(self._event[0].size)
            self._event = (np.concatenate([a, d]), np.concatenate([b, e]), np.concatenate([c, f]))
        new, (arrivals, kinds, wishes) = slice(self._events, end), self._event
        arrivals[new], kinds[new], wishes[new] = arrival, kind, asked
        self._events = end

    def _fly(self, until: int) -> None:
        if until < self.now:
            raise ValueError(f"time runs backwards: {until} ns is before {self.now} ns")
        while until >= self._blocks * BLOCK * 1e9:
            self._draw_block()
        self._run(self._state, self._held, self._progress, until, self._shot, self._seen)
        self.now = until

    def _run(self, state: Array, held: Array, progress: Integers, until: int, shot: Integers, seen: Array) -> None:
        rigid_body.advance(
            *self._regimes, state, held, progress, until, *self._event, self._events,
            shot, shot.size, seen, self._wind, self._max_step,
        )  # fmt: skip

    def _draw_block(self) -> None:
        """Draws wind and frames of the next `BLOCK` seconds; two more nodes of the wind for interpolation."""
        first, count = len(self._wind), round(BLOCK / WIND_PERIOD) + (2 if self._blocks == 0 else 0)
        air = wind_at_nodes(self.conditions.wind, first, count, WIND_PERIOD, self._gusts.draw(count))
        self._wind = np.concatenate([self._wind, air])
        self._blocks += 1
        drawn = [stream.draw(self._blocks * BLOCK) for stream in self._streams]
        instant = np.concatenate(drawn)
        order, row = np.argsort(instant, kind="stable"), np.empty(instant.size, np.int64)
        row[order] = self._shot.size + np.arange(instant.size)
        for stream, rows in zip(self._streams, np.split(row, np.cumsum([new.size for new in drawn])[:-1]), strict=True):
            stream.place(rows)
        self._shot = np.concatenate([self._shot, instant[order]])
        if self._shot.size > len(self._seen):  # double the buffer, so that long flights do not copy it in every block
            grown = np.empty((2 * self._shot.size, rigid_body.SEEN))
            grown[: len(self._seen)] = self._seen
            self._seen = grown


def _asked(vehicle: Vehicle, commands: Array) -> Array:
    """Setpoints of commands, clipped at the vehicle's limits: rad or m/s, forward and left; m/s up; rad/s."""
    limits = np.array(vehicle.limits())
    return np.asarray(np.clip(commands * np.array(vehicle.full_scale()), -limits, limits))


def _streams(
    vehicle: Vehicle, conditions: Conditions, mocap: np.random.Generator, onboard: np.random.Generator
) -> tuple[FrameStream, FrameStream, FrameStream]:
    """Streams of poses, onboard velocities and battery charges."""
    odometry, clock = vehicle.odometry, conditions.vehicle_clock
    bias = odometry.bias * onboard.standard_normal(3)
    pose = partial(mocap_frames, conditions.mocap, conditions.mocap_clock, mocap)
    velocity = partial(velocity_frames, odometry, clock, bias, onboard)
    battery = partial(battery_frames, odometry.latency, clock)
    return (
        FrameStream("pose", conditions.mocap.rate, pose, poses),
        FrameStream("velocity", odometry.rate, velocity, velocities),
        FrameStream("battery", BATTERY_RATE, battery, charges),
    )


def _no_events(count: int) -> tuple[Integers, Integers, Array]:
    """Buffers for arrivals, kinds, and setpoints of events."""
    return np.zeros(count, np.int64), np.zeros(count, np.int64), np.zeros((count, 4))


def fly_commands(
    vehicle: Vehicle,
    conditions: Conditions,
    stamps: Integers,
    commands: Array,
    duration: float,
    seed: int,
    start: Four = (0.0, 0.0, 1.5, 0.0),
    max_step: int = rigid_body.MAX_STEP,
) -> RoomFlight:
    """Flies given commands: equivalent to a `FlightRoom` to which they are sent one by one.

    Args:
        vehicle: The vehicle; it hovers at the start.
        conditions: Air, mocap, radio, clocks, battery, floor.
        stamps: When each command is sent, in order, shape (M,) [ns since the start].
        commands: Forward, left, up, counter-clockwise, in the unit of the vehicle's commands, shape (M, 4).
        duration: Time until which samples are received [s].
        seed: Seed of all randomness.
        start: x, y, z [m] and yaw [rad], world.
        max_step: Longest step of the integration [ns].

    Raises:
        ValueError: Stamps before the start or out of order; as `FlightRoom`.
    """
    sent, command = np.asarray(stamps, np.int64), np.asarray(commands, np.float64)
    if sent.size and (sent[0] < 0 or (np.diff(sent) < 0).any()):
        raise ValueError("stamps of commands must not be negative, and in order")
    room, end = FlightRoom(vehicle, conditions, seed, start, max_step=max_step), round(duration * 1e9)
    room._send(sent, command)
    room._fly(end)
    taken = [stream.arrived(end) for stream in room._streams]
    pose, velocity, battery = (
        (stream.frames.stamp[index], stream.frames.arrival[index], stream.values(room._seen, index))
        for stream, index in zip(room._streams, taken, strict=True)
    )
    instant, true = room._streams[0].frames.instant[taken[0]], room._seen[room._streams[0].row[taken[0]]]
    return RoomFlight(
        vehicle, conditions, seed, sent, command, *pose, *velocity, battery[0], battery[1], battery[2][:, 0],
        instant, true[:, :3], true[:, 3:6], true[:, 6:10], room.wind(instant),
    )  # fmt: skip


def log_of_room_flight(flight: RoomFlight) -> Log:
    """The flight as a log in memory, with topics and columns like the recorder's; `vehicle.card()` reads it."""
    received = {"header.stamp": flight.command_stamp, "log_time": flight.command_stamp}
    tables = {
        "/rotorfit/command": received | _twist(flight.command),
        "/rotorfit/pose": {"header.stamp": flight.pose_stamp, "log_time": flight.pose_received}
        | {f"pose.position.{axis}": flight.pose[:, k].copy() for k, axis in enumerate("xyz")}
        | {f"pose.orientation.{part}": flight.pose[:, 3 + k].copy() for k, part in enumerate("wxyz")},
        "/rotorfit/velocity": {"header.stamp": flight.velocity_stamp, "log_time": flight.velocity_received}
        | _twist(flight.velocity),
        "/rotorfit/battery": {"header.stamp": flight.battery_stamp, "log_time": flight.battery_received}
        | {"percentage": flight.battery},
    }
    digest = hashlib.sha256(b"".join(column.tobytes() for table in tables.values() for column in table.values()))
    named = {name: Table(name, columns) for name, columns in tables.items()}
    return Log(Path(f"room-{flight.seed}"), "simulated", digest.hexdigest(), named, skipped={})


def _twist(values: Array) -> dict[str, Array]:
    """Columns of a TwistStamped with x, y, z and yaw."""
    zero = np.zeros(len(values))
    linear = {f"twist.linear.{axis}": values[:, k].copy() for k, axis in enumerate("xyz")}
    return linear | {"twist.angular.x": zero, "twist.angular.y": zero, "twist.angular.z": values[:, 3].copy()}
