"""The exact response: against a fine numerical integration, and its sensitivities against differences."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest

from rotorfit.core.laws import DAMPING, DELAY, GAIN, LAG, TRIM, ZERO, law_of, structure_named
from rotorfit.dynamics.general_response import motion_response
from rotorfit.dynamics.general_step import MEAN, START
from rotorfit.dynamics.horizontal_response import horizontal_response, plane_response
from rotorfit.dynamics.lagged_response import lagged_axis_response
from rotorfit.dynamics.response import axis_response, transition

Array = np.ndarray


# The case: commands at jittered stamps, poses at others, two segments


@dataclass(frozen=True)
class Case:
    """What the kernels are given: two stretches of commands with a hole between, blocks of poses of unequal size."""

    starts: Array
    pose_range: Array
    command_range: Array
    pose_time: Array
    block: Array
    command_time: Array
    command: Array
    weight: Array
    yaw: Array
    parameters: Mapping[str, Array] = field(default_factory=dict)

    @property
    def common(self) -> tuple[Array, ...]:
        return (self.starts, self.pose_range, self.command_range, self.pose_time, self.block, self.command_time)


PARAMETERS = {
    "gain": np.array([3.7, 4.1]),
    "trim": np.array([0.05, -0.11]),
    "damping": np.array([0.4, 2.3]),
    "delay": np.array([0.137, 0.211]),
    "velocity": np.array([[0.3, -0.2], [-0.4, 0.15]]),
}


def case(turn: float = 0.0, heading: float = 0.4, seed: int = 0, pose_rate: float = 100.0, **changed: Array) -> Case:
    """Two segments of 2.4 s and 1.6 s; the heading, linear between the poses, swings by `turn` [rad/s]."""
    rng = np.random.default_rng(seed)
    sent = [start + np.arange(n) / 15 + 0.02 * rng.random(n) for start, n in ((0.0, 45), (4.0, 34))]
    command_time = np.concatenate(sent)
    command = np.ascontiguousarray(0.2 * rng.standard_normal((command_time.size, 2)))
    seen = []
    for first, span in ((0.6, 2.4), (4.6, 1.6)):
        due = first + np.arange(0, span, 1 / pose_rate)
        seen.append(due + 0.6 / pose_rate * rng.random(due.size))
    sizes = [rng.integers(1, 5, t.size) for t in seen]
    block, offset = [], 0
    for t, size in zip(seen, sizes, strict=True):
        block.append(offset + np.repeat(np.arange(t.size), size)[: t.size])
        offset = block[-1][-1] + 1
    pose_time, blocks = np.concatenate(seen), np.concatenate(block).astype(np.int64)
    return Case(
        starts=np.array([0.6, 4.6]),
        pose_range=np.array([[0, seen[0].size], [seen[0].size, pose_time.size]]),
        command_range=np.array([[0, 45], [45, 79]]),
        pose_time=pose_time,
        block=blocks,
        command_time=command_time,
        command=command,
        weight=1.0 / np.bincount(blocks),
        yaw=heading + turn * np.sin(pose_time),
        parameters=PARAMETERS | changed,
    )


def axis_columns(c: Case, j: int = 0) -> Array:
    """Columns of one axis, shape (B, 5)."""
    p = {name: value[..., j] for name, value in c.parameters.items()}
    out: Array = axis_response(
        *c.common, np.ascontiguousarray(c.command[:, j]), c.weight,
        float(p["gain"]), float(p["trim"]), float(p["damping"]), float(p["delay"]), np.ascontiguousarray(p["velocity"]),
    )  # fmt: skip
    return out[:, :, 0]


def plane_columns(c: Case) -> Array:
    """Columns of both axes, shape (B, 10, 2)."""
    p = c.parameters
    out: Array = plane_response(
        *c.common, c.command, c.weight, c.yaw, p["gain"], p["trim"], p["damping"], p["delay"], p["velocity"]
    )
    return out


def segment_of(c: Case) -> Array:
    """Which segment each block belongs to, shape (B,)."""
    out: Array = np.searchsorted(c.block[c.pose_range[:, 0]], np.arange(c.weight.size), side="right") - 1
    return out


def axis_position(c: Case, j: int = 0) -> Array:
    """Position of one axis, put together as the docstring says, shape (B,)."""
    columns, p = axis_columns(c, j), c.parameters
    out: Array = (
        p["gain"][j] * columns[:, 0] + p["trim"][j] * columns[:, 1] + p["velocity"][segment_of(c), j] * columns[:, 4]
    )
    return out


def plane_position(c: Case) -> Array:
    """World position, put together as the docstring says, shape (B, 2)."""
    columns, p = plane_columns(c), c.parameters
    out: Array = (
        np.einsum("j,bjk->bk", p["gain"], columns[:, 0:2])
        + np.einsum("j,bjk->bk", p["trim"], columns[:, 2:4])
        + np.einsum("bj,bjk->bk", p["velocity"][segment_of(c)], columns[:, 8:10])
    )
    return out


# Another way to the same: small Runge-Kutta steps from event to event


def integrated(c: Case, step: float = 1e-4, decoupled: bool = False) -> Array:
    """World position by Runge-Kutta of order 4, whose steps never cross a switch or a pose; block means, shape (B, 2).

    The heading turns through every step; `decoupled` keeps it at zero.
    """
    p = c.parameters
    gain, trim, damping, delay = p["gain"], p["trim"], p["damping"], p["delay"]
    out = np.zeros((c.weight.size, 2))
    for s, start in enumerate(c.starts):
        commands, poses = slice(*c.command_range[s]), slice(*c.pose_range[s])
        sent, u, seen = c.command_time[commands], c.command[commands], c.pose_time[poses]
        events = np.unique(np.concatenate([[start], seen, *(sent + tau for tau in delay)]))
        events = events[(events >= start) & (events <= seen[-1])]
        state = np.concatenate([np.zeros(2), p["velocity"][s]])
        at = dict(zip(seen.tolist(), c.block[poses].tolist(), strict=True))
        if start in at:
            out[at[start]] += c.weight[at[start]] * state[:2]
        for low, high in zip(events[:-1].tolist(), events[1:].tolist(), strict=True):
            middle = 0.5 * (low + high)
            held = [max(int(np.searchsorted(sent + tau, middle, side="right")) - 1, 0) for tau in delay]
            force = gain * u[held, [0, 1]] + trim
            heading = (0.0, 0.0) if decoupled else tuple(np.interp([low, high], seen, c.yaw[poses]))
            n = max(int(np.ceil((high - low) / step)), 1)
            state = runge_kutta(state, force, damping, heading, high - low, n)
            if high in at:
                out[at[high]] += c.weight[at[high]] * state[:2]
    return out


def runge_kutta(state: Array, force: Array, damping: Array, heading: tuple[float, ...], time: float, n: int) -> Array:
    """n steps of p' = v, v' = R (force - diag(damping) R^T v) while the heading turns evenly."""
    h = time / n

    def rate(x: Array, share: float) -> Array:
        psi = heading[0] + share * (heading[1] - heading[0])
        turn = np.array([[np.cos(psi), -np.sin(psi)], [np.sin(psi), np.cos(psi)]])
        return np.concatenate([x[2:], turn @ (force - damping * (turn.T @ x[2:]))])

    for i in range(n):
        a, m, b = i / n, (i + 0.5) / n, (i + 1) / n
        k1 = rate(state, a)
        k2 = rate(state + h / 2 * k1, m)
        k3 = rate(state + h / 2 * k2, m)
        k4 = rate(state + h * k3, b)
        state = state + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return state


# Closed forms


@pytest.mark.parametrize("j", [0, 1])
@pytest.mark.parametrize("delay", [-0.09, 0.0, 0.137, 0.55])
def test_an_axis_agrees_with_integration_from_event_to_event(j: int, delay: float) -> None:
    c = case(delay=np.array([delay, delay]))

    np.testing.assert_allclose(axis_position(c, j), integrated(c, 1e-3, decoupled=True)[:, j], rtol=0, atol=1e-11)


def test_the_plane_with_a_held_heading_agrees_with_integration() -> None:
    c = case(heading=2.5)

    np.testing.assert_allclose(plane_position(c), integrated(c, 1e-3), rtol=0, atol=1e-11)


def test_the_plane_at_heading_zero_is_two_axes() -> None:
    c = case(heading=0.0)
    plane = plane_columns(c)

    for j in range(2):
        np.testing.assert_allclose(plane[:, j::2, j], axis_columns(c, j), rtol=0, atol=1e-13)
        np.testing.assert_array_equal(plane[:, j::2, 1 - j], 0.0)


def test_the_plane_with_a_turning_heading_agrees_with_integration_and_better_at_a_higher_pose_rate() -> None:
    """The heading is taken at the middle of each step: an error of second order in it, micrometres at 100 Hz."""
    errors = []
    for rate in (50.0, 100.0, 200.0):
        c = case(turn=1.2, pose_rate=rate)
        errors.append(float(np.abs(plane_position(c) - integrated(c, 1e-3)).max()))

    assert errors[1] < 1e-5
    assert errors[2] < 0.5 * errors[1] < 0.25 * errors[0]


def test_turning_the_world_turns_the_response() -> None:
    c, angle = case(turn=1.2), 1.9
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    velocity = c.parameters["velocity"] @ turn.T
    turned = replace(c, yaw=c.yaw + angle, parameters=c.parameters | {"velocity": velocity})

    np.testing.assert_allclose(plane_position(turned), plane_position(c) @ turn.T, rtol=0, atol=1e-13)


def test_block_means_are_means_of_the_response_at_the_poses() -> None:
    c = case(turn=1.2)
    n = c.pose_time.size
    single = replace(c, block=np.arange(n), weight=np.ones(n))

    means = np.stack([np.bincount(c.block, q) for q in plane_position(single).T], axis=1) * c.weight[:, None]
    np.testing.assert_allclose(plane_position(c), means, rtol=0, atol=1e-14)


def test_a_segment_knows_nothing_of_the_other() -> None:
    c = case(turn=1.2)
    other = c.command.copy()
    other[c.command_range[0, 0] : c.command_range[0, 1]] = 7.0

    second = segment_of(c) == 1
    np.testing.assert_array_equal(plane_columns(replace(c, command=other))[second], plane_columns(c)[second])


def test_a_command_of_a_later_stamp_changes_nothing_before_it_acts() -> None:
    c = case()
    other = c.command.copy()
    other[20:45] += 1.0
    acts = c.command_time[20] + c.parameters["delay"][0]

    changed = np.abs(axis_position(replace(c, command=other)) - axis_position(c)) > 0
    first_pose = np.full(c.weight.size, np.inf)
    np.minimum.at(first_pose, c.block, c.pose_time)
    last_pose = np.full(c.weight.size, -np.inf)
    np.maximum.at(last_pose, c.block, c.pose_time)
    in_first = segment_of(c) == 0
    np.testing.assert_array_equal(changed[in_first & (last_pose <= acts)], False)
    np.testing.assert_array_equal(changed[in_first & (first_pose > acts)], True)


# Sensitivities


def at_delay(c: Case, delay: float) -> Case:
    """The case with this delay on both axes."""
    return replace(c, parameters=dict(c.parameters) | {"delay": np.full(2, delay)})


def difference(c: Case, position: Any, name: str, index: tuple[int, ...], step: float) -> Array:
    """Central difference of the position by one parameter."""
    moved = []
    for sign in (1.0, -1.0):
        value = c.parameters[name].copy()
        value[index] += sign * step
        moved.append(position(replace(c, parameters=dict(c.parameters) | {name: value})))
    out: Array = (moved[0] - moved[1]) / (2 * step)
    return out


@pytest.mark.parametrize("j", [0, 1])
def test_sensitivities_of_an_axis_agree_with_differences_to_seven_digits(j: int) -> None:
    c = case()
    columns = axis_columns(c, j)

    for column, name in enumerate(("gain", "trim", "damping")):
        expected = difference(c, lambda x: axis_position(x, j), name, (j,), 1e-5)
        np.testing.assert_allclose(columns[:, column], expected, rtol=0, atol=1e-7 * np.abs(expected).max())


def test_the_sensitivity_to_the_start_velocity_is_that_of_the_own_segment() -> None:
    c = case(turn=1.2)
    segment, columns = segment_of(c), plane_columns(c)

    for s in range(2):
        for j in range(2):
            expected = difference(c, plane_position, "velocity", (s, j), 1e-4)
            own = np.where((segment == s)[:, None], columns[:, 8 + j], 0.0)
            np.testing.assert_allclose(own, expected, rtol=0, atol=1e-10)


@pytest.mark.parametrize("j", [0, 1])
def test_the_sensitivity_to_the_delay_agrees_to_six_digits_where_no_switch_meets_a_pose(
    j: int,
) -> None:
    """The response is once differentiable in the delay, piecewise smooth: differences that step over a pose err."""
    c = case()
    tau, step = c.parameters["delay"][j], 1e-6
    gap = np.abs(c.pose_time[:, None] - c.command_time - tau).min()
    assert gap > 2 * step

    expected = difference(c, lambda x: axis_position(x, j), "delay", (j,), step)
    np.testing.assert_allclose(axis_columns(c, j)[:, 3], expected, rtol=0, atol=1e-6 * np.abs(expected).max())


@pytest.mark.parametrize("name", ["gain", "trim", "damping"])
@pytest.mark.parametrize("j", [0, 1])
def test_sensitivities_of_a_turning_plane_agree_with_differences_to_seven_digits(name: str, j: int) -> None:
    """The steps do not depend on these parameters, so the sensitivities are exact for the discretised heading too."""
    c = case(turn=1.2)
    column = ("gain", "trim", "damping").index(name) * 2 + j

    expected = difference(c, plane_position, name, (j,), 1e-5)
    np.testing.assert_allclose(plane_columns(c)[:, column], expected, rtol=0, atol=1e-7 * np.abs(expected).max())


@pytest.mark.parametrize("j", [0, 1])
def test_the_sensitivity_of_a_turning_plane_to_the_delay_agrees_with_differences_to_a_thousandth(j: int) -> None:
    """Moving a switch also moves the middles of the steps beside it, where the heading is taken. The impulse leaves
    that out: it is the derivative of the exact response, the difference that of the discretised one."""
    c = case(turn=1.2)

    expected = difference(c, plane_position, "delay", (j,), 1e-6)
    error = np.abs(plane_columns(c)[:, 6 + j] - expected).max() / np.abs(expected).max()
    assert error < 1e-3


def test_the_sensitivity_of_a_plane_with_held_heading_to_the_delay_agrees_to_six_digits() -> None:
    c = case(heading=2.5)

    for j in range(2):
        expected = difference(c, plane_position, "delay", (j,), 1e-6)
        scale = np.abs(expected).max()
        np.testing.assert_allclose(plane_columns(c)[:, 6 + j], expected, rtol=0, atol=1e-6 * scale)


# Continuity


def a_delay_that_puts_a_switch_on_a_pose(c: Case) -> float:
    tau = float(c.pose_time[60] - c.command_time[12])
    assert 0.1 < tau < 0.6
    return tau


def test_the_response_is_continuous_in_the_delay_where_a_switch_passes_a_pose() -> None:
    """Delays that put a switch exactly on a pose, one ulp before and one after."""
    c = case(turn=1.2)
    tau = a_delay_that_puts_a_switch_on_a_pose(c)

    positions = [plane_position(at_delay(c, tau + shift)) for shift in (-1e-12, 0.0, 1e-12)]
    np.testing.assert_allclose(positions[0], positions[1], rtol=0, atol=1e-11)
    np.testing.assert_allclose(positions[2], positions[1], rtol=0, atol=1e-11)


def test_the_response_over_a_walk_of_the_delay_has_no_jumps() -> None:
    c = case(turn=1.2)
    walk = np.linspace(-0.1, 0.6, 701)
    positions = np.array([plane_position(at_delay(c, d)) for d in walk])

    slope = np.abs(np.diff(positions, axis=0)).max() / (walk[1] - walk[0])
    sensitivity = max(float(np.abs(plane_columns(at_delay(c, d))[:, 6:8]).max()) for d in walk[::50])
    assert slope < 3 * sensitivity


def test_the_sensitivity_to_the_delay_does_not_jump_either() -> None:
    c = case()
    tau = a_delay_that_puts_a_switch_on_a_pose(c)

    columns = [axis_columns(at_delay(c, tau + shift))[:, 3] for shift in (-1e-9, 1e-9)]
    np.testing.assert_allclose(columns[0], columns[1], rtol=0, atol=1e-8)


# Small and large damping


def exact_transition(b: float, dt: float) -> list[float]:
    """f, k, h and their derivatives by b, with 50 digits."""
    from decimal import Decimal, localcontext

    with localcontext() as context:
        context.prec = 60
        B, T = Decimal(b), Decimal(dt)
        f = (-B * T).exp()
        k = (1 - f) / B
        h = (T - k) / B
        df = -T * f
        dk = (T * f - k) / B
        dh = -(dk + h) / B
        return [float(value) for value in (f, k, h, df, dk, dh)]


@pytest.mark.parametrize("dt", [1e-5, 1 / 120, 0.1, 2.0])
@pytest.mark.parametrize("x", [1e-8, 1e-4, 0.01, 0.3, 0.4999999, 0.5, 0.5000001, 1.0, 10.0, 200.0])
def test_the_transition_is_exact_on_both_sides_of_the_switch_from_series_to_closed_form(x: float, dt: float) -> None:
    """f, k, h in units of 1, dt, dt^2 and their derivatives, dt times those: the series ends at x = 0.5 with 1e-7."""
    unit = np.array([1, dt, dt**2, dt, dt**2, dt**3])

    np.testing.assert_allclose(
        np.array(transition(x / dt, dt)) / unit, exact_transition(x / dt, dt) / unit, rtol=2e-7, atol=1e-15
    )


def test_without_damping_the_transition_is_that_of_a_free_mass() -> None:
    np.testing.assert_allclose(transition(0.0, 0.2), [1.0, 0.2, 0.02, -0.2, -0.02, -(0.2**3) / 6], rtol=1e-14)


@pytest.mark.parametrize("damping", [1e-3, 100.0])
def test_at_the_ends_of_the_searched_damping_the_response_agrees_with_integration(damping: float) -> None:
    c = case(damping=np.array([damping, damping]))

    np.testing.assert_allclose(axis_position(c), integrated(c, 2e-4, decoupled=True)[:, 0], rtol=0, atol=1e-10)


# One axis with a lag: the same as the general law


@pytest.mark.parametrize(
    ("structure", "extra"),
    [
        ("first_order_delay_lag", {"lag": 0.13}),
        ("first_order_lag", {"lag": 0.4}),
        ("second_order", {"lag": 0.2}),
        ("second_order_zero", {"lag": 0.2, "zero": 0.11}),
        ("second_order_zero", {"lag": 0.006, "zero": 0.3}),
    ],
)
def test_one_axis_with_a_lag_moves_and_answers_as_under_the_general_law(
    structure: str, extra: Mapping[str, float]
) -> None:
    some = case()
    wanted = structure_named(structure)
    law = law_of(wanted, 3.7, 1.4, 0.137 if wanted.delayed else 0.0, extra, trim=0.05)[None]
    velocity = PARAMETERS["velocity"][:, :1].copy()
    what, whose = np.array([MEAN, GAIN, DAMPING, DELAY, LAG, ZERO, TRIM, START]), np.zeros(8, np.int64)

    found = lagged_axis_response(*some.common, some.command[:, 0].copy(), some.weight, law, velocity[:, 0].copy())
    general = motion_response(
        *some.common, some.command[:, :1].copy(), some.weight, np.zeros(some.pose_time.size), law, what, whose, velocity
    )

    wanted_columns = [j for j, place in enumerate(what) if place != ZERO or wanted.order == 2]
    np.testing.assert_allclose(found[:, wanted_columns], general[:, wanted_columns], rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(
    ("structures", "lags"),
    [
        (("first_order_delay_lag", "first_order_delay_lag"), (0.12, 0.4)),
        (("first_order_delay_lag", "first_order_delay"), (0.006, 0.0)),
        (("first_order_delay", "first_order_lag"), (0.0, 1.7)),
        (("first_order_delay", "first_order_delay"), (0.0, 0.0)),
    ],
)
def test_two_axes_with_or_without_a_lag_move_and_answer_as_under_the_general_law(
    structures: tuple[str, str], lags: tuple[float, float]
) -> None:
    some, p = case(turn=0.8), PARAMETERS
    laws = [structure_named(name) for name in structures]
    law = np.array(
        [
            law_of(one, p["gain"][a], p["damping"][a], p["delay"][a] * one.delayed, {"lag": lags[a]}, p["trim"][a])
            for a, one in enumerate(laws)
        ]
    )
    what = np.array([MEAN, *np.repeat([GAIN, DAMPING, DELAY, LAG, TRIM, START], 2)])
    whose = np.array([0, *[0, 1] * 6])

    found = horizontal_response(*some.common, some.command, some.weight, some.yaw, law, p["velocity"])
    general = motion_response(*some.common, some.command, some.weight, some.yaw, law, what, whose, p["velocity"])

    there = [j for j in range(13) if what[j] != LAG or laws[whose[j]].order]
    np.testing.assert_allclose(found[:, there], general[:, there], rtol=1e-9, atol=1e-12)
