"""Velocity, wind and the second ahead: found where they are known, with bands that hold."""

from dataclasses import replace

import numpy as np
import pytest

from flights import STILL, flown, recorded, steps
from rotorfit.core.frames import world_from_heading
from rotorfit.core.model import NORMAL
from rotorfit.simulation.paper_vehicle import simulate_flight
from rotorfit.tracking.air import courses
from rotorfit.tracking.refits import refitted
from rotorfit.tracking.replayed import tracked, until
from tracked_flights import LAW, TRUTH, known_flight, tilted

pytestmark = pytest.mark.flights


def test_a_constant_acceleration_is_told_as_wind() -> None:
    pushed = replace(STILL, trim=(0.3, -0.2, 0.1, 0.0))
    flight = flown(pushed, steps(("x", "y", "z"), seed=8), 14.0, seed=8)
    estimates = {**refitted(flight, ("x", "y"), LAW, 14.0).estimates, **refitted(flight, ("z",), LAW, 14.0).estimates}
    motion = courses(flight, estimates, {})[0]

    assert motion["x"].wind == pytest.approx(0.3, abs=0.02)
    assert motion["y"].wind == pytest.approx(-0.2, abs=0.02)
    assert motion["z"].wind == pytest.approx(0.1, abs=0.02)


def test_x_alone_has_a_motion_along_the_worlds_x_only() -> None:
    """It is fitted along the heading; at another one its push lies in both axes of the world."""
    flight = flown(STILL, steps(("x",), seed=8), 14.0, seed=8)
    turn = np.full(flight.pose_time.size, 1.2)
    turned = replace(
        flight,
        yaw=flight.yaw + 1.2,
        position=np.column_stack([world_from_heading(flight.position[:, :2], turn), flight.position[:, 2]]),
    )

    along = courses(flight, refitted(flight, ("x",), LAW, 14.0).estimates, {})[0]
    assert along["x"].wind == pytest.approx(0.0, abs=0.02)
    assert not courses(turned, refitted(turned, ("x",), LAW, 14.0).estimates, {})[0]


def test_the_mean_wind_reaches_as_far_as_the_damping_allows() -> None:
    """It goes by 1 / damping: twice the damping is half the wind, and half of it twice."""
    pushed = replace(STILL, trim=(0.3, 0.0, 0.0, 0.0))
    flight = flown(pushed, steps(("x", "y"), seed=8), 24.0, seed=8)
    axes = ("x", "y")
    estimates = refitted(tilted(flight), axes, LAW, 24.0).estimates
    b = [float(np.exp(one.optimum.point.log_damping[one.place])) for one in estimates.values()]
    air = courses(tilted(flight), estimates, {axis: (0.5 * one, 2.0 * one) for axis, one in zip(axes, b, strict=True)})[
        1
    ]

    assert air is not None
    assert air.speed == pytest.approx(0.3 / b[0], rel=0.05)
    assert air.speed_ci95 == pytest.approx((0.5 * air.speed, 2.0 * air.speed), rel=0.05)
    assert air.direction == pytest.approx(0.0, abs=0.05)
    assert courses(tilted(flight), estimates, {"x": (None, 2.0), "y": (0.1, 2.0)})[1] is None


def test_a_hole_in_the_poses_leaves_the_mean_wind_known() -> None:
    flight = tilted(flown(replace(STILL, trim=(0.3, 0.0, 0.0, 0.0)), steps(("x", "y"), seed=8), 24.0, seed=8))
    estimates = refitted(flight, ("x", "y"), LAW, 24.0).estimates
    seen = (flight.pose_time < 14.0) | (flight.pose_time > 20.5)
    holed = replace(flight, pose_time=flight.pose_time[seen], position=flight.position[seen], yaw=flight.yaw[seen])
    air = courses(holed, refitted(holed, ("x", "y"), LAW, 24.0).estimates, dict.fromkeys(estimates, (0.2, 0.6)))[1]

    assert air is not None
    assert np.isfinite([*air.speed_ci95, *air.direction_ci95]).all()


def test_still_air_is_not_taken_for_wind() -> None:
    """Without gusts the seconds agree among themselves: what is left is the error of the trim."""
    axes, told = ("x", "y"), []
    for seed in range(5):
        flight = tilted(flown(STILL, steps(("x", "y"), seed=seed), 12.0, seed=seed))
        estimates = refitted(flight, axes, LAW, 12.0).estimates
        told.append(courses(flight, estimates, dict.fromkeys(axes, (0.5, 0.5)))[1])

    assert None not in told
    assert [air.significant for air in told if air].count(True) <= 1


def test_velocity_now_and_in_a_second_are_those_that_came() -> None:
    """On a flight that is known: at ten moments, against the path itself."""
    flight = known_flight()
    estimates = refitted(flight, ("z",), LAW, 30.0).estimates
    now_off, ahead_off = [], []
    for now in np.arange(8.0, 28.0, 2.0):
        part = until(flight, float(now))
        begin = {axis: replace(one, records=one.records) for axis, one in estimates.items()}
        motion = courses(part, begin, {})[0]["z"]
        z, t, step = flight.position[:, 2], flight.pose_time, 0.15
        measured = (np.interp(now + step, t, z) - np.interp(now - step, t, z)) / (2 * step)
        later = (np.interp(now + 1 + step, t, z) - np.interp(now + 1 - step, t, z)) / (2 * step)
        held = flight.command[np.searchsorted(t_commands := flight.command_time, now) - 1 :]
        alike = np.all(held[: np.searchsorted(t_commands, now + 1) - np.searchsorted(t_commands, now), 2] == held[0, 2])
        now_off.append(motion.velocity - measured)
        if alike:  # the prediction is for a command that is held
            ahead_off.append((motion.ahead - later) / motion.ahead_error)

    assert np.sqrt(np.mean(np.square(now_off))) < 0.03
    assert np.abs(ahead_off).max() < 6.0  # what is measured here has an error of its own


def test_the_band_a_second_ahead_holds_while_the_vehicle_is_hardly_known() -> None:
    off = []
    for seed in range(3):
        simulated = simulate_flight(
            replace(TRUTH, wind_sigma=(0.02,) * 4), steps(("z",), seed=seed, every=2.5), 18.0, seed
        )
        begin = simulated.command_stamp[0]
        time, sent = ((stamp - begin) * 1e-9 for stamp in (simulated.pose_stamp, simulated.command_stamp))
        for state in tracked(replace(recorded(simulated), axes=("z",)), LAW).states:
            z, now = state.axes["z"], state.time
            inside = simulated.command[np.searchsorted(sent, now, side="right") - 1 : np.searchsorted(sent, now + 1), 2]
            low, high = z.ahead_ci95
            if z.ahead is None or low is None or high is None or now + 1 > time[-1] or np.ptp(inside) > 0:
                continue  # the prediction is for a command that is held
            came = np.interp(now + 1, time, simulated.velocity[:, 2])
            off.append((came - z.ahead) / ((high - low) / (2 * NORMAL)))

    assert len(off) > 15
    assert np.sqrt(np.mean(np.square(off))) < 1.3  # 8 without the errors of the coefficients
