"""Poses where no vehicle can have been, among those where it was, however hard it flew."""

import numpy as np
import pytest

from rotorfit.flights.wild_poses import wild

TIME = np.arange(0.0, 20.0, 1 / 30) + 0.004 * np.random.default_rng(0).uniform(size=600)


def flown(hard: float = 15.0) -> np.ndarray:
    """Poses that turn back with an acceleration [m/s^2] on x and y, while the heading sweeps half turns, with noise."""
    sweep = np.pi * np.sin(0.7 * TIME)
    swing = hard * np.sin(3.0 * TIME) / 9.0
    pose = np.column_stack([swing, -swing, 1.0 + 0.2 * np.sin(TIME), sweep])
    return pose + np.random.default_rng(1).normal(0.0, [0.005, 0.005, 0.005, 0.01], pose.shape)


@pytest.mark.parametrize("rate", [1, 3, 6])
def test_hard_flight_is_not_wild_at_any_rate(rate: int) -> None:
    assert not np.any(wild(TIME[::rate], flown()[::rate]))


@pytest.mark.parametrize("count", [1, 2, 3])
@pytest.mark.parametrize("off", [[0.9, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, np.pi], [0.3, 0.3, 0.0, 1.6]])
def test_poses_that_jump_away_and_back_are_wild_alone(count: int, off: list[float]) -> None:
    pose = flown(5.0)
    pose[300 : 300 + count] += off

    assert np.flatnonzero(wild(TIME, pose)).tolist() == [*range(300, 300 + count)]


def test_a_heading_may_be_wrapped() -> None:
    pose = flown(5.0)
    pose[:, 3] += 3.0
    pose[300, 3] += np.pi
    pose[:, 3] = np.angle(np.exp(1j * pose[:, 3]))

    assert np.flatnonzero(wild(TIME, pose)).tolist() == [300]


@pytest.mark.parametrize("at", [0, 289, 290, 589])
def test_a_pose_beside_a_gap_or_at_an_end_is_compared_with_those_on_its_other_side(at: int) -> None:
    keep = np.r_[0:290, 300:600]
    time, pose = TIME[keep], flown(5.0)[keep]
    pose[at, 3] += np.pi

    assert np.flatnonzero(wild(time, pose)).tolist() == [at]


def test_a_jump_that_stays_is_no_wild_pose() -> None:
    pose = flown(5.0)
    pose[300:] += [0.0, 0.8, 0.0, 0.0]

    assert not np.any(wild(TIME, pose))


def test_where_many_poses_would_be_wild_none_is() -> None:
    """Millimetres read as metres turn back harder than any vehicle, and dropping them would hide the unit."""
    pose = flown() * [1000.0, 1000.0, 1000.0, 1.0]

    assert not np.any(wild(TIME, pose))
