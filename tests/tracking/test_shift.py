"""The size of a shift that coefficients share: its interval holds it, whenever in `since` it began."""

from dataclasses import replace

import numpy as np
import pytest

from rotorfit.core.frames import AXES
from rotorfit.estimation.likelihood.likelihood import whiten
from rotorfit.tracking.changes import contrast
from rotorfit.tracking.refits import refitted
from rotorfit.tracking.scores import EXPECTED, Scores, scores_of
from rotorfit.tracking.shift import shift_interval
from tracked_flights import LAW, known_flight

pytestmark = pytest.mark.flights

FLIGHTS = 40
SHARED = ("z.delay", "yaw.delay")


@pytest.fixture(scope="module")
def both() -> list[Scores]:
    """Those of z and of yaw, 30 s."""
    found = [refitted(known_flight(), (axis,), LAW, 30.0) for axis in ("z", "yaw")]
    return scores_of([(list(one.estimates.items()), {}) for one in found])


@pytest.mark.parametrize("later", [0.05, 0.1])
def test_the_sensitivity_of_a_delay_that_begins_is_the_difference_of_the_motions(later: float) -> None:
    """Both integrated step by step: from the instant on every command acts later, and the motion before is the same."""
    flight = known_flight()
    followed = refitted(flight, ("z",), LAW, 30.0)
    (rec,), point = followed.estimates["z"].records, followed.estimates["z"].optimum.point
    scores, fine, begun = scores_of([(list(followed.estimates.items()), {})])[0], 1e-3, float(rec.block_time[-1]) - 3.0
    gain, damping = float(point.gain[0]), float(np.exp(point.log_damping[0]))
    t = np.arange(begun, rec.block_time[-1] + 2 * fine, fine)

    def acting(delay: float) -> np.ndarray:
        held = np.searchsorted(flight.command_time, t - delay, side="right") - 1
        return flight.command[np.maximum(held, 0), AXES.index("z")]

    push = gain * (acting(float(point.delay[0]) + later) - acting(float(point.delay[0])))
    velocity, position = np.zeros(t.size), np.zeros(t.size)
    for k in range(1, t.size):
        velocity[k] = velocity[k - 1] + fine * (push[k - 1] - damping * velocity[k - 1])
        position[k] = position[k - 1] + fine * velocity[k - 1]
    column = np.interp(rec.block_time, t, position, left=0.0)[:, None, None]
    expected = whiten(rec, column, point.levels)[0][:, 0, 0]

    found = later / EXPECTED["delay"] * scores.begun(begun, later)[:, scores.names.index("z.delay")]

    assert np.linalg.norm(expected) > 5.0
    assert np.linalg.norm(found - expected) < 0.2 * np.linalg.norm(expected)


def shifted(both: list[Scores], size: float, begun: float, seed: int) -> list[Scores]:
    """White innovations, and both delays shifted by as much from an instant on [s]."""
    rng, out = np.random.default_rng(seed), []
    for scores in both:
        way = np.isin(scores.names, SHARED).astype(float)
        answer = scores.begun(begun, 0.0) @ way
        out.append(replace(scores, innovation=rng.standard_normal(scores.time.size) + size * answer))
    return out


@pytest.mark.parametrize("size", [-1.0, 0.3, 1.0])
def test_the_interval_holds_a_shift_that_began_later_than_the_window(both: list[Scores], size: float) -> None:
    begun, found, diluted = float(both[0].time[-1]) - 2.0, [], []
    for seed in range(FLIGHTS):
        scores = shifted(both, size, begun, seed)
        window = begun - 1.0
        found.append(shift_interval(scores, SHARED, (window, begun + 0.5), window))
        alone = contrast(scores[0], window)
        diluted.append(alone.shift[scores[0].names.index("z.delay")] if alone else np.nan)

    held = [low <= size <= high for low, high in (each for each in found if each)]
    assert len(held) == FLIGHTS
    assert sum(held) >= 0.9 * FLIGHTS
    if abs(size) == 1.0:
        assert np.median([sum(each) / 2 for each in found if each]) == pytest.approx(size, abs=0.06)
        assert abs(np.median(diluted)) < 0.9


def test_where_no_window_shows_the_coefficients_there_is_no_interval(both: list[Scores]) -> None:
    now = float(both[0].time[-1])

    assert shift_interval(both, ("x.delay",), (now - 2.0, now), now - 2.0) is None


def test_an_instant_after_which_hardly_anything_shows_a_shift_does_not_open_the_interval(both: list[Scores]) -> None:
    """The flat prior of a size made the least telling of them the likeliest: -54 to 136."""
    now = float(both[0].time[-1])
    begun = now - 1.2

    for seed in range(3):
        found = shift_interval(shifted(both, 1.0, begun, seed), SHARED, (begun - 0.5, now), begun - 1.0)
        assert found
        assert 0.3 < found[0] < 1.0 < found[1] < 4.0
