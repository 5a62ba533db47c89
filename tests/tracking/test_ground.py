"""On the ground: from touching down to being seen to stand, no change is told; a vehicle that sags is told of."""

import numpy as np

from rotorfit.tracking.ground import Ground


def watched(down: float, start: float = 2.0, jump: float = 0.0) -> list[tuple[float, bool, bool]]:
    """Time, `touches` and `stands` at each pose of a flight that sinks from 2 m to the ground at 5 s.

    Args:
        down: Command to sink.
        start: Height at which it stood before [m].
        jump: By which the pose jumps upwards at 1 s [m].
    """
    ground, told, jumped = Ground(), [], False
    ground.level = start
    for time in np.arange(0.0, 8.0, 0.02):
        ground.command(time, (0.0, 0.0, -down if time > 2.0 else 0.2, 0.0))
        height = max(2.0 - max(time - 2.0, 0.0) / 1.5, 0.0)
        up = jump if time >= 1.0 else 0.0
        if up and not jumped:
            ground.jumped(height + up)
            jumped = True
        ground.pose(time, np.array([0.3 * np.sin(3 * time) if height else 0.0, 0.0, height + up, 0.0]))
        told.append((float(time), ground.touches, ground.stands))
    return told


def test_who_sinks_as_commanded_to_the_lowest_height_may_have_touched_down_until_it_stands() -> None:
    told = watched(0.4)

    assert not any(touches for time, touches, _ in told if time < 2.0)
    assert all(touches for time, touches, _ in told if time > 5.0)
    assert next(time for time, _, stands in told if stands) > 5.5


def test_the_ground_is_found_where_it_is_higher_than_where_the_vehicle_stood() -> None:
    told = watched(0.4, start=-0.3)

    assert not any(touches for time, touches, _ in told if time < 5.0)
    assert all(touches for time, touches, _ in told if time > 5.3)
    assert next(time for time, _, stands in told if stands) < 6.5


def test_the_ground_jumps_with_the_pose() -> None:
    told = watched(0.4, start=0.0, jump=2.0)

    assert not any(touches for time, touches, _ in told if time < 4.8)
    assert all(touches for time, touches, _ in told if time > 5.2)


def test_who_sinks_from_the_moment_of_the_last_command_on_may_land_by_itself() -> None:
    ground, told = Ground(), []
    ground.level = 0.0
    for time in np.arange(0.0, 6.0, 0.02):
        if time < 3.0:
            ground.command(time, (0.3, 0.0, 0.0, 0.0))
        ground.pose(time, np.array([0.3 * np.sin(3 * time), 0.0, 2.0 - 0.4 * max(time - 3.0, 0.0), 0.0]))
        told.append((time, ground.touches))

    assert not any(touches for time, touches in told if time < 3.2)
    assert all(touches for time, touches in told if time > 3.6)


def test_who_sinks_although_it_is_to_climb_has_not_touched_down() -> None:
    assert not any(touches for time, touches, _ in watched(-0.4) if time < 5.5)


def test_poses_as_noisy_as_those_of_a_satellite_receiver_rest_on_the_ground_and_not_in_flight() -> None:
    rng, ground, told = np.random.default_rng(3), Ground(), []
    for time in np.arange(0.0, 30.0, 1 / 30):
        landed = max(2.0 - max(time - 20.0, 0.0) / 1.5, 0.0)
        ground.command(time, (0.3 * np.sin(time), 0.0, -0.3 if 20.0 < time < 27.0 else 0.1, 0.0))
        place = np.array(
            [0.8 * np.sin(time) if landed else 0.0, 0.0, landed + (0.3 * np.sin(0.8 * time)) * (landed > 0), 0]
        )
        ground.pose(time, place + rng.normal(0, [0.01, 0.01, 0.015, 0.01]))
        told.append((time, ground.stands))

    assert not any(stands for time, stands in told if 3.0 < time < 22.0)
    assert np.mean([stands for time, stands in told if time > 25.5]) > 0.97


def landed_of(stops: float, lag: float) -> list[tuple[float, float]]:
    """The landings seen in a flight that sinks at 0.5 m/s until its command ends at 4 s, and climbs from 8 s on.

    Args:
        stops: Height at which nothing lets it sink further [m].
        lag: Time constant with which it follows its commands [s].
    """
    ground, height, speed, rng = Ground(), 2.0, 0.0, np.random.default_rng(1)
    for time in np.arange(0.0, 10.0, 0.01):
        asked = -0.5 if 1.0 < time < 4.0 else 0.5 if time > 8.0 else 0.0
        speed += 0.01 * (asked - speed) / lag
        height = max(height + 0.01 * speed, stops)
        speed = speed if height > stops else max(speed, 0.0)
        ground.command(time, (0.0, 0.0, asked, 0.0))
        ground.pose(time, np.array([0.0, 0.0, height, 0.0]) + rng.normal(0, 0.001, 4))
    return ground.landed(10.0)


def test_who_stops_at_once_has_landed_and_who_slows_down_hovers() -> None:
    ((down, up),) = landed_of(stops=0.65, lag=0.2)

    assert 3.7 < down < 4.0  # the command ends in the moment of the touchdown
    assert 8.0 < up < 8.5
    assert landed_of(stops=-np.inf, lag=0.2) == []
