"""Laws that shape commands have a kernel of their own: it gives what the general law gives."""

from dataclasses import replace

import numpy as np
import pytest

from flights import flown, steps
from rotorfit.core.laws import STRUCTURES, TRIM, start_levels
from rotorfit.estimation.likelihood import block_response
from rotorfit.estimation.likelihood.blocks import Record, record
from rotorfit.estimation.likelihood.optima import start_point
from rotorfit.estimation.likelihood.parameters import Point
from rotorfit.simulation.paper_vehicle import Truth

SHAPED = {"saturation": 0.15, "dead_zone": 0.05, "climb_descent": 0.2}
"""The law's name, and a value of its shape that matters to commands of up to 0.3."""


@pytest.mark.parametrize(
    ("axes", "names"),
    [
        (("z",), ("saturation",)),
        (("z",), ("dead_zone",)),
        (("z",), ("climb_descent",)),
        (("x", "y"), ("saturation", "first_order_delay")),
        (("x", "y"), ("first_order_delay", "dead_zone")),
        (("x", "y"), ("dead_zone", "saturation")),
    ],
)
def test_a_law_that_shapes_commands_responds_as_the_general_law(axes: tuple[str, ...], names: tuple[str, ...]) -> None:
    rec = record(flown(Truth(), steps(), 12.0), axes)
    assert rec is not None
    structures = tuple(STRUCTURES[name] for name in names)
    extra = np.zeros((1, len(axes)))
    for k, structure in enumerate(structures):
        for one in structure.extras:
            extra[0, k] = one.coordinate(SHAPED[structure.name])
    start = start_point([rec], 0.12, 0.7, np.tile(start_levels("position"), (len(axes), 1)))
    point = replace(start, trim=start.trim + 0.1, structures=structures, extra=extra)
    laws = point.laws
    laws[:, TRIM] = point.trim[0]

    own = block_response.response(rec, point, 0, point.start)
    general = block_response._general_response(rec, point, laws, point.start)
    for found, expected in zip(own, general, strict=True):
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 * np.abs(expected).max())
    assert (np.abs(own[1][:, 3 * len(axes) : 4 * len(axes)]).max() > 0.01).all()


def test_a_start_velocity_that_has_decayed_to_nothing_has_moved_the_vehicle_by_its_share() -> None:
    rec = record(flown(Truth(), steps(("z",)), 40.0), ("z",))  # 30 /s for 40 s: beyond the smallest numbers
    assert rec is not None
    start = start_point([rec], 0.1, 30.0, start_levels("position")[None])
    point = replace(start, start=start.start + 1.0)
    columns = block_response.response(rec, point, 0, point.start)[1]

    end = columns[-1, -1, 0]
    assert end == pytest.approx(1 / 30.0, rel=1e-9)
    np.testing.assert_allclose(columns[rec.block_time > rec.starts[0] + 2.0, -1, 0], end, rtol=1e-12)


@pytest.mark.parametrize("axes", [("z",), ("x", "y")])
def test_commands_that_pass_the_lag_twice_move_the_vehicle_as_two_lags_do(axes: tuple[str, ...]) -> None:
    """By the state space of two lags a little apart, held from command to command; and its derivative by the lag."""
    commands = steps(axes) if len(axes) == 1 else steps()
    rec = record(flown(Truth(), commands, 12.0), axes)
    assert rec is not None
    law = replace(STRUCTURES["first_order_delay_lag"], twice=True)
    start = start_point([rec], 0.12, 0.7, np.tile(start_levels("position"), (len(axes), 1)))
    lag = np.full((1, len(axes)), np.log(0.1))
    point = replace(start, structures=(law,) * len(axes), extra=lag)

    def mean(by: float) -> np.ndarray:
        return block_response.response(rec, replace(point, extra=lag + by), 0, point.start)[0]

    found, columns = block_response.response(rec, point, 0, point.start)
    K = len(axes)
    slope = (mean(1e-4) - mean(-1e-4)) / 2e-4
    np.testing.assert_allclose(columns[:, 3 * K : 4 * K].sum(axis=1), slope, atol=1e-6 * np.abs(slope).max())
    if K == 1:
        np.testing.assert_allclose(found[:, 0], two_lags(rec, point, 0.12, 0.08), atol=1e-3 * np.abs(found).max())


def two_lags(rec: Record, point: Point, *lags: float) -> np.ndarray:
    """Displacement of one axis at the blocks, by small steps of Runge and Kutta."""
    gain, damping, delay = float(point.gain[0]), float(np.exp(point.log_damping[0])), float(point.delay[0])
    time = np.arange(rec.starts[0] - 3.0, rec.pose_time[-1], 0.001)
    held = np.searchsorted(rec.command_time, time - delay, side="right") - 1
    driven = gain * np.where(held >= 0, rec.command[np.maximum(held, 0), 0], rec.command[0, 0])
    state = np.array([0.0, 0.0, driven[0], driven[0]])
    begin = int(np.searchsorted(time, rec.starts[0]))
    path = np.zeros(time.size)

    def change(s: np.ndarray, u: float) -> np.ndarray:
        return np.array([s[1], s[3] - damping * s[1], (u - s[2]) / lags[0], (s[2] - s[3]) / lags[1]])

    for i in range(time.size - 1):
        if i == begin:
            state[:2] = 0.0, point.start[0, 0]
        middle = state + 0.0005 * change(state, driven[i])
        state = state + 0.001 * change(middle, driven[i])
        path[i + 1] = state[0] if i >= begin else 0.0
    poses = np.interp(rec.pose_time, time, path)
    return np.bincount(rec.block, poses) / np.bincount(rec.block)


def test_a_second_order_in_the_world_moves_as_a_lag_in_the_world_with_the_same_poles() -> None:
    """On a flight that turns; and its derivatives are those of its motion."""
    rec = record(flown(Truth(), steps(("x", "y", "yaw")), 15.0), ("x", "y"))
    assert rec is not None
    assert np.ptp(rec.yaw) > 0.8
    start = start_point([rec], 0.12, 1.5, np.tile(start_levels("position"), (2, 1)))
    lag = np.array([0.2, 0.15])
    lagged = replace(
        start,
        structures=(STRUCTURES["first_order_delay_world_lag"],) * 2,
        extra=np.log(lag)[None],
        gain=start.gain + 3.0,
    )
    slower = np.log1p(lag * np.exp(start.log_damping))
    second = replace(
        lagged,
        structures=(replace(STRUCTURES["second_order"], world=True),) * 2,
        gain=lagged.gain * np.exp(-slower),
        log_damping=lagged.log_damping - slower,
        extra=lagged.extra - slower,
    )

    one = block_response.response(rec, lagged, 0, lagged.start)[0]
    mean, columns = block_response.response(rec, second, 0, second.start)
    np.testing.assert_allclose(mean, one, atol=2.5e-3 * np.abs(one).max())
    flat = second.flat()
    for at in range(8):
        step = np.zeros(flat.size)
        step[at] = 1e-5
        moved = [
            block_response.response(rec, second.with_flat(flat + sign * step), 0, second.start)[0] for sign in (1, -1)
        ]
        slope = (moved[0] - moved[1]) / 2e-5
        np.testing.assert_allclose(columns[:, at], slope, atol=2e-3 * np.abs(slope).max())
