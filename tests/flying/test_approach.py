"""The approach to a plan's start: it ends there, at rest, and goes hardly beyond."""

from dataclasses import replace
from pathlib import Path

import pytest

from believed_vehicles import Case, approached, cases

pytestmark = pytest.mark.flights

WORST = (9, 86, 1, 3)
"""Of the first 90 vehicles of seed 0: those that go furthest beyond, and others."""


@pytest.fixture(scope="module")
def family() -> list[Case]:
    return list(cases(max(WORST) + 1, 0))


@pytest.mark.parametrize(
    "number", [*WORST[:2], *(pytest.param(number, marks=pytest.mark.slow) for number in WORST[2:])]
)
def test_a_start_that_is_far_is_reached_with_little_overshoot(number: int, family: list[Case], tmp_path: Path) -> None:
    reason, distance, beyond, took = approached(family[number], tmp_path / "log.mcap")

    assert reason == "completed"
    assert distance < 0.1
    assert beyond < 0.2
    assert took < 40


def test_a_slow_fence_makes_a_slow_approach(family: list[Case], tmp_path: Path) -> None:
    case = family[1]
    slow = replace(case, plan=replace(case.plan, space=replace(case.plan.space, speed=0.3)))

    reason, distance, *_ = approached(slow, tmp_path / "log.mcap")

    assert (reason, distance < 0.1) == ("completed", True)


@pytest.mark.slow
def test_500_vehicles_that_are_believed_possible_reach_the_start(tmp_path: Path) -> None:
    ended = [approached(case, tmp_path / f"{case.seed}.mcap") for case in cases(500, 1)]

    assert {reason for reason, *_ in ended} == {"completed"}
    assert max(distance for _, distance, *_ in ended) < 0.12
    assert max(beyond for _, _, beyond, _ in ended) < 0.2
