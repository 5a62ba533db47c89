"""Poses where no vehicle can have been, among those where it was, however hard it flew."""

from pathlib import Path

import numpy as np
import pytest

from rotorfit.app.workflows import load_flight
from rotorfit.core.frames import AXES
from rotorfit.files.cards import load_card
from rotorfit.files.log_span import parse_log
from rotorfit.flights.wild_poses import unwrapped, wild

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


def test_a_heading_that_spins_is_no_wild_pose() -> None:
    pose = flown(5.0)
    pose[:, 3] = 6.0 * TIME

    assert not np.any(wild(TIME[::4], pose[::4]))


@pytest.mark.parametrize("apart", [1, 2])
def test_a_pose_near_one_beside_a_gap_takes_no_good_one_with_it(apart: int) -> None:
    keep = np.r_[0:290, 300:600]
    time, pose = TIME[keep], flown(5.0)[keep]
    pose[290 + apart] += [0.7, 0.0, 0.0, np.pi]

    assert np.flatnonzero(wild(time, pose)).tolist() == [290 + apart]


def test_a_heading_that_flips_and_comes_back_loses_no_turn() -> None:
    heading = np.linspace(0.0, 3.0, 600)
    flipped = heading.copy()
    flipped[100:112] += np.pi
    flipped[400:405] -= np.pi

    found = unwrapped(TIME, np.angle(np.exp(1j * flipped)))

    there = np.r_[0:100, 112:400, 405:600]
    np.testing.assert_allclose(found[there], heading[there], atol=1e-9)
    np.testing.assert_array_equal(
        unwrapped(TIME, np.angle(np.exp(3j * heading))), np.unwrap(np.angle(np.exp(3j * heading)))
    )


@pytest.mark.parametrize(("share", "left"), [(0.08, 0), (0.15, 90)])
def test_where_many_poses_would_be_wild_they_are_kept_and_told(share: float, left: int, tmp_path: Path) -> None:
    """Millimetres read as metres turn back harder than any vehicle, and to drop them would hide the unit."""
    pose = flown(5.0)
    odd = np.random.default_rng(2).permutation(600)[: round(share * 600)]
    pose[odd, 0] += np.where(np.arange(odd.size) % 2, 0.8, -0.8)
    columns = {"time": TIME, **dict(zip(AXES, pose.T, strict=True))}
    columns |= {f"cmd_{axis}": np.sin(TIME + k) for k, axis in enumerate(AXES)}
    rows = (",".join(map(repr, map(float, row))) for row in zip(*columns.values(), strict=True))
    (tmp_path / "flight.csv").write_text("\n".join([",".join(columns), *rows]))
    sources = {"command": {axis: f"cmd_{axis}" for axis in AXES}, "pose": {axis: axis for axis in AXES}}
    lines = ['frame = "ENU"']
    for name, of in sources.items():
        lines += [f"[{name}]", 'time = "time"', *(f'{axis} = "{of[axis]}"' for axis in AXES)]
    (tmp_path / "card.toml").write_text("\n".join(lines))

    flight = load_flight(parse_log(str(tmp_path / "flight.csv")), load_card(str(tmp_path / "card.toml")))

    notes = {note.code: note.count for note in flight.notes}
    assert notes.get("wild_poses_kept", 0) >= left
    assert ("wild_poses" in notes) == (left == 0)
