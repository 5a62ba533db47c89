"""The virtual flight room: a vehicle, air, motion capture, radio and clocks; step by step, or a whole flight at once.

Both forms run the same compiled kernel over the same nodes with the same random numbers, so they agree bit for bit.
The simulator imports nothing of the estimator.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from rotorfit import rigid_body
from rotorfit.air import GustSource, Wind, wind_at_nodes
from rotorfit.frames import Array
from rotorfit.log import Log, Sample, Table
from rotorfit.sensors import (
    Clock,
    Frames,
    Integers,
    Mocap,
    in_order,
    mocap_frames,
    see_poses,
    see_velocities,
    velocity_frames,
)
from rotorfit.vehicle import Four, Radio, Vehicle

BLOCK = 20.0  # s of frames and wind that are drawn at a time
BATTERY_RATE = 1.0  # samples a second
WIND_PERIOD = rigid_body.WIND_STEP * 1e-9


@dataclass(frozen=True)
class Conditions:
    """Everything of a flight that is not the vehicle.

    Attributes:
        wind: How the air moves.
        mocap: Motion capture.
        radio: How commands travel; the vehicle's own where None.
        mocap_clock: Stamps of poses.
        vehicle_clock: Stamps of onboard velocities and of the battery.
        charge: Of the battery at the start, 0 to 1.
        floor: Height of the floor, world [m].
    """

    wind: Wind = field(default_factory=Wind)
    mocap: Mocap = field(default_factory=Mocap)
    radio: Radio | None = None
    mocap_clock: Clock = field(default_factory=Clock)
    vehicle_clock: Clock = field(default_factory=Clock)
    charge: float = 1.0
    floor: float = 0.0


@dataclass(frozen=True)
class TrueState:
    """What nobody in the room can see.

    Attributes:
        position: World [m].
        velocity: World [m/s].
        quaternion: Body to world, w, x, y, z.
        rates: About the body's axes [rad/s].
        charge: Of the battery, 0 to 1.
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
    """What was recorded, and beside it the truth at the poses. M commands, N poses, K velocities, B batteries.

    Attributes:
        vehicle: What flew.
        conditions: In what.
        seed: Of all randomness.
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
        battery: What is left, 0 to 1, shape (B,).
        true_instant: When each frame was really taken, shape (N,) [ns since the start].
        true_position: Then, world, shape (N, 3) [m].
        true_velocity: Then, world, shape (N, 3) [m/s].
        true_quaternion: Then, body to world, w, x, y, z, shape (N, 4).
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


MODES = ("grounded", "taking_off", "flying", "landing")


class _Stream:
    """Frames of one sensor: drawn in blocks, seen at shots of the kernel, given out when they arrive."""

    def __init__(self) -> None:
        self.frames: Frames | None = None
        self.row: Integers = np.empty(0, np.int64)
        self.given = 0
        self.arrivals: list[int] = []

    def extend(self, frames: Frames, row: Integers) -> None:
        old = self.frames
        if old is not None:
            parts = {name: np.concatenate([getattr(old, name), getattr(frames, name)]) for name in vars(frames)}
            frames = replace(frames, **parts)
        self.frames, self.row = frames, np.concatenate([self.row, row])
        self.arrivals = frames.arrival.tolist()

    def arrived(self, until: int) -> Integers:
        """Indices of the frames that have arrived since the last call and were not lost."""
        first, last, arrivals = self.given, self.given, self.arrivals
        while last < len(arrivals) and arrivals[last] <= until:
            last += 1
        self.given = last
        index = np.arange(first, last)
        return index if last == first or self.frames is None else index[self.frames.kept[first:last]]


class FlightRoom:
    """A vehicle in a room, step by step. Deterministic: everything follows from the arguments and the calls.

    Attributes:
        vehicle: What flies.
        conditions: Air, mocap, radio, clocks, battery, floor.
        now: True time since the start, which is also the clock of whoever sends and receives [ns].
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
            vehicle: What flies.
            conditions: Air, mocap, radio, clocks, battery, floor.
            seed: Of all randomness.
            start: x, y, z [m] and yaw [rad], world.
            flying: False: on the floor, rotors at rest.
            max_step: Longest step of the integration [ns].

        Raises:
            ValueError: A start below the floor; a step that does not divide the interval between nodes of the wind.
        """
        if start[2] < conditions.floor:
            raise ValueError(f"the start is at {start[2]:g} m, below the floor at {conditions.floor:g} m")
        if rigid_body.WIND_STEP % max_step:
            raise ValueError(f"a step of {max_step} ns does not divide {rigid_body.WIND_STEP} ns")
        self.vehicle, self.conditions, self.now = vehicle, conditions, 0
        self._seed = seed
        *drawn, radio = np.random.SeedSequence(seed).spawn(4)
        gust, *frames = (np.random.default_rng(one) for one in drawn)
        self._frame_rng, self._radio = frames, _RadioSource(conditions.radio or vehicle.radio, radio)
        self._bias = vehicle.odometry.bias * frames[1].standard_normal(3)
        self._gusts = GustSource(conditions.wind.gusts, WIND_PERIOD, gust)
        self._parameters = rigid_body.parameters(vehicle, conditions.floor)
        self._state = rigid_body.initial_state(vehicle, start, flying, conditions.charge, conditions.floor)
        self._held, self._progress = np.zeros(4), np.zeros(rigid_body.PROGRESS, np.int64)
        self._progress[rigid_body.MODE] = rigid_body.FLYING if flying else rigid_body.GROUNDED
        self._max_step = max_step
        self._event, self._events = _no_events(64), 0
        self._pose, self._velocity, self._battery = _Stream(), _Stream(), _Stream()
        self._shot = np.empty(0, np.int64)
        self._seen = np.empty((0, rigid_body.STATES))
        self._wind = np.empty((0, 3))
        self._blocks = 0

    def send(self, command: Sequence[float]) -> None:
        """Sends forward, left, up, counter-clockwise, in the unit of the vehicle's commands, now.

        Raises:
            ValueError: Not four finite numbers.
        """
        self._send(np.array([self.now]), np.array([command], float))

    def take_off(self) -> None:
        """Asks for a take-off, which a vehicle on the floor obeys."""
        self._ask(rigid_body.TAKE_OFF)

    def land(self) -> None:
        """Asks for a landing, which a vehicle in the air obeys."""
        self._ask(rigid_body.LAND)

    def advance(self, until: int) -> list[Sample]:
        """Lets time pass.

        Args:
            until: True time since the start [ns], not before `now`.

        Returns:
            The samples that arrived after the last call, by then, in the order of their arrival.

        Raises:
            ValueError: Time runs backwards.
        """
        self._fly(until)
        samples = [
            Sample(stream, stamp, arrival, tuple(row))
            for stream, stamps, arrivals, values in self._arrived(until)
            for stamp, arrival, row in zip(stamps.tolist(), arrivals.tolist(), values.tolist(), strict=True)
        ]
        return sorted(samples, key=lambda sample: sample.received) if len(samples) > 1 else samples

    def truth(self) -> TrueState:
        """The true state now."""
        state, held, progress = self._state.copy(), self._held.copy(), self._progress.copy()
        last = int(progress[rigid_body.TIME])
        if last < self.now and progress[rigid_body.MODE] != rigid_body.GROUNDED:  # the kernel stops at its last node
            instant = np.array([self.now])
            progress[rigid_body.NEXT_SHOT] = 0
            self._run(state, held, progress, self.now, instant, 1, np.empty((1, rigid_body.STATES)))
        s = state.tolist()
        return TrueState(
            (s[0], s[1], s[2]), (s[3], s[4], s[5]), (s[6], s[7], s[8], s[9]), (s[10], s[11], s[12]),
            s[rigid_body.CHARGE], MODES[progress[rigid_body.MODE]],
        )  # fmt: skip

    def _send(self, sent: Integers, commands: Array) -> None:
        """Sends commands at instants that are not before `now`, in order."""
        if commands.shape != (sent.size, 4) or not np.isfinite(commands).all():
            raise ValueError("a command is four finite numbers: forward, left, up, counter-clockwise")
        arrival, kept = self._radio.arrivals(sent)
        self._queue(arrival[kept], rigid_body.COMMANDED, targets(self.vehicle, commands[kept]))

    def _ask(self, kind: int) -> None:
        arrival = self._radio.arrival_of_request(self.now)
        self._queue(np.array([arrival]), kind, np.zeros((1, 4)))

    def _queue(self, arrival: Integers, kind: int, reference: Array) -> None:
        end = self._events + arrival.size
        while end > self._event[0].size:
            self._event = tuple(  # type: ignore[assignment]
                np.concatenate([old, new])
                for old, new in zip(self._event, _no_events(self._event[0].size), strict=True)
            )
        for column, values in zip(self._event, (arrival, kind, reference), strict=True):
            column[self._events : end] = values
        self._events = end

    def _fly(self, until: int) -> None:
        if until < self.now:
            raise ValueError(f"time runs backwards: {until} ns is before {self.now} ns")
        while until >= self._blocks * BLOCK * 1e9:
            self._draw_block()
        self._run(self._state, self._held, self._progress, until, self._shot, self._shot.size, self._seen)
        self.now = until

    def _run(
        self, state: Array, held: Array, progress: Integers, until: int, shot: Integers, shots: int, seen: Array
    ) -> None:
        rigid_body.advance(
            self._parameters, state, held, progress, until, *self._event, self._events,
            shot, shots, seen, self._wind, self._max_step,
        )  # fmt: skip

    def _draw_block(self) -> None:
        """Wind and frames of the next `BLOCK` seconds; one node of the wind beyond them, for the line that leads there."""
        first, count = len(self._wind), round(BLOCK / WIND_PERIOD) + (2 if self._blocks == 0 else 0)
        air = wind_at_nodes(self.conditions.wind, first, count, WIND_PERIOD, self._gusts.draw(count))
        self._wind = np.concatenate([self._wind, air])
        self._blocks += 1
        streams = (self._pose, self._velocity, self._battery)
        drawn = [self._draw(stream, rate) for stream, rate in zip(streams, self._rates(), strict=True)]
        instant = np.concatenate([frames.instant for frames in drawn])
        order = np.argsort(instant, kind="stable")
        row = np.empty(instant.size, np.int64)
        row[order] = self._shot.size + np.arange(instant.size)
        for stream, frames, rows in zip(
            streams, drawn, np.split(row, np.cumsum([f.instant.size for f in drawn])[:-1]), strict=True
        ):
            stream.extend(frames, rows)
        self._shot = np.concatenate([self._shot, instant[order]])
        self._seen = np.concatenate([self._seen, np.zeros((instant.size, rigid_body.STATES))])

    def _rates(self) -> tuple[float, float, float]:
        return self.conditions.mocap.rate, self.vehicle.odometry.rate, BATTERY_RATE

    def _draw(self, stream: _Stream, rate: float) -> Frames:
        """The frames of a stream up to the end of the blocks drawn so far."""
        end = self._blocks * BLOCK
        first = 0 if stream.frames is None else stream.frames.instant.size
        count = int(np.ceil(end * rate - 1e-6)) - first
        if stream is self._pose:
            old = stream.frames
            before = (-1, 0) if old is None else (int(old.shown[-1]), int(old.arrival[-1]))
            return mocap_frames(
                self.conditions.mocap, self.conditions.mocap_clock, first, count, before, self._frame_rng[0]
            )
        clock, odometry = self.conditions.vehicle_clock, self.vehicle.odometry
        if stream is self._velocity:
            return velocity_frames(odometry, clock, first, count, self._bias, self._frame_rng[1])
        still = replace(odometry, rate=rate, noise=0.0, yaw_noise=0.0)
        return velocity_frames(still, clock, first, count, np.zeros(3), self._frame_rng[1])

    def _record(self, sent: Integers, commands: Array, end: int) -> RoomFlight:
        """Flies on to the end, in one piece."""
        self._fly(end)
        pose = self._pose.arrived(end)
        frames = self._pose.frames
        assert frames is not None
        self._pose.given = 0
        empty = np.empty(0, np.int64)
        got = {name: (stamp, arrival, values) for name, stamp, arrival, values in self._arrived(end)}
        nothing = {"pose": (empty, empty, np.empty((0, 7))), "velocity": (empty, empty, np.empty((0, 4)))}
        (ps, pr, pv), (vs, vr, vv), (bs, br, bv) = (
            got.get(name, nothing.get(name, (empty, empty, np.empty((0, 1)))))
            for name in ("pose", "velocity", "battery")
        )
        true = self._seen[self._pose.row[pose]]
        return RoomFlight(
            self.vehicle, self.conditions, self._seed, sent, np.asarray(commands, np.float64), ps, pr, pv, vs, vr, vv,
            bs, br, bv[:, 0], frames.instant[pose], true[:, :3], true[:, 3:6], true[:, 6:10],
        )  # fmt: skip

    def _arrived(self, until: int):  # type: ignore[no-untyped-def]
        """Stream, stamps, arrivals and values of what has arrived since the last call."""
        for name, stream in (("pose", self._pose), ("velocity", self._velocity), ("battery", self._battery)):
            index = stream.arrived(until)
            if index.size and stream.frames is not None:
                frames = stream.frames
                yield name, frames.stamp[index], frames.arrival[index], self._values(name, stream, frames, index)

    def _values(self, name: str, stream: _Stream, frames: Frames, index: Integers) -> Array:
        shown = frames.shown[index]
        if name == "battery":
            return self._seen[stream.row[shown], rigid_body.CHARGE :]
        out = np.empty((index.size, 7 if name == "pose" else 4))
        if name == "pose":
            see_poses(self._seen, stream.row, shown, frames.error, frames.shift, out)
        else:
            see_velocities(self._seen, stream.row, shown, frames.error, out)
        return out


class _RadioSource:
    """When commands arrive; drawn by the index of the command."""

    def __init__(self, radio: Radio, seed: np.random.SeedSequence) -> None:
        self._radio, self._last = radio, 0
        self._late, self._lost = (np.random.default_rng(one) for one in seed.spawn(2))

    def arrivals(self, sent: Integers) -> tuple[Integers, npt.NDArray[np.bool_]]:
        """Arrival of each command sent now or later [ns], and whether it arrives at all."""
        late = self._radio.jitter * self._late.standard_exponential(sent.size)
        arrival = in_order(sent, self._radio.latency, late, self._last)
        self._last = int(arrival[-1]) if sent.size else self._last
        return arrival, self._lost.random(sent.size) >= self._radio.loss

    def arrival_of_request(self, now: int) -> int:
        """Of a take-off or a landing: never lost, never late, but after the commands sent before."""
        self._last = max(self._last, now + round(self._radio.latency * 1e9))
        return self._last


def _no_events(count: int) -> tuple[Integers, Integers, Array]:
    """Room for arrivals, kinds and targets."""
    return np.zeros(count, np.int64), np.zeros(count, np.int64), np.zeros((count, 4))


def targets(vehicle: Vehicle, commands: Array) -> Array:
    """What commands ask of the autopilot, cut at the vehicle's limits, shape (N, 4).

    Args:
        vehicle: Says what they mean.
        commands: Forward, left, up, counter-clockwise, in the unit of its commands, shape (N, 4).

    Returns:
        Tangents of tilts, or m/s, forward and left; m/s up; rad/s.
    """
    limits = np.array(vehicle.limits())
    asked = np.clip(commands * np.array(vehicle.full_scale()), -limits, limits)
    if vehicle.command.horizontal == "tilt":
        asked[:, :2] = np.tan(asked[:, :2])
    return asked


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
    """Flies commands that are known beforehand: the same as a `FlightRoom` to which they are sent one by one.

    Args:
        vehicle: What flies; it hovers at the start.
        conditions: Air, mocap, radio, clocks, battery, floor.
        stamps: When each command is sent, in order, shape (M,) [ns since the start].
        commands: Forward, left, up, counter-clockwise, in the unit of the vehicle's commands, shape (M, 4).
        duration: Until when samples are received [s].
        seed: Of all randomness.
        start: x, y, z [m] and yaw [rad], world.
        max_step: Longest step of the integration [ns].

    Raises:
        ValueError: Stamps before the start or out of order; as `FlightRoom`.
    """
    sent = np.asarray(stamps, np.int64)
    if sent.size and (sent[0] < 0 or (np.diff(sent) < 0).any()):
        raise ValueError("stamps of commands must not be negative, and in order")
    room, end = FlightRoom(vehicle, conditions, seed, start, max_step=max_step), round(duration * 1e9)
    room._send(sent, np.asarray(commands, np.float64))
    return room._record(sent, commands, end)


def as_log(flight: RoomFlight) -> Log:
    """The flight as a log in memory, topics and columns as the recorder writes them; `vehicle.card()` reads it."""
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
    """Columns of a TwistStamped that holds x, y, z and yaw."""
    zero = np.zeros(len(values))
    linear = {f"twist.linear.{axis}": values[:, k].copy() for k, axis in enumerate("xyz")}
    return linear | {"twist.angular.x": zero, "twist.angular.y": zero, "twist.angular.z": values[:, 3].copy()}
