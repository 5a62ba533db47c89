"""The bank of filters learns the levels of the flight that it predicts, from the past alone."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from flights import flown, steps
from rotorfit.core.flight_data import Flight
from rotorfit.core.frames import AXES
from rotorfit.dynamics.filter_bank import OWN_SHARE, bank_levels, start_bank, weights
from rotorfit.dynamics.protocol import AxisDynamics, Predictions, horizon_errors, predict_flight
from rotorfit.simulation.paper_vehicle import GAMMA_B, Truth

CALM = replace(Truth(), wind_sigma=(0.02, 0.02, 0.02, 0.005))
GUSTY = replace(Truth(), wind_sigma=(0.4, 0.4, 0.3, 0.1))


def dynamics_of(truth: Truth) -> dict[str, AxisDynamics]:
    """The vehicle and its wind in the parameters of the filter: wind of rate 1 / T passes the damping b."""
    out = {}
    for k, axis in enumerate(AXES):
        b, rate = GAMMA_B[2 * k + 1], 1 / truth.wind_time[k]
        power, noise = 2 * truth.wind_sigma[k] ** 2 * rate, truth.mocap_noise[k] ** 2
        levels = (power, noise, b + rate, 4 * b * rate / (b + rate) ** 2)
        out[axis] = AxisDynamics(GAMMA_B[2 * k], b, truth.delay[k], levels, 1e-8)
    return out


@cache
def flight_in(truth: Truth, seed: int = 3) -> Flight:
    return flown(truth, steps(seed=seed), 40.0, seed)


def error(flight: Flight, truth: Truth, axis: str, horizon: float, *, adapt: bool) -> float:
    """RMSE of velocity predictions with the levels of a truth."""
    parts = predict_flight(flight, dynamics_of(truth), horizon, adapt=adapt)
    found = horizon_errors(parts, [part.predicted for part in parts], horizon)[axis].velocity_rmse
    assert found is not None
    return found


@pytest.mark.parametrize(("believed", "real"), [(CALM, GUSTY), (GUSTY, CALM)])
def test_levels_of_another_wind_are_unlearned(believed: Truth, real: Truth) -> None:
    flight = flight_in(real)
    for axis in ("x", "y", "z"):
        adapted, fixed = (error(flight, believed, axis, 0.5, adapt=adapt) for adapt in (True, False))
        known = error(flight, real, axis, 0.5, adapt=False)
        assert adapted < 0.9 * fixed
        assert adapted < 1.1 * known


@pytest.mark.parametrize("truth", [CALM, GUSTY])
def test_right_levels_are_kept(truth: Truth) -> None:
    for axis in AXES:
        adapted, fixed = (error(flight_in(truth), truth, axis, 1.0, adapt=adapt) for adapt in (True, False))
        assert adapted < 1.02 * fixed


def test_streaming_equals_batch() -> None:
    """What was predicted by 20 s is the same bit for bit where the flight ends soon after."""
    whole = flight_in(GUSTY)
    seen = whole.pose_time <= 25.0
    cut = replace(
        whole, pose_time=whole.pose_time[seen], position=whole.position[seen], yaw=whole.yaw[seen],
        segments=(replace(whole.segments[0], end=float(whole.pose_time[seen][-1])),),
    )  # fmt: skip
    (one,), (other,) = (predict_flight(flight, dynamics_of(CALM), 2.0) for flight in (whole, cut))
    past = one.start < 20.0
    assert past.sum() > 30
    n = int(past.sum())
    steps_ahead = min(one.predicted.shape[1], other.predicted.shape[1])
    np.testing.assert_array_equal(one.predicted[:n, :steps_ahead], other.predicted[:n, :steps_ahead])
    for a, b in zip(one.states, other.states, strict=True):
        assert a is not None
        assert b is not None
        np.testing.assert_array_equal(a.variance(1.0)[:n], b.variance(1.0)[:n])


def predicted(flight: Flight, adapt: bool) -> Predictions:
    (part,) = predict_flight(flight, dynamics_of(CALM), 1.0, adapt=adapt)
    return part


def test_a_bank_begins_with_the_levels_of_the_model() -> None:
    levels = np.array([[0.02, 4e-7, 3.0, 0.5]] * 2)
    members = bank_levels(levels, adapt=True)
    np.testing.assert_array_equal(members[0, 0], levels)

    share = weights(start_bank(members, np.ones(4)))
    assert share[0] == pytest.approx([OWN_SHARE, OWN_SHARE])
    assert share.sum(axis=0) == pytest.approx([1.0, 1.0])
    assert weights(start_bank(bank_levels(levels, adapt=False), np.ones(4))) == pytest.approx(np.ones((1, 2)))


def test_the_heading_of_the_world_does_not_matter() -> None:
    """A gusty flight turned by a right angle is predicted the same, adapted levels included."""
    flight = flight_in(GUSTY)
    turned = replace(
        flight, position=flight.position[:, [1, 0, 2]] * [-1.0, 1.0, 1.0], yaw=flight.yaw + np.pi / 2
    )  # fmt: skip
    one, other = predicted(flight, adapt=True), predicted(turned, adapt=True)
    np.testing.assert_allclose(other.predicted[..., 1], one.predicted[..., 0], atol=1e-7)
    np.testing.assert_allclose(other.predicted[..., 2], one.predicted[..., 2], atol=1e-7)
