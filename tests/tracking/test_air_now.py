"""Velocity, wind and the second ahead: found where they are known, with bands that hold."""

from dataclasses import replace

import numpy as np
import pytest

from flights import STILL, flown, steps
from rotorfit.tracking.air import motion_now
from rotorfit.tracking.following import refitted
from rotorfit.tracking.replayed import until
from tracked_flights import LAW, known

pytestmark = pytest.mark.flights


def test_a_constant_acceleration_is_told_as_wind() -> None:
    pushed = replace(STILL, trim=(0.3, -0.2, 0.1, 0.0))
    flight = flown(pushed, steps(("x", "y", "z"), seed=8), 14.0, seed=8)
    estimates = {**refitted(flight, ("x", "y"), LAW, 14.0).estimates, **refitted(flight, ("z",), LAW, 14.0).estimates}
    motion, _ = motion_now(flight, estimates)

    assert motion["x"].wind == pytest.approx(0.3, abs=0.02)
    assert motion["y"].wind == pytest.approx(-0.2, abs=0.02)
    assert motion["z"].wind == pytest.approx(0.1, abs=0.02)


def test_velocity_now_and_in_a_second_are_those_that_came() -> None:
    """On a flight that is known: at ten moments, against the path itself."""
    flight, _ = known()
    estimates = refitted(flight, ("z",), LAW, 30.0).estimates
    now_off, ahead_off = [], []
    for now in np.arange(8.0, 28.0, 2.0):
        part = until(flight, float(now))
        begin = {axis: replace(one, records=one.records) for axis, one in estimates.items()}
        motion = motion_now(part, begin)[0]["z"]
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
