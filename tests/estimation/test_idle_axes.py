"""Scores leave out what a flight only holds, not what it excites by small commands."""

from dataclasses import replace

import pytest

from flights import flown, steps
from rotorfit.estimation.excitation import without_idle_axes
from rotorfit.estimation.grouping import without_held_axes
from rotorfit.simulation.paper_vehicle import Controller, Truth

pytestmark = pytest.mark.flights


@pytest.mark.parametrize("controller", [None, Controller(1.0, 1.6)])
def test_small_commands_that_explain_the_motion_are_scored_beside_large_ones(controller: Controller | None) -> None:
    small = flown(Truth(), steps(("x", "z"), 0.1, seed=1), 15.0, 1, controller=controller)
    large = flown(Truth(), steps(("x", "z"), 1.0, seed=2), 10.0, 2)

    kept, same = without_idle_axes([small, large])
    assert {"x", "z"} <= set(kept.axes)
    assert not {"x", "z"} & set(kept.held)
    assert same is large
    assert {"x", "z"} <= set(without_held_axes([small, large])[0].held)  # a fit does without them


def test_what_a_controller_only_holds_is_not_scored_beside_a_flight_that_moves_it() -> None:
    noisy = replace(Truth(), wind_sigma=(0.015,) * 4)
    held = flown(noisy, steps(("z",), seed=0), 20.0, 0, controller=Controller(2.0, 2.0))
    large = flown(Truth(), steps(("x", "y"), 1.0, seed=2), 10.0, 2)

    (kept,) = without_idle_axes([held], beside=[large])
    assert kept.held == ("x", "y")
    assert not {"x", "y"} & set(kept.axes)
    assert next(note.text for note in kept.notes if note.code == "held_axis").endswith("and is not scored")
    assert without_idle_axes([kept, large])[0] is kept
    assert without_idle_axes([held]) == [held]
