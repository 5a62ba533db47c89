"""Random commands, the resulting motion computed in two ways, and the walk from change to change."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.integrate import solve_ivp

from rotorfit.core.frames import AXES, Array
from rotorfit.core.laws import LIMIT, ORDER, WORLD, law_of, structure_named
from rotorfit.core.model import Model, Predictor
from rotorfit.dynamics.trajectory import simulate

DENSE = 2.5e-4
"""Step of the reference [s]: `simulate` holds the heading over its steps, so turning it is exact to their square."""


@dataclass(frozen=True)
class Drive:
    """Commands, and where the motion starts.

    Attributes:
        stamp: Increasing, shape (M,) [s].
        command: Shape (M, 4).
        time: When the state is wanted, shape (N,) [s].
        pose: World, shape (4,).
        velocity: World, shape (4,).
        dt: Distance of the stamps where they are regular; 0 else.
    """

    stamp: Array
    command: Array
    time: Array
    pose: Array
    velocity: Array
    dt: float


def drive(seed: int, dt: float = 0.02, duration: float = 20.0, turning: bool = True, heading: float = 0.7) -> Drive:
    """Random commands held for random times, from a state that moves; dt 0 for irregular stamps."""
    size = 0.4
    rng = np.random.default_rng(seed)
    if dt:
        stamp = dt * np.arange(round(duration / dt))
        time = dt * np.arange(1, stamp.size + 1)
        command = np.repeat(rng.uniform(-size, size, (stamp.size // 5 + 1, 4)), 5, axis=0)[: stamp.size]
    else:
        stamp = np.cumsum(rng.uniform(0.004, 0.2, int(duration / 0.1)))
        stamp, time = stamp[stamp < duration], np.linspace(0.1, duration, 200)
        command = rng.uniform(-size, size, (stamp.size, 4))
    pose, velocity = np.array([0.3, -0.2, 1.1, heading]), np.array([0.4, -0.3, 0.2, 0.5])
    if not turning:
        command[:, 3], velocity[3] = 0.0, 0.0
    return Drive(stamp, command, time, pose, velocity, dt)


def reference(model: Model, given: Drive) -> Array:
    """The model's own simulation at the times, shape (N, 8)."""
    fine = np.unique(np.concatenate([[0.0], np.arange(0.0, given.time[-1], DENSE), given.time]))
    motion = simulate(model, given.stamp, given.command, fine, given.pose, given.velocity, given.command[0])
    return np.hstack([motion.pose, motion.velocity])[np.searchsorted(fine, given.time)]


def integrated(model: Model, given: Drive) -> Array:
    """The laws as they are written on paper, integrated by DOP853 from one change of a command to the next."""
    law = {axis: _numbers(model, axis) for axis in AXES}
    delay = np.array([(model.axes[axis].predictor or Predictor(0.0, 0.0, 0.0)).delay for axis in AXES])
    state = np.concatenate([given.pose, given.velocity, np.zeros(4)])
    state[8:] = _settled(law, state, given.command[0])

    def flow(state: Array, acting: Array, duration: float) -> Array:
        if duration <= 0:
            return state
        args = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-13}
        return solve_ivp(lambda _, s: _rate(law, s, acting), (0.0, duration), state, **args).y[:, -1]  # type: ignore[no-any-return]

    return walked(flow, state, delay, given)[:, :8]


def _numbers(model: Model, axis: str) -> Array:
    point = model.axes[axis].predictor
    if point is None:
        return law_of(structure_named("first_order"), 0.0, 0.0, 0.0, {})
    return law_of(structure_named(model.axes[axis].structure), point.input, point.damping, point.delay, point.extra)


def _demands(law: dict[str, Array], u: Array) -> list[float]:
    out = []
    for k, axis in enumerate(AXES):
        g, s, D, L, h = law[axis][[0, 5, 7, 6, 10]]
        size = min(max(abs(u[k]) - D, 0.0), L)
        other = u[1 - k] if k < 2 else 0.0
        out.append(g * (1 + s * np.sign(u[k])) * size * np.sign(u[k]) + h * other)
    return out


def _along(state: Array) -> list[float]:
    c, s = np.cos(state[3]), np.sin(state[3])
    return [c * state[4] + s * state[5], c * state[5] - s * state[4], state[6], state[7]]


def _settled(law: dict[str, Array], state: Array, u: Array) -> list[float]:
    w = np.array(_demands(law, u))
    return [
        a if law[axis][ORDER] == 2 else b for axis, a, b in zip(AXES, _asked(law, w, _along(state)), w, strict=True)
    ]


def _asked(law: dict[str, Array], w: Array, v: list[float]) -> Array:
    """What second orders ask for, z alone and x with y within their limits."""
    asked = w - np.array([law[axis][1] for axis in AXES]) * v
    over = asked / np.array([law[axis][LIMIT] for axis in AXES])
    size = np.array([np.hypot(*over[:2])] * 2 + [abs(over[2]), abs(over[3])])
    limited = np.isfinite([law[axis][LIMIT] for axis in AXES])
    return np.asarray(np.where(limited, asked / np.maximum(1.0, size), asked))


def _rate(law: dict[str, Array], state: Array, u: Array) -> Array:
    v, w, a, dq = _along(state), _demands(law, u), np.zeros(4), np.zeros(4)
    asked = _asked(law, np.array(w), v)
    for k, axis in enumerate(AXES):
        b, T, m, V, cross = law[axis][[1, 4, 8, 9, 11]]
        drag = b * (1 - m + (m * abs(v[k]) / V if m else 0.0)) * v[k]
        q = state[8 + k]
        if law[axis][ORDER] == 2:
            a[k], dq[k] = q, (asked[k] - q) / T
        elif law[axis][ORDER] == 1:
            a[k], dq[k] = q - drag, (w[k] - q) / T
        else:
            a[k] = w[k] - drag - cross * (v[1 - k] if k < 2 else 0.0)
    orders = [law[axis][ORDER] for axis in AXES[:2]]
    if any(law[axis][WORLD] for axis in AXES[:2]) and max(orders) == 1:
        along = [state[8 + k] if order else w[k] for k, order in enumerate(orders)]
        dq[0] += v[3] * along[1] * (orders[0] == 1)
        dq[1] -= v[3] * along[0] * (orders[1] == 1)
    c, s = np.cos(state[3]), np.sin(state[3])
    return np.concatenate([state[4:8], [c * a[0] - s * a[1], s * a[0] + c * a[1], a[2], a[3]], dq])


def walked(flow: Callable[[Array, Array, float], Array], state: Array, delay: Array, given: Drive) -> Array:
    """The states at the times, by a motion that is known while no acting command changes."""
    changes = given.stamp[:, None] + delay
    inside = changes[(changes > 0) & (changes < given.time[-1])]
    events, out = np.unique(np.concatenate([[0.0], given.time, inside])), []
    wanted = set(given.time.tolist())
    for now, then in pairwise(events.tolist()):
        sent = [max(int(np.searchsorted(changes[:, k], now, side="right")) - 1, 0) for k in range(changes.shape[1])]
        acting = given.command[sent, range(changes.shape[1])]
        state = np.asarray(flow(state, acting, then - now), float).ravel()
        if then in wanted:
            out.append(state)
    return np.array(out)


def settled_lags(model: Model, given: Drive) -> Array:
    law = {axis: _numbers(model, axis) for axis in AXES}
    settled = _settled(law, np.concatenate([given.pose, given.velocity]), given.command[0])
    return np.array([q for axis, q in zip(AXES, settled, strict=True) if law[axis][ORDER]])
