"""A flight of the paper's vehicle as a log: in memory, and as a bag.

The paper's vehicle: its eq. (5) with a delay, slow wind, motion capture, and a known truth.

    p' = v
    v' = R(psi) (G_B u(t - tau) - G_A R(psi)^T v + c) + w      G_A, G_B diagonal; c trim, in the heading frame
    w' = -w / T + noise                                        slow wind, in the world

and the same law for yaw: the paper's eq. (5) with delay, trim and wind. Plain Runge-Kutta steps lead from one switching
instant to the next, including the turning heading. No formula is shared with the estimator.
"""

import functools
import hashlib
import struct
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np
import numpy.typing as npt

from rotorfit.core.errors import LogError
from rotorfit.core.frames import AXES, Array, quaternion_from_yaw
from rotorfit.core.log import Log, Table
from rotorfit.simulation.published import PUBLISHED

Integers = npt.NDArray[np.int64]

Places = npt.NDArray[np.int32]

Flags = npt.NDArray[np.bool_]

Four = tuple[float, float, float, float]  # one value for each of x, y, z, yaw

Excitation = Callable[[Array], Array]  # commands as a function of time since the start: (N,) [s] -> (N, 4)

Function = TypeVar("Function", bound=Callable[..., Any])


def _gamma(name: str) -> tuple[float, ...]:
    """gamma_1..gamma_8 of eq. (4) as published: input and damping of x, y, z, yaw in turn."""
    return next(cast("tuple[float, ...]", known.gamma) for known in PUBLISHED if known.name == name)


GAMMA_A, GAMMA_B, GAMMA_C, GAMMA_E, GAMMA_F = (_gamma(name) for name in "ABCEF")

STABLE = {"A": GAMMA_A, "B": GAMMA_B, "E": GAMMA_E, "F": GAMMA_F, "C": (*GAMMA_C[:7], GAMMA_B[7])}
"""Published vehicles with four stable axes; C's yaw is unstable as published and gets the damping of B."""

HOVER_HEIGHT = 2.0  # m, where a flight starts, at rest, above the world's origin

WIND_PERIOD = 0.01  # s between the nodes of the wind, see `_wind`


@dataclass(frozen=True)
class Truth:
    """Vehicle, air and room of a simulated flight. The defaults are a Bebop 2 in a quiet motion-capture room.

    Attributes:
        gamma: The paper's eight coefficients, shape (8,) [m/s^2 or rad/s^2 per unit of command; 1/s].
        delay: From a command's stamp to its effect, for x, y, z, yaw [s]; not negative.
        trim: Constant acceleration in the heading frame [m/s^2; rad/s^2 for yaw].
        wind_sigma: Standard deviation of the slow disturbance, in the world frame [m/s^2; rad/s^2 for yaw].
        wind_time: Its correlation time [s].
        mocap_noise: Standard deviation of the mocap's white error [m; rad for yaw].
        stale_share: Share of frames that repeat the last pose with a fresh stamp, drawn independently.
        pose_rate: Mocap frame rate [Hz].
        pose_jitter: A frame is taken up to this much late, uniform [s]; its stamp is the true instant.
        command_rate: Command rate [Hz]; each command is held until the next one arrives.
        command_jitter: A command is sent up to this much late, uniform [s]; its stamp is the true instant.

    Raises:
        ValueError: An impossible value.
    """

    gamma: tuple[float, ...] = GAMMA_B
    delay: Four = (0.15, 0.15, 0.15, 0.15)
    trim: Four = (0.0, 0.0, 0.0, 0.0)
    wind_sigma: Four = (0.02, 0.02, 0.02, 0.008)
    wind_time: Four = (1.0, 1.0, 1.0, 1.0)
    mocap_noise: Four = (0.0005, 0.0005, 0.0005, 0.001)
    stale_share: float = 0.08
    pose_rate: float = 120.0
    pose_jitter: float = 0.0002
    command_rate: float = 50.0
    command_jitter: float = 0.002

    def __post_init__(self) -> None:
        four = (self.delay, self.trim, self.wind_sigma, self.wind_time, self.mocap_noise)
        if len(self.gamma) != 8 or {len(value) for value in four} != {4}:
            raise ValueError("gamma has 8 values; delay, trim, wind_sigma, wind_time and mocap_noise have 4 each")
        if min(self.delay + self.wind_sigma + self.mocap_noise) < 0 or min(self.wind_time) <= 0:
            raise ValueError("delay, wind_sigma and mocap_noise must not be negative, wind_time must be positive")
        rates = ((self.pose_rate, self.pose_jitter), (self.command_rate, self.command_jitter))
        if not (0 <= self.stale_share < 1 and all(rate > 0 and 0 <= jitter * rate <= 0.5 for rate, jitter in rates)):
            raise ValueError("stale_share must be in [0, 1), rates positive, the jitter at most half a period")


@dataclass(frozen=True)
class Controller:
    """Tracks a reference from the measured pose alone, by default the start pose; adds its command to the excitation.

    u = (stiffness (r - pose) + damping (r' - velocity) + r'' + b r') / g in the heading frame, with the velocity from
    filtered differences of the measured poses, and the input g and damping b that it assumes.

    Attributes:
        stiffness: Demanded acceleration per position error, for all axes or each [1/s^2].
        damping: Demanded acceleration per velocity error, for all axes or each [1/s].
        filter_time: Time constant of that filter [s].
        axes: Axes on which it acts.
        gamma: Coefficients that it assumes, shape (8,); None for the truth.
        reference: Times since the start (N,) [s] -> position, velocity, acceleration relative to the start, forward,
            left, up and counter-clockwise of it, each (N, 4). None holds the start.
        full_scale: Bound of the whole command, including the excitation.
    """

    stiffness: float | Four = 1.0
    damping: float | Four = 1.6
    filter_time: float = 0.05
    axes: tuple[str, ...] = AXES
    gamma: tuple[float, ...] | None = None
    reference: Callable[[Array], tuple[Array, Array, Array]] | None = None
    full_scale: Four = (np.inf,) * 4


@dataclass(frozen=True)
class SimulatedFlight:
    """A recorded flight, with the truth at the same stamps; M commands, N poses; x, y, z, yaw.

    Attributes:
        truth: The truth that was simulated.
        seed: Seed of all its randomness.
        command_stamp: When each command was sent, shape (M,) [ns since the start].
        command: In the heading frame, shape (M, 4), fractions of full scale.
        pose_stamp: When each frame was taken, shape (N,) [ns since the start].
        pose: Measured, world, yaw not wrapped, shape (N, 4) [m, rad].
        stale: Whether the frame repeats the previous pose, shape (N,).
        true_pose: World, shape (N, 4) [m, rad].
        velocity: True, world, shape (N, 4) [m/s, rad/s].
        acceleration: True, world, shape (N, 4) [m/s^2, rad/s^2]; at a switching instant, the value just after it.
        wind: The disturbance, world, shape (N, 4) [m/s^2, rad/s^2].
    """

    truth: Truth
    seed: int
    command_stamp: Integers
    command: Array
    pose_stamp: Integers
    pose: Array
    stale: Flags
    true_pose: Array
    velocity: Array
    acceleration: Array
    wind: Array

    @property
    def quaternion(self) -> Array:
        """The measured yaw as w, x, y, z, shape (N, 4); the tilt of the vehicle is not simulated."""
        return quaternion_from_yaw(self.pose[:, 3])


def noise_free(truth: Truth) -> Truth:
    """The same vehicle without wind, in a room with an error-free mocap that repeats no frame."""
    return replace(truth, wind_sigma=(0.0,) * 4, mocap_noise=(0.0,) * 4, stale_share=0.0)


@dataclass(frozen=True)
class Draw:
    """A vehicle with all stamps and all that is random in its flight: whatever its commands do not change.

    Attributes:
        truth: Vehicle, air and room.
        seed: Seed of all randomness.
        held: Whether commands are samples.
        command_stamp: When each command is sent, shape (M,) [ns since the start].
        pose_stamp: When each frame is taken, shape (N,) [ns since the start].
        noise: Error of the mocap, shape (N, 4) [m, rad].
        stale: Whether the frame repeats the previous pose, shape (N,).
        node: Times of the wind, shape (J,) [s].
        gust: The wind at these times, shape (J, 4) [m/s^2, rad/s^2].
        time: The grid of the integration, shape (T,) [s].
        wind: The wind on the grid, shape (T, 4) [m/s^2, rad/s^2].
        row: Row of the commands that acts on each axis in each interval of the grid, shape (T - 1, 4), see `_fly`.
        pose_at: Frame that is taken at each instant of the grid, or -1, shape (T,).
        command_at: Command that is sent at each instant of the grid, or -1, shape (T,).
    """

    truth: Truth
    seed: int
    held: bool
    command_stamp: Integers
    pose_stamp: Integers
    noise: Array
    stale: Flags
    node: Array
    gust: Array
    time: Array
    wind: Array
    row: Places
    pose_at: Places
    command_at: Places


def draw(truth: Truth, duration: float, seed: int, *, held: bool = True, max_step: float = 0.002) -> Draw:
    """Draws stamps, air and noise of a flight; arguments as for `simulate_flight`."""
    stamp_rng, wind_rng, noise_rng = map(np.random.default_rng, np.random.SeedSequence(seed).spawn(3))
    pose_stamp = _stamps(duration, truth.pose_rate, truth.pose_jitter, stamp_rng)
    command_stamp = _stamps(duration, truth.command_rate, truth.command_jitter, stamp_rng) if held else pose_stamp
    seen, sent = _seconds(pose_stamp), _seconds(command_stamp)
    node, gust = _wind(truth, duration, wind_rng)
    time = _grid(duration, seen, sent, truth.delay, node, max_step)
    return Draw(
        truth=truth, seed=seed, held=held, command_stamp=command_stamp, pose_stamp=pose_stamp,
        noise=np.array(truth.mocap_noise) * noise_rng.standard_normal((seen.size, 4)),
        stale=(noise_rng.random(seen.size) < truth.stale_share) & (seen > seen[0]),
        node=node, gust=gust, time=time, wind=_interpolated(time, node, gust),
        row=_held_rows(time, sent, truth.delay) if held else _smooth_rows(time), pose_at=_places(time, seen),
        command_at=_places(time, sent),
    )  # fmt: skip


def draw_evenly(truth: Truth, duration: float, seed: int, *, max_step: float) -> Draw:
    """Draws as `draw`, for a path alone: on a regular grid, an order of magnitude fewer steps, with the same wind.

    Commands have no jitter, a pose is taken at each instant of the grid, and delays are rounded to whole steps.
    """
    _, wind_rng, noise_rng = map(np.random.default_rng, np.random.SeedSequence(seed).spawn(3))
    each = int(np.ceil(1 / (truth.command_rate * max_step) - 1e-9))  # steps from one command to the next
    step = 1 / (truth.command_rate * each)
    at = np.arange(int(np.ceil(duration / step - 1e-9)))
    time = step * np.arange(at.size + 1, dtype=np.float64)
    stamp = np.round(time[:-1] * 1e9).astype(np.int64)
    node, gust = _wind(truth, duration, wind_rng)
    late = np.rint(np.array(truth.delay) / step).astype(np.int64)
    return Draw(
        truth=truth, seed=seed, held=True, command_stamp=stamp[::each], pose_stamp=stamp,
        noise=np.array(truth.mocap_noise) * noise_rng.standard_normal((at.size, 4)),
        stale=(noise_rng.random(at.size) < truth.stale_share) & (at > 0),
        node=node, gust=gust, time=time, wind=_interpolated(time, node, gust),
        row=np.maximum((at[:, None] - late) // each + 1, 0).astype(np.int32),
        pose_at=np.append(at, -1).astype(np.int32),
        command_at=np.append(np.where(at % each == 0, at // each, -1), -1).astype(np.int32),
    )  # fmt: skip


def simulate_flight(
    truth: Truth,
    excitation: Excitation,
    duration: float,
    seed: int,
    *,
    held: bool = True,
    controller: Controller | None = None,
    initial_yaw: float = 0.0,
    max_step: float = 0.002,
) -> SimulatedFlight:
    """Simulates a flight from rest at (0, 0, `HOVER_HEIGHT`). The command is zero until the first one arrives.

    Args:
        truth: Vehicle, air and room.
        excitation: Commands as a function of time; with a controller, added to its commands.
        duration: Duration of commands and poses [s].
        seed: Seed of wind, noise, stale frames and jitter, which do not depend on vehicle, excitation or controller.
        held: Commands are samples, each held until the next one arrives. False: the vehicle responds to the function
            itself, u(t - tau), and the log holds its value u(t) at the stamp of every pose.
        controller: Closes the loop on the measured pose; needs held commands.
        initial_yaw: Heading at the start [rad].
        max_step: Longest step of the integration [s]. Steps never cross an instant at which anything switches.

    Raises:
        ValueError: A controller without held commands.
    """
    if controller and not held:
        raise ValueError("a controller sends samples: it needs held commands")
    return flown(draw(truth, duration, seed, held=held, max_step=max_step), excitation, controller, initial_yaw)


def flown(
    drawn: Draw, excitation: Excitation, controller: Controller | None = None, initial_yaw: float = 0.0
) -> SimulatedFlight:
    """The flight of a vehicle from a draw; arguments and result as for `simulate_flight`."""
    truth, sent = drawn.truth, _seconds(drawn.command_stamp)
    command = excitation(sent)
    value = np.concatenate([np.zeros((1, 4)), command]) if drawn.held else _smooth(drawn, excitation)
    value = np.ascontiguousarray(value)  # for another layout, `_fly` would be compiled once more
    start = np.array([0.0, 0.0, HOVER_HEIGHT, initial_yaw])
    gains, reference = _steering(controller or Controller(axes=()), truth, sent, start)
    state, acceleration, pose = _compiled(_fly)(
        drawn.time, drawn.wind, value, drawn.row, 0 if drawn.held else 1,
        drawn.pose_at, drawn.noise, drawn.stale, drawn.command_at if controller else np.full_like(drawn.command_at, -1),
        gains, reference, start, np.array(truth.gamma, float), np.array(truth.trim, float),
    )  # fmt: skip
    return SimulatedFlight(
        truth=truth, seed=drawn.seed, command_stamp=drawn.command_stamp,
        command=value[1:] if drawn.held else command,  # including the controller's contribution
        pose_stamp=drawn.pose_stamp, pose=pose, stale=drawn.stale, true_pose=state[:, :4], velocity=state[:, 4:],
        acceleration=acceleration, wind=_interpolated(_seconds(drawn.pose_stamp), drawn.node, drawn.gust),
    )  # fmt: skip


def _seconds(stamps: Integers) -> Array:
    return stamps.astype(np.float64) * 1e-9


def _stamps(duration: float, rate: float, jitter: float, rng: np.random.Generator) -> Integers:
    """Regular instants before the end, each up to `jitter` late [ns]."""
    due = np.arange(int(np.ceil(duration * rate))) / rate
    stamps = np.round((due + jitter * rng.random(due.size)) * 1e9).astype(np.int64)
    return stamps[stamps < round(duration * 1e9)]


def _wind(truth: Truth, duration: float, rng: np.random.Generator) -> tuple[Array, Array]:
    """Node times (J,) and an Ornstein-Uhlenbeck disturbance at them (J, 4), exact at the nodes from the first on.

    It is interpolated linearly between the nodes, which for a correlation time T loses (h / T)^2 / 12 of the variance
    of the wind's impulse: 8e-6 for 1 s.
    """
    node = np.arange(np.ceil(duration / WIND_PERIOD) + 1, dtype=np.float64) * WIND_PERIOD
    memory = np.exp(-WIND_PERIOD / np.array(truth.wind_time))
    normal = rng.standard_normal((node.size, 4))
    return node, np.array(truth.wind_sigma) * _compiled(_slow)(normal, memory)


def _slow(normal: Array, memory: Array) -> Array:
    """Stationary first-order Markov sequence of unit variance, shape (J, 4), from white normal numbers. Compiled."""
    slow = normal.copy()
    for j in range(1, normal.shape[0]):
        for a in range(4):
            slow[j, a] = memory[a] * slow[j - 1, a] + np.sqrt(1 - memory[a] ** 2) * normal[j, a]
    return slow


def _grid(duration: float, poses: Array, commands: Array, delay: Four, node: Array, max_step: float) -> Array:
    """Every instant at which something switches or is sampled, and sufficiently many in between [s]."""
    arrivals = [commands + tau for tau in sorted(set(delay))]
    events = np.unique(np.concatenate([[0.0, *delay, duration], poses, commands, *arrivals, node]))
    events = events[events <= duration]
    gap = np.diff(events)
    parts = np.maximum(np.ceil(gap / max_step - 1e-9), 1).astype(np.int64)
    index = np.repeat(np.arange(gap.size), parts)
    part = np.arange(index.size) - (np.cumsum(parts) - parts)[index]
    return np.append(events[index] + gap[index] * (part / parts[index]), events[-1])


def _places(time: Array, asked: Array) -> Places:
    """Index of each instant of the grid among the requested instants, or -1."""
    places = np.full(time.size, -1, np.int32)
    places[np.searchsorted(time, asked)] = np.arange(asked.size)
    return places


def _interpolated(time: Array, node: Array, value: Array) -> Array:
    """Linear interpolation of values at nodes, shape (J, A), at times between the first and the last, shape (N, A)."""
    return np.asarray(_compiled(_between)(time, node, value))


def _between(time: Array, node: Array, value: Array) -> Array:
    """`numpy.interp` for all columns at once; fast for increasing times. Compiled."""
    out, j = np.empty((time.size, value.shape[1])), 0
    for n in range(time.size):
        while j > 0 and node[j] > time[n]:
            j -= 1
        while j + 1 < node.size and node[j + 1] <= time[n]:
            j += 1
        for a in range(value.shape[1]):
            out[n, a] = value[j, a]
            if j + 1 < node.size:
                out[n, a] += (value[j + 1, a] - value[j, a]) / (node[j + 1] - node[j]) * (time[n] - node[j])
    return out


def _held_rows(time: Array, sent: Array, delay: Four) -> Places:
    """Rows of held commands for `_fly`; row 0 is the hover before the first command. Midpoints select the row."""
    middle = (time[:-1] + time[1:]) / 2
    # there are fewer commands than intervals: locate each command among the intervals, then count those before each
    first = [np.searchsorted(middle, sent + tau, side="right") for tau in delay]
    return np.stack([np.cumsum(np.bincount(each, minlength=time.size)[:-1]) for each in first], axis=1).astype(np.int32)


def _smooth_rows(time: Array) -> Places:
    """Rows of smooth commands for `_fly`: three per interval, the same for all axes."""
    return np.repeat(3 * np.arange(time.size - 1, dtype=np.int32)[:, None], 4, axis=1)


def _smooth(drawn: Draw, excitation: Excitation) -> Array:
    """Values at start, middle and end of each interval, with the delay included: hover until it has passed."""
    time = drawn.time
    middle = (time[:-1] + time[1:]) / 2
    stage = np.stack([time[:-1], middle, time[1:]], axis=1).ravel()
    sides = [excitation(stage - tau)[:, a] * (np.repeat(middle, 3) > tau) for a, tau in enumerate(drawn.truth.delay)]
    return np.stack(sides, axis=1)


def _steering(controller: Controller, truth: Truth, sent: Array, start: Array) -> tuple[Array, Array]:
    """Parameters of a controller for the compiled loop.

    Returns:
        Rows stiffness, damping, input, damping of the vehicle, full scale, filter time (of all axes): shape (6, 4).
        Position, velocity and acceleration of the reference in the world, at the commands, shape (3, M, 4).
    """
    acting = np.isin(AXES, controller.axes).astype(float)
    gamma = np.array(controller.gamma or (*truth.gamma,), float)
    rows = [
        acting * np.broadcast_to(controller.stiffness, 4), acting * np.broadcast_to(controller.damping, 4),
        gamma[::2], gamma[1::2], np.array(controller.full_scale), np.full(4, controller.filter_time),
    ]  # fmt: skip
    reference = np.zeros((3, sent.size, 4))
    if controller.reference:
        asked = np.stack(controller.reference(sent)) * acting
        c, s = np.cos(start[3]), np.sin(start[3])
        reference[:] = asked
        reference[..., 0], reference[..., 1] = (
            c * asked[..., 0] - s * asked[..., 1],
            s * asked[..., 0] + c * asked[..., 1],
        )
    reference[0] += start
    return np.stack(rows), reference


@functools.cache
def _compiled(function: Function) -> Function:
    """The compiled function; numba is imported late, as it takes longer than `--help` may."""
    from rotorfit.core.compiled import kernel

    return cast("Function", kernel()(function))


def _fly(
    time: Array, wind: Array, value: Array, row: Places, stride: int,
    pose_at: Places, noise: Array, stale: Flags, steered_at: Places,
    gains: Array, reference: Array, start: Array, gamma: Array, trim: Array,
) -> tuple[Array, Array, Array]:  # fmt: skip
    """Integrates over the grid; takes a pose at `pose_at`, adds the controller's command to `value` at `steered_at`.

    In interval n the command on axis a is `value[row[n, a] + stride * (0, 1, 2)]` at its start, middle and end.
    Returns, at the poses, the state (N, 8), its acceleration (N, 4) and the measured pose (N, 4).
    """
    state, slope, trial, total = np.zeros(8), np.zeros(8), np.zeros(8), np.zeros(8)
    states, accelerations, measured = np.empty((stale.size, 8)), np.empty((stale.size, 4)), np.empty((stale.size, 4))
    state[:4] = start
    seen, speed, seen_at, force, asked = start.copy(), np.zeros(4), 0.0, np.zeros(4), np.zeros((4, 4))
    for n in range(time.size - 1):
        pose = pose_at[n]
        if pose >= 0:  # a controller cannot recognise a stale frame: it differences the poses it receives
            since, seen_at = time[n] - seen_at, time[n]
            for a in range(4):
                shown = seen[a] if stale[pose] else state[a] + noise[pose, a]
                if gains[5, a] + since > 0:
                    speed[a] += (shown - seen[a] - speed[a] * since) / (gains[5, a] + since)
                seen[a] = shown
                measured[pose, a] = shown
            for j in range(8):
                states[pose, j] = state[j]
        if steered_at[n] >= 0:
            m, c, s = steered_at[n], np.cos(seen[3]), np.sin(seen[3])
            for a in range(4):  # element by element: a sum of rows would allocate at every command
                asked[0, a], asked[1, a] = reference[0, m, a] - seen[a], reference[1, m, a] - speed[a]
                asked[2, a], asked[3, a] = reference[2, m, a], reference[1, m, a]
            for k in range(4):
                asked[k, 0], asked[k, 1] = c * asked[k, 0] + s * asked[k, 1], c * asked[k, 1] - s * asked[k, 0]
            for a in range(4):
                wanted = gains[0, a] * asked[0, a] + gains[1, a] * asked[1, a] + asked[2, a] + gains[3, a] * asked[3, a]
                command = value[1 + m, a] + wanted / gains[2, a]
                value[1 + m, a] = min(max(command, -gains[4, a]), gains[4, a])
        h = time[n + 1] - time[n]
        total[:] = 0.0
        for k in range(4):  # the classic Runge-Kutta stages: the start, twice the middle, the end
            half = (k + 1) // 2
            for j in range(8):
                trial[j] = state[j] + 0.5 * half * h * slope[j]
            c, s = np.cos(trial[3]), np.sin(trial[3])
            body = (c * trial[4] + s * trial[5], c * trial[5] - s * trial[4], trial[6], trial[7])
            for a in range(4):
                command = value[row[n, a] + stride * half, a]
                force[a] = gamma[2 * a] * command - gamma[2 * a + 1] * body[a] + trim[a]
            force[0], force[1] = c * force[0] - s * force[1], s * force[0] + c * force[1]
            for a in range(4):
                slope[a] = trial[4 + a]
                slope[4 + a] = force[a] + wind[n, a] + 0.5 * half * (wind[n + 1, a] - wind[n, a])
            if k == 0 and pose >= 0:
                for a in range(4):
                    accelerations[pose, a] = slope[4 + a]
            for j in range(8):
                total[j] += slope[j] * (2.0 if half == 1 else 1.0)
        for j in range(8):
            state[j] += h / 6 * total[j]
    return states, accelerations, measured


LOG_LATENESS = 1_000_000  # ns: a message is logged up to this long after its stamp

LOG_EPOCH = 1_577_836_800 * 10**9  # ns: 2020-01-01, added to the stamps of a log so that they look like real ones


def as_log(flight: SimulatedFlight) -> Log:
    """The flight as a log in memory: `/cmd_vel` (TwistStamped) and `/pose` (PoseStamped), with the columns of a bag."""
    names = {
        "/cmd_vel": [f"twist.{part}.{axis}" for part in ("linear", "angular") for axis in "xyz"],
        "/pose": [*(f"pose.position.{axis}" for axis in "xyz"), *(f"pose.orientation.{axis}" for axis in "xyzw")],
    }
    numbers = {
        "/cmd_vel": np.insert(flight.command, [3, 3], 0.0, axis=1),
        "/pose": np.column_stack([flight.pose[:, :3], np.roll(flight.quaternion, -1, axis=1)]),
    }
    rng, digest, tables = np.random.default_rng(flight.seed), hashlib.sha256(), {}
    for topic, stamp in (("/cmd_vel", flight.command_stamp), ("/pose", flight.pose_stamp)):
        late = rng.integers(0, LOG_LATENESS, stamp.size)
        columns = {"header.stamp": LOG_EPOCH + stamp, "log_time": LOG_EPOCH + stamp + late}
        fields = dict(zip(names[topic], np.ascontiguousarray(numbers[topic].T), strict=True))
        tables[topic] = Table(topic, columns | fields)
        digest.update(b"".join(column.tobytes() for column in tables[topic].columns.values()))
    return Log(Path(f"simulated-{flight.seed}"), "simulated", digest.hexdigest(), tables, skipped={})


def write_bag(flight: SimulatedFlight, path: Path) -> None:
    """Writes the flight as a ROS 1 bag; the same flight gives the same bytes. A message is its fields, little-endian.

    Raises:
        LogError: The file already exists; a log is never overwritten.
    """
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    if path.exists():
        raise LogError(f"{path} exists already and a log is never overwritten: remove it or choose another name")
    store, tables, messages = get_typestore(Stores.ROS1_NOETIC), as_log(flight).tables, []
    with Writer(path) as bag:
        for topic, kind in (("/cmd_vel", "TwistStamped"), ("/pose", "PoseStamped")):
            connection = bag.add_connection(topic, f"geometry_msgs/msg/{kind}", typestore=store)
            stamps, log_times, *fields = (column.tolist() for column in tables[topic].columns.values())
            layout = struct.Struct(f"<4I5s{len(fields)}d")  # header: sequence, stamp, frame; then the numbers
            for sequence, (stamp, log_time, *row) in enumerate(zip(stamps, log_times, *fields, strict=True)):
                header = (sequence, *divmod(stamp, 10**9), 5, b"world")
                messages.append((log_time, connection, layout.pack(*header, *row)))
        for log_time, connection, message in sorted(messages, key=lambda entry: entry[0]):
            bag.write(connection, log_time, message)
