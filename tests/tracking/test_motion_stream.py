"""The motion sample by sample: that of the batch, with bands; and none where nothing can be told."""

from dataclasses import replace

import numpy as np
import pytest
from tracking_samples import samples_of

from flights import CARD
from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES
from rotorfit.tracking.air import courses
from rotorfit.tracking.flight_so_far import Rows
from rotorfit.tracking.motion_stream import MotionStream
from rotorfit.tracking.refits import GroupEstimate, refitted
from rotorfit.tracking.replayed import until
from rotorfit.tracking.tracker import Tracker
from rotorfit.tracking.wind_error import Doubt
from tracked_flights import LAW, known_flight

pytestmark = pytest.mark.flights

NO_DOUBT = dict.fromkeys(AXES, Doubt(0.0, 0.0))


@pytest.fixture(scope="module")
def followed() -> dict[str, GroupEstimate]:
    early = until(known_flight(), 18.0)
    return {axis: refitted(early, group, LAW, 18.0) for group in (("x", "y"), ("z",), ("yaw",)) for axis in group}


def streamed(flight: Flight, followed: dict[str, GroupEstimate], begin: float, forget: float) -> MotionStream:
    """The filters of a look at an instant, and the rest of the flight sample by sample, the oldest forgotten."""
    estimates = {axis: one.estimates[axis] for axis, one in followed.items()}
    commands, poses = Rows(4), Rows(3)
    stream = MotionStream(commands, poses)
    sent = list(zip(flight.command_time, flight.command, strict=True))
    started = False
    for time, position, yaw in zip(flight.pose_time, flight.position, flight.yaw, strict=True):
        while sent and sent[0][0] <= time:
            commands.append(float(sent[0][0]), sent.pop(0)[1], np.inf)
        poses.append(float(time), position, float(yaw))
        if started:
            commands.forget(time - forget)
            poses.forget(time - forget)
            stream.follow()
        elif time >= begin:
            stream.begin(courses(until(flight, float(time)), estimates, {})[2], NO_DOUBT)
            started = True
    return stream


@pytest.mark.parametrize("forget", [np.inf, 3.0])
def test_streaming_is_the_batch_over_the_whole_flight(followed: dict[str, GroupEstimate], forget: float) -> None:
    flight = known_flight()
    batch = courses(flight, {axis: one.estimates[axis] for axis, one in followed.items()}, {})[0]
    stream = streamed(flight, followed, 8.0, forget).motion()

    assert stream is not None
    assert stream.time == flight.pose_time[-1]
    assert stream.axes.keys() == batch.keys() == set(AXES)
    for axis, told in stream.axes.items():
        one = batch[axis]
        assert (told.velocity, told.wind, told.gusts, told.ahead) == pytest.approx(
            (one.velocity, one.wind, one.gusts, one.ahead), rel=1e-9, abs=1e-9
        )
        for ends, error in ((told.wind_ci95, one.wind_error), (told.ahead_ci95, one.ahead_error)):
            assert ends[1] - ends[0] == pytest.approx(2 * 1.959964 * error, rel=1e-6)


def test_a_tracker_tells_the_motion_at_every_pose_and_none_after_a_jump_until_it_has_looked() -> None:
    tracker, times, velocity = Tracker(CARD, LAW, origin=0), [], []
    samples = samples_of(known_flight())
    for sample in samples:
        tracker.update(sample)
        if sample.stream == "pose" and (motion := tracker.motion()) and "z" in motion.axes:
            times.append(motion.time)
            velocity.append(motion.axes["z"].velocity)
    flight = known_flight()
    measured = np.gradient(np.interp(np.array(times), flight.pose_time, flight.position[:, 2]), times)
    poses = [one for one in samples if one.stream == "pose" and one.stamp >= times[0] * 1e9 - 1]

    assert len(times) > 0.97 * len(poses) > 100  # a pose that repeats the one before does not count
    assert np.sqrt(np.mean((np.convolve(measured, np.ones(15) / 15, "same") - velocity)[20:-20] ** 2)) < 0.05

    last = samples[-1].stamp
    for k in range(1, 6):
        x, *rest = poses[-1].values
        tracker.update(replace(poses[-1], stamp=last + 8_000_000 * k, received=0, values=(x + 3.0 + 0.001 * k, *rest)))
    assert tracker.motion() is None
