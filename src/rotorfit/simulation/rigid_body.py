"""Six degrees of freedom: a rigid body under four lagging rotors, drag and wind, flown by its autopilot. Compiled.

    p' = v                                     world, z up
    v' = R e_z F / m - g e_z - R D R^T (v - w)
    q' = q * (0, omega) / 2                    body to world
    I omega' = M - omega x I omega
    f_i' = (s k_i c_i - f_i) / T               rotor thrust behind its command c_i; s falls with the battery's voltage

F is the sum of the thrusts f_i, M their moment; k_i is 1 except for a weak rotor. Between two nodes (the grid of
`max_step`, the instants of measurements, arrivals of commands, time-outs, changes of the vehicle) one classic
Runge-Kutta step is taken, with the autopilot's laws evaluated in each stage. The nodes do not depend on how often or
up to which time the kernel is called, so a flight in one piece and one in many agree bit for bit.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from rotorfit.core.compiled import kernel
from rotorfit.core.limits import GRAVITY
from rotorfit.simulation.change import Change
from rotorfit.simulation.vehicle import Four, Vehicle

# State, by index
POSITION, VELOCITY, QUATERNION, RATES, THRUST, GAIN, CHARGE, SEEN = 0, 3, 6, 10, 13, 17, 18, 19
"""Position, velocity (world), quaternion w x y z, body rates, rotor thrusts, learnt thrust gain, charge of the battery;
the first `SEEN` elements are stored for every shot."""

FADE, LOAD, ROTORS, STATES = 19, 20, 21, 25
"""Share of the thrust that a failing battery has left, learnt factor on the mass, learnt factors on the rotors."""

# Progress, whole numbers by index
TIME, NEXT_EVENT, NEXT_SHOT, MODE, HEARD, LAST, STEPS, REGIME, PROGRESS = 0, 1, 2, 3, 4, 5, 6, 7, 8
"""Time [ns], next event, next shot, mode, whether a command has arrived, when the last one arrived [ns], steps taken,
index of the regime of the vehicle that applies."""

GROUNDED, TAKING_OFF, FLYING, LANDING = 0, 1, 2, 3

COMMANDED, TAKE_OFF, LAND = 0, 1, 2  # kinds of events

MAX_STEP = 4_000_000  # ns; docs/flight-room.md has what halving it changes

WIND_STEP = 20_000_000  # ns between the nodes of the wind; a multiple of the step

NEVER = np.iinfo(np.int64).max

LEAST_COSINE = 0.5  # beyond a tilt of 60 deg the thrust is no longer increased to hold the height

_DTYPE = np.dtype(
    [
        *[(name, "f8") for name in ("mass", "lever", "least", "most", "rotor_time", "torque_ratio")],
        *[(name, "f8") for name in ("stiffness", "rate_gain", "rate_limit", "slope_limit", "velocity", "climb")],
        *[(name, "f8") for name in ("climb_acceleration", "yaw", "yaw_acceleration", "speed_up", "speed_down")],
        *[(name, "f8") for name in ("take_off_height", "flight_time", "sag", "land_below", "floor")],
        *[(name, "f8") for name in ("learning", "load", "fade_rate")],
        *[(name, "f8", (3,)) for name in ("inertia", "drag")],
        ("rotors", "f8", (4,)),
        *[(name, "i8") for name in ("tilts", "brakes", "timeout", "land_after")],
    ]
)


def parameters(vehicle: Vehicle, floor: float) -> npt.NDArray[Any]:
    """Parameters of a vehicle above a floor [m] for the kernel, shape (1,)."""
    record = np.zeros(1, _DTYPE)
    rotors, attitude, loops, pilot = vehicle.rotors, vehicle.attitude, vehicle.loops, vehicle.autopilot
    values = {
        "mass": vehicle.mass, "inertia": vehicle.inertia, "drag": vehicle.drag,
        "lever": rotors.arm / np.sqrt(2), "least": rotors.thrust[0], "most": rotors.thrust[1],
        "rotor_time": rotors.time_constant, "torque_ratio": rotors.torque_ratio,
        "stiffness": attitude.frequency / (2 * attitude.damping),
        "rate_gain": 2 * attitude.damping * attitude.frequency,
        "rate_limit": attitude.rate_limit, "slope_limit": np.tan(attitude.tilt_limit),
        "velocity": loops.velocity, "climb": loops.climb, "climb_acceleration": loops.climb_acceleration,
        "yaw": loops.yaw, "yaw_acceleration": loops.yaw_acceleration,
        "speed_up": pilot.take_off_speed, "speed_down": pilot.landing_speed,
        "take_off_height": pilot.take_off_height,
        "flight_time": vehicle.battery.flight_time, "sag": vehicle.battery.sag,
        "land_below": vehicle.battery.land_below, "floor": floor,
        "learning": pilot.learning, "load": 1.0, "rotors": 1.0,
        "tilts": vehicle.command.horizontal == "tilt", "brakes": pilot.brakes_on_zero,
        "timeout": _nanoseconds(pilot.command_timeout), "land_after": _nanoseconds(pilot.land_after),
    }  # fmt: skip
    for name, value in values.items():
        record[name] = value
    return record


def regimes(first: npt.NDArray[Any], changes: Sequence[Change]) -> tuple[npt.NDArray[np.int64], npt.NDArray[Any]]:
    """Parameters of a changing vehicle for the kernel.

    A failing battery makes two regimes, one in which its thrust falls and one after that.

    Args:
        first: The vehicle before the changes, from `parameters`, shape (1,).
        changes: In any order.

    Returns:
        When each regime begins, shape (P,) [ns], the first at 0; and its parameters, shape (P,).
    """
    instant = {0} | {_nanoseconds(one.time) for one in changes}
    instant |= {_nanoseconds(one.time + one.fade_time) for one in changes if one.fade > 0}
    starts = np.array(sorted(instant), np.int64)
    records = np.repeat(first, starts.size)
    for one in changes:
        after = starts >= _nanoseconds(one.time)
        records["load"][after] *= one.mass
        records["drag"][after] /= one.mass
        records["rotors"][after] *= one.rotors
        fading = after & (starts < _nanoseconds(one.time + one.fade_time))
        records["fade_rate"][fading] -= one.fade / one.fade_time
    return starts, records


def initial_state(vehicle: Vehicle, start: Four, flying: bool, charge: float, floor: float) -> npt.NDArray[np.float64]:
    """State of hovering at x, y, z, yaw with level rotors, or of standing on the floor there, shape (STATES,)."""
    state = np.zeros(STATES)
    state[POSITION : POSITION + 3] = start[:3] if flying else (*start[:2], floor)
    state[QUATERNION], state[QUATERNION + 3] = np.cos(start[3] / 2), np.sin(start[3] / 2)
    state[THRUST : THRUST + 4] = vehicle.mass * GRAVITY / 4 if flying else 0.0
    state[GAIN] = 1 - vehicle.battery.sag * (1 - charge)
    state[CHARGE] = charge
    state[FADE:STATES] = 1.0
    return state


def _nanoseconds(seconds: float) -> int:
    return NEVER if np.isinf(seconds) else round(seconds * 1e9)


@kernel()
def _thrust_commands(par, collective, roll, pitch, yaw, out):  # type: ignore[no-untyped-def]
    """Rotor commands for a collective [N] and moments [N m]: tilt takes priority, then collective, then yaw.

    The rotors are front left, front right, rear right, rear left; the first and third turn clockwise.
    """
    r, p, y = roll / (4 * par.lever), pitch / (4 * par.lever), yaw / (4 * par.torque_ratio)
    widest = 2 * (abs(r) + abs(p))
    room = par.most - par.least
    if widest > room:
        r, p, widest = r * room / widest, p * room / widest, room
    middle = min(max(collective / 4, par.least + widest / 2), par.most - widest / 2)
    out[0], out[1], out[2], out[3] = middle + r - p, middle - r - p, middle - r + p, middle + r + p
    share = 1.0
    for i in range(4):
        turn = y if i % 2 == 0 else -y
        if turn > 0 and out[i] + turn > par.most:
            share = min(share, (par.most - out[i]) / turn)
        elif turn < 0 and out[i] + turn < par.least:
            share = min(share, (par.least - out[i]) / turn)
    for i in range(4):
        out[i] += share * (y if i % 2 == 0 else -y)


@kernel()
def _slope(par, s, target, holds, wind, command, out):  # type: ignore[no-untyped-def]
    """Time derivative of the state `s` under the targets of the autopilot; `command` is work space of four numbers."""
    w, x, y, z = s[6], s[7], s[8], s[9]
    r11, r21, r31 = 1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)
    r12, r22, r32 = 2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)
    r13, r23, r33 = 2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)
    level = 1 / np.sqrt(r11 * r11 + r21 * r21)
    hx, hy = r11 * level, r21 * level  # direction of the nose

    # Outer loops: slopes of the thrust's direction in the heading frame, and vertical acceleration
    forward, left = target[0], target[1]
    if holds:
        forward = par.velocity * (target[0] - hx * s[3] - hy * s[4]) / GRAVITY
        left = par.velocity * (target[1] + hy * s[3] - hx * s[4]) / GRAVITY
        steep = np.sqrt(forward * forward + left * left)
        if steep > par.slope_limit:
            forward, left = forward * par.slope_limit / steep, left * par.slope_limit / steep
    lift = par.climb * (target[2] - s[5])
    lift = GRAVITY + min(max(lift, -par.climb_acceleration), par.climb_acceleration)
    collective = par.mass * s[20] * lift / max(r33, LEAST_COSINE) / s[17]

    # Attitude loop: the shortest rotation from the thrust's direction to the wanted one, in the body frame
    length = np.sqrt(1 + forward * forward + left * left)
    dx, dy, dz = (hx * forward - hy * left) / length, (hy * forward + hx * left) / length, 1 / length
    bx, by, bz = r11 * dx + r21 * dy + r31 * dz, r12 * dx + r22 * dy + r32 * dz, r13 * dx + r23 * dy + r33 * dz
    half = max(np.sqrt(max((1 + bz) / 2, 0.0)), 0.05)
    roll_rate, pitch_rate = -par.stiffness * by / half, par.stiffness * bx / half
    fast = np.sqrt(roll_rate * roll_rate + pitch_rate * pitch_rate)
    if fast > par.rate_limit:
        roll_rate, pitch_rate = roll_rate * par.rate_limit / fast, pitch_rate * par.rate_limit / fast
    turning = (s[11] * r32 + s[12] * r33) / (r32 * r32 + r33 * r33)  # heading's rate; the tilt turns with the heading
    turn = min(max(par.yaw * (target[3] - turning), -par.yaw_acceleration), par.yaw_acceleration)
    inertia = par.inertia
    _thrust_commands(
        par, collective,
        inertia[0] * par.rate_gain * (roll_rate + turning * r31 - s[10]) / s[17],
        inertia[1] * par.rate_gain * (pitch_rate + turning * r32 - s[11]) / s[17],
        inertia[2] * turn / s[17], command,
    )  # fmt: skip

    # Rotors and battery
    gain = (1 - par.sag * (1 - s[18])) * s[19]
    for i in range(4):
        if s[21 + i] != 1.0:  # the learnt factor of a rotor is applied on top of the mixer's command
            command[i] = min(command[i] / s[21 + i], par.most)
        out[13 + i] = (gain * par.rotors[i] * command[i] - s[13 + i]) / par.rotor_time
        out[21 + i] = (par.rotors[i] - s[21 + i]) / par.learning
    thrust = s[13] + s[14] + s[15] + s[16]
    out[17] = (gain - s[17]) / par.learning
    effort = thrust / (par.mass * GRAVITY)
    out[18] = -effort * np.sqrt(effort) / par.flight_time
    out[19] = par.fade_rate
    out[20] = (par.load - s[20]) / par.learning

    # Rigid body
    ax, ay, az = s[3] - wind[0], s[4] - wind[1], s[5] - wind[2]
    drag = par.drag
    fx = -drag[0] * (r11 * ax + r21 * ay + r31 * az)
    fy = -drag[1] * (r12 * ax + r22 * ay + r32 * az)
    fz = -drag[2] * (r13 * ax + r23 * ay + r33 * az) + thrust / (par.mass * par.load)
    out[0], out[1], out[2] = s[3], s[4], s[5]
    out[3] = r11 * fx + r12 * fy + r13 * fz
    out[4] = r21 * fx + r22 * fy + r23 * fz
    out[5] = r31 * fx + r32 * fy + r33 * fz - GRAVITY
    p, q, r = s[10], s[11], s[12]
    out[6] = -0.5 * (x * p + y * q + z * r)
    out[7] = 0.5 * (w * p + y * r - z * q)
    out[8] = 0.5 * (w * q + z * p - x * r)
    out[9] = 0.5 * (w * r + x * q - y * p)
    roll = par.lever * (s[13] - s[14] - s[15] + s[16])
    pitch = par.lever * (-s[13] - s[14] + s[15] + s[16])
    yaw = par.torque_ratio * (s[13] - s[14] + s[15] - s[16])
    out[10] = (roll - (inertia[2] - inertia[1]) * q * r) / inertia[0]
    out[11] = (pitch - (inertia[0] - inertia[2]) * p * r) / inertia[1]
    out[12] = (yaw - (inertia[1] - inertia[0]) * p * q) / inertia[2]


@kernel()
def _step(par, state, target, holds, wind, start, end, room):  # type: ignore[no-untyped-def]
    """One classic Runge-Kutta step between two instants [ns]; the wind is linear between its nodes."""
    slope, trial, total, air, command = room[0], room[1], room[2], room[3, :3], room[4, :4]
    h = (end - start) * 1e-9
    row = start // WIND_STEP
    total[:] = 0.0
    slope[:] = 0.0
    for k in range(4):  # the start, twice the middle, the end
        half = (k + 1) // 2
        place = (start + half * 0.5 * (end - start)) / WIND_STEP - row
        for j in range(3):
            air[j] = wind[row, j] + place * (wind[row + 1, j] - wind[row, j])
        for j in range(STATES):
            trial[j] = state[j] + 0.5 * half * h * slope[j]
        _slope(par, trial, target, holds, air, command, slope)
        for j in range(STATES):
            total[j] += slope[j] * (2.0 if half == 1 else 1.0)
    for j in range(STATES):
        state[j] += h / 6 * total[j]
    norm = np.sqrt(state[6] ** 2 + state[7] ** 2 + state[8] ** 2 + state[9] ** 2)
    for j in range(6, 10):
        state[j] /= norm


@kernel()
def _settle_on_floor(par, state):  # type: ignore[no-untyped-def]
    """The floor stops all motion and levels the vehicle; its heading is kept."""
    state[2] = par.floor
    state[3:6] = 0.0
    state[10:13] = 0.0
    norm = np.sqrt(state[6] ** 2 + state[9] ** 2)
    state[6], state[7], state[8], state[9] = state[6] / norm, 0.0, 0.0, state[9] / norm


@kernel()
def _hear(par, kind, asked, held, progress, instant):  # type: ignore[no-untyped-def]
    """Applies an event that has arrived to the held command, or to the mode."""
    if kind == COMMANDED:
        held[:] = asked
        if par.tilts:  # a tilt of t gives a horizontal acceleration of g tan(t)
            held[0], held[1] = np.tan(asked[0]), np.tan(asked[1])
        progress[HEARD], progress[LAST] = 1, instant
    elif kind == TAKE_OFF and progress[MODE] == GROUNDED:
        progress[MODE] = TAKING_OFF
    elif kind == LAND and progress[MODE] != GROUNDED:
        progress[MODE] = LANDING


@kernel()
def _aim(par, held, progress, target):  # type: ignore[no-untyped-def]
    """Fills the targets of the outer loops; returns whether the first two are velocities to hold (not slopes)."""
    target[:] = 0.0
    mode = progress[MODE]
    if mode == TAKING_OFF:
        target[2] = par.speed_up
    elif mode == LANDING:
        target[2] = -par.speed_down
    elif progress[HEARD] and progress[TIME] - progress[LAST] < par.timeout:
        target[:] = held
        return not par.tilts or (par.brakes == 1 and held[0] == 0.0 and held[1] == 0.0)
    return True


@kernel()
def _change_mode(par, state, progress):  # type: ignore[no-untyped-def]
    """Handles touch-down, the end of the take-off, and automatic landing."""
    if state[2] <= par.floor and state[5] <= 0.0:
        _settle_on_floor(par, state)
        if progress[MODE] == LANDING:
            progress[MODE] = GROUNDED
            state[13:17] = 0.0
    if progress[MODE] == TAKING_OFF and state[2] >= par.floor + par.take_off_height:
        progress[MODE], progress[HEARD], progress[LAST] = FLYING, 0, progress[TIME]
    if progress[MODE] == FLYING and (state[18] < par.land_below or progress[TIME] - progress[LAST] >= par.land_after):
        progress[MODE] = LANDING


@kernel()
def advance(  # type: ignore[no-untyped-def]
    starts, parameter, state, held, progress, until, arrival, kind, asked, count, shot, shots, seen, wind, max_step
):
    """Advances to the last node up to `until`; stores the state at every shot on the way.

    Args:
        starts: When the vehicle's regimes begin, shape (P,) [ns].
        parameter: Parameters of each regime, from `regimes`, shape (P,).
        state: Shape (STATES,), updated.
        held: Targets of the last command that arrived, shape (4,), updated.
        progress: Integers, see above, shape (PROGRESS,), updated.
        until: Instant [ns].
        arrival: When events arrive, in order; the first `count` are valid [ns].
        kind: COMMANDED, TAKE_OFF or LAND.
        asked: Setpoints of commands: rad or m/s, forward and left; m/s up; rad/s; shape (., 4).
        count: Number of events.
        shot: Instants at which the state is stored, in order; the first `shots` are valid [ns].
        shots: Number of shots.
        seen: The state at the shots, shape (., SEEN), filled as far as flown.
        wind: Air velocity at multiples of WIND_STEP, world, shape (., 3) [m/s].
        max_step: Longest step [ns].
    """
    room, target = np.empty((5, STATES)), np.zeros(4)
    while True:
        now = progress[TIME]
        while progress[REGIME] + 1 < starts.size and starts[progress[REGIME] + 1] <= now:
            progress[REGIME] += 1
        par = parameter[progress[REGIME]]
        while progress[NEXT_SHOT] < shots and shot[progress[NEXT_SHOT]] <= now:
            seen[progress[NEXT_SHOT]] = state[:SEEN]
            progress[NEXT_SHOT] += 1
        while progress[NEXT_EVENT] < count and arrival[progress[NEXT_EVENT]] <= now:
            row = progress[NEXT_EVENT]
            _hear(par, kind[row], asked[row], held, progress, arrival[row])
            progress[NEXT_EVENT] += 1
        end = (now // max_step + 1) * max_step
        if progress[NEXT_SHOT] < shots:
            end = min(end, shot[progress[NEXT_SHOT]])
        if progress[NEXT_EVENT] < count:
            end = min(end, arrival[progress[NEXT_EVENT]])
        if progress[REGIME] + 1 < starts.size:
            end = min(end, starts[progress[REGIME] + 1])
        silent = now - progress[LAST]
        if silent < par.timeout:
            end = min(end, now + (par.timeout - silent))
        if end > until:
            return
        if progress[MODE] != GROUNDED:
            holds = _aim(par, held, progress, target)
            _step(par, state, target, holds, wind, now, end, room)
            progress[STEPS] += 1
        progress[TIME] = end
        if progress[MODE] != GROUNDED:
            _change_mode(par, state, progress)
