"""How far the vehicle runs on when commands stop: the closed form against a flight in which they do."""

from dataclasses import replace

import numpy as np
import pytest

from flying import CARD, plan_of
from rotorfit.core.flight_plan import Plan, command_at
from rotorfit.planning.belief import belief_from_card, belief_from_mapping, belief_mapping
from rotorfit.planning.precision import path
from rotorfit.planning.run_on import run_on
from rotorfit.simulation.paper_vehicle import noise_free, simulate_flight


def believed(amplitude: float) -> Plan:
    plan = plan_of(20.0, feedback=False, amplitude=amplitude)
    return replace(plan, belief=belief_mapping(belief_from_card(CARD)))


@pytest.mark.parametrize("seconds", [0.5, 3.0])
def test_the_way_is_that_of_a_flight_in_which_the_last_command_is_held(seconds: float) -> None:
    plan = believed(0.3)
    far = run_on(plan, seconds)
    truth = noise_free(belief_from_mapping(plan.belief, "").truth)
    way = 0.0
    for stop in np.arange(2.0, 18.0, 1.0):

        def held(t: np.ndarray, stop: float = stop) -> np.ndarray:
            return command_at(plan, np.minimum(t, stop)) * (t < stop + seconds)[:, None]

        flight = simulate_flight(truth, held, stop + seconds, 0)
        place, at = path(plan, flight), flight.pose_stamp * 1e-9
        way = max(way, float(np.hypot(*(place[-1] - place[np.searchsorted(at, stop)])[:2])))

    assert way <= 1.05 * far.sideways
    assert far.sideways < 4 * way + 0.5  # braking comes on top, and it grows with the square of the speed
    assert far.upright == 0.0


def test_what_stays_inside_is_not_outside() -> None:
    plan = believed(0.3)
    tight = replace(plan, space=replace(plan.space, lower=(-0.6, -0.6, 0.3), upper=(0.6, 0.6, 3.0)))

    assert run_on(plan, 3.0).outside == 0
    assert 0.1 < run_on(tight, 3.0).outside < run_on(plan, 3.0).sideways
    assert 0 <= run_on(tight, 3.0).instant <= 20
