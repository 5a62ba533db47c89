"""On the ground: from touching down to being seen to stand, no change is told; a vehicle that sags is told of."""

import numpy as np

from rotorfit.tracking.ground import Ground


def watched(down: float) -> list[tuple[float, bool, bool]]:
    """Time, `touches` and `stands` at each pose of a flight that sinks from 2 m to the ground at 5 s."""
    ground, told = Ground(), []
    for time in np.arange(0.0, 8.0, 0.02):
        ground.command(time, (0.0, 0.0, -down if time > 2.0 else 0.2, 0.0))
        height = max(2.0 - max(time - 2.0, 0.0) / 1.5, 0.0)
        ground.pose(time, np.array([0.3 * np.sin(3 * time) if height else 0.0, 0.0, height, 0.0]))
        told.append((float(time), ground.touches, ground.stands))
    return told


def test_who_sinks_as_commanded_to_the_lowest_height_may_have_touched_down_until_it_stands() -> None:
    told = watched(0.4)

    assert not any(touches for time, touches, _ in told if time < 2.0)
    assert all(touches for time, touches, _ in told if time > 5.0)
    assert next(time for time, _, stands in told if stands) > 5.5


def test_who_sinks_although_it_is_to_climb_has_not_touched_down() -> None:
    assert not any(touches for time, touches, _ in watched(-0.4) if time < 5.5)
