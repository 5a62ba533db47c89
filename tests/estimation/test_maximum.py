"""The climb: where it ends, what it leaves alone, and that it ends at the same top from everywhere."""

from dataclasses import replace
from functools import cache, partial
from itertools import pairwise

import numpy as np
import pytest

from flights import flown, steps
from rotorfit.core.laws import DELAY_RANGE, START_LEVELS
from rotorfit.estimation.likelihood.axis_estimate import free_of
from rotorfit.estimation.likelihood.blocks import Record, record
from rotorfit.estimation.likelihood.fisher_scoring import at_bound, climb, limit_step, maximise
from rotorfit.estimation.likelihood.likelihood import restriction, score
from rotorfit.estimation.likelihood.optima import STARTS, start_point
from rotorfit.estimation.likelihood.parameters import Point
from rotorfit.planning.signals import two_sines
from rotorfit.simulation.paper_vehicle import Truth

Array = np.ndarray


@cache
def records_of(axes: tuple[str, ...], seed: int = 1) -> tuple[Record, ...]:
    rec = record(flown(Truth(), steps(seed=seed), 30.0, seed), axes)
    assert rec is not None
    return (rec,)


def start_of(records: tuple[Record, ...], delay: float = 0.15, damping: float = 1.0) -> Point:
    return start_point(records, delay, damping, np.tile(START_LEVELS, (len(records[0].axes), 1)))


def climbed(records: tuple[Record, ...], start: Point, free: Array, tolerance: float = 1e-6) -> tuple[Point, float]:
    """In two goes, so that the second has a reference near the top."""
    first = maximise(records, start, free, tolerance=0.01)
    second = maximise(records, first.point, free, tolerance=tolerance)
    return second.point, second.score.objective


@pytest.mark.parametrize("axes", [("z",), ("yaw",), ("x", "y")])
def test_every_start_that_finds_the_delay_ends_at_the_same_top(axes: tuple[str, ...]) -> None:
    """The objectives differ by hundredths, because each second go has a reference of its own; the point does not."""
    records = records_of(axes)
    free = free_of(records, [True] * len(axes))
    K = len(axes)
    ends = [climbed(records, start_of(records, delay, damping), free) for delay, damping in STARTS[:4]]

    top = max(objective for _, objective in ends)
    assert sum(top - objective < 0.1 for _, objective in ends) >= 3
    best = next(point for point, objective in ends if objective == top)
    for point, objective in ends:
        if top - objective < 0.1:
            np.testing.assert_allclose(point.flat()[: 3 * K], best.flat()[: 3 * K], rtol=0, atol=2e-4)


@pytest.mark.parametrize("axis", ["z", "yaw"])
@pytest.mark.parametrize("seed", range(1, 9))
def test_the_climb_does_not_end_where_the_levels_lie_flat(axis: str, seed: int) -> None:
    """As the overlap goes to 0 the likelihood becomes level in its logarithm: no gradient, and log units below."""
    amplitude = 3.0 if axis == "z" else 1.0
    rec = record(flown(Truth(), partial(two_sines, axes=(axis,), amplitude=amplitude), 60.0, seed), (axis,))
    assert rec is not None
    free = free_of([rec], [True])

    end = climb([rec], start_of((rec,)), free)
    levels = end.point.levels.copy()
    levels[0, 3] = START_LEVELS[3]
    again = maximise([rec], replace(end.point, levels=levels), free, restricted=end.restricted)
    assert again.score.objective - end.score.objective < 0.5


@pytest.mark.parametrize(
    "levels",
    [(270.0, 4.6e-6, 150.0, 0.15), (700.0, 4e-6, 130.0, 0.017), (1e-6, 1e-10, 1.0, 0.5)],
)
@pytest.mark.parametrize("pose_rate", [15.0, 120.0])
def test_from_levels_far_from_the_data_the_climb_ends_at_the_top_all_the_same(
    pose_rate: float, levels: tuple[float, float, float, float]
) -> None:
    """The information is nearly singular there: a step that is cut part by part need not lead upwards."""
    truth = replace(Truth(), pose_rate=pose_rate, pose_jitter=0.002)
    rec = record(flown(truth, steps(("z",)), 30.0, 3), ("z",))
    assert rec is not None
    free = free_of([rec], [True])
    top, objective = climbed((rec,), start_of((rec,)), free)

    far = maximise([rec], replace(top, levels=np.log([levels])), free)
    assert far.gain < 0.01
    again = maximise([rec], far.point, free)
    assert objective - again.score.objective < 0.5


def test_at_the_top_the_gradient_is_gone_and_no_step_helps() -> None:
    records = records_of(("x", "y"))
    free = free_of(records, [True, True])
    end = maximise(records, maximise(records, start_of(records), free, tolerance=0.01).point, free, tolerance=1e-8)

    inside = free & ~at_bound(end.point, end.score.gradient)
    assert np.abs(end.score.gradient[inside] / np.sqrt(np.diag(end.score.information)[inside])).max() < 1e-3
    rng = np.random.default_rng(0)
    for _ in range(20):
        step = 0.3 * rng.standard_normal(free.size) / np.sqrt(np.diag(end.score.information))
        assert score(records, end.point.moved(step), end.restricted).objective <= end.score.objective + 1e-6


def test_the_climb_never_goes_down_and_counts_its_passes() -> None:
    records = records_of(("z",))
    free = free_of(records, [True])
    start = start_of(records, 0.35, 2.0)
    restricted = restriction(records, start, free)

    heights = [score(records, start, restricted).objective]
    for most in range(2, 12):
        end = maximise(records, start, free, restricted=restricted, tolerance=1e-9, most=most)
        assert end.passes <= most + 7  # the last search of a line may take eight looks
        heights.append(end.score.objective)
    assert all(b >= a - 1e-9 for a, b in pairwise(heights))


def test_what_is_held_does_not_move() -> None:
    records = records_of(("z",))
    start = start_of(records)
    free = free_of(records, [True])
    free[[1, 2]] = False

    end = maximise(records, start, free)
    np.testing.assert_array_equal(end.point.flat()[~free], start.flat()[~free])
    assert (end.point.flat()[free] != start.flat()[free]).all()
    assert not end.inverse[~free].any()


def test_without_free_levels_the_plain_likelihood_is_climbed() -> None:
    records = records_of(("z",))
    free = free_of(records, [True])
    free[-4:] = False

    end = maximise(records, start_of(records), free)
    assert end.restricted is None
    assert end.score.objective == end.score.log_likelihood


def test_a_bound_holds_and_is_left_again_when_the_gradient_points_inwards() -> None:
    """Two clocks that differ: the best delay lies outside the searched range, then just inside it."""
    (rec,) = records_of(("z",))
    free = free_of([rec], [True])
    outside, inside = (replace(rec, command_time=rec.command_time - shift) for shift in (0.46, 0.44))

    end = maximise([outside], start_of((rec,), 0.5), free)
    assert end.point.delay[0] == DELAY_RANGE[1]
    assert end.gain < 1e-3
    assert maximise([inside], end.point, free).point.delay[0] == pytest.approx(0.59, abs=0.003)


def test_the_same_climb_twice_is_the_same() -> None:
    records = records_of(("x", "y"))
    free = free_of(records, [True, True])

    first, second = (maximise(records, start_of(records), free) for _ in range(2))
    np.testing.assert_array_equal(first.point.flat(), second.point.flat())
    assert first.passes == second.passes


def test_a_step_is_shortened_as_a_whole_to_what_each_kind_may_move() -> None:
    step = np.zeros(20)
    step[1], step[2], step[-1] = 3.0, 0.04, 1.0  # log b, delay, a level; K = 1

    np.testing.assert_allclose(limit_step(step, 1), step / 2)
    np.testing.assert_array_equal(limit_step(step / 4, 1), step / 4)
