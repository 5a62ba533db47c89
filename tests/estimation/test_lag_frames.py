"""A lag of x and y that turns with the heading, and one that keeps its direction in the world."""

from functools import cache

import numpy as np
import pytest

from other_laws import DELAY, LAG, WORLD_LAG, B, G, flown_by
from rotorfit.assessment.evidence import motion_of_flight
from rotorfit.core.model import Axis
from rotorfit.core.results import Fit
from rotorfit.estimation.fitting import fit

HEADING_LAG = "first_order_delay_lag"
PLANE = ("x", "y")


@cache
def fitted(flown: str, structure: str = "averaged", turn: float = 1.5) -> Fit:
    flight = flown_by(flown, PLANE, duration=30.0, wind=0.05, noise=0.001, turn=turn)
    return fit([flight], axes=PLANE, structure=structure)


def holds(axis: Axis) -> list[bool]:
    ends = [*(axis.ci95[name] for name in ("input", "damping", "delay", "lag")), axis.combinations["total_lag"].ci95]
    truth = (G, B, DELAY, LAG, DELAY + LAG + 1 / B)
    return [
        low is not None and high is not None and low <= value <= high
        for value, (low, high) in zip(truth, ends, strict=True)
    ]


@pytest.mark.parametrize("flown", [HEADING_LAG, WORLD_LAG])
def test_the_data_of_a_vehicle_that_turns_choose_the_frame_of_its_lag(flown: str) -> None:
    for name in PLANE:
        axis = fitted(flown).model.axes[name]
        assert axis.structure == flown
        assert {one.structure: round(one.weight, 2) for one in axis.laws} == {flown: 1.0}
        assert sum(holds(axis)) >= 4


def test_the_right_frame_is_much_likelier() -> None:
    fits = [fitted(WORLD_LAG, structure) for structure in (WORLD_LAG, HEADING_LAG)]
    right, wrong = (one.estimates["x"].optimum.score.log_likelihood for one in fits)

    assert right > wrong + 20


def test_without_turning_both_are_one_law() -> None:
    straight = fitted(WORLD_LAG, turn=0.0)

    assert {one.structure for name in PLANE for one in straight.model.axes[name].laws} == {HEADING_LAG}
    for name in PLANE:
        asked = fitted(WORLD_LAG, WORLD_LAG, 0.0).model.axes[name]
        assert asked.input == pytest.approx(fitted(WORLD_LAG, HEADING_LAG, 0.0).model.axes[name].input, rel=1e-6)


def test_the_modelled_acceleration_turns_as_the_lag_does() -> None:
    result = fitted(WORLD_LAG)
    motion = motion_of_flight(result.model, result.flights[0])

    apart = [motion.acceleration["model"][:, k] - motion.acceleration["measured"][:, k] for k in (0, 1)]
    assert max(float(np.nanstd(one)) for one in apart) < 0.1  # of 1.2 m/s^2, wind of 0.05
