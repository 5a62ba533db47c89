"""Margins of vehicles drawn from a covariance: the same as one by one, and what is not known at all."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from models import VEHICLE, model_of
from rotorfit.control.control_law import law_of_bandwidth
from rotorfit.control.margins import margins, spectral_radius
from rotorfit.control.robustness import (
    believed_possible,
    doubt,
    highest_peak,
    known_dynamics,
    known_vehicle,
    robustness,
)
from rotorfit.core.errors import ModelError
from rotorfit.core.frames import Array
from rotorfit.core.model import Interval, Model, Plain, Predictor, first_order
from rotorfit.planning.belief import DELAY


def without_delays(model: Model) -> Model:
    there = [i for i, name in enumerate(model.covariance_names) if not name.endswith("delay")]
    names = tuple(model.covariance_names[i] for i in there)
    axes = {axis: replace(known, delay=None) for axis, known in model.axes.items()}
    return replace(model, axes=axes, covariance_names=names, covariance=model.covariance[np.ix_(there, there)])


def test_quantiles_are_those_of_the_margins_one_by_one() -> None:
    model = model_of(error=0.1)
    vehicles = believed_possible(model, "x", 40, 3)
    law = law_of_bandwidth("predictor", known_dynamics(model, "x"), 2.2, 0.02, 0.015, 0.03)

    found = robustness(law, doubt(vehicles, 0.02, 0.015, 3))
    each = [margins(law, one) for one in vehicles]

    assert found.peak == pytest.approx(sorted(one.peak for one in each)[37], rel=0.01)
    assert found.phase == pytest.approx(sorted(one.phase for one in each)[1], rel=0.01)
    assert found.delay == pytest.approx(sorted(one.delay for one in each)[1], rel=0.05)
    assert (found.draws, found.seed, found.unstable) == (40, 3, 0.0)
    assert highest_peak(law, doubt(vehicles, 0.02, 0.015, 3)) == pytest.approx(found.peak)


def test_unstable_draws_are_counted_by_their_eigenvalues() -> None:
    model = model_of(error=0.3)
    vehicles = believed_possible(model, "x", 50, 1)
    law = law_of_bandwidth("linearising", known_dynamics(model, "x"), 4.5, 0.02, 0.015, 0.03)

    found = robustness(law, doubt(vehicles, 0.02, 0.015, 1))

    assert 0.1 < found.unstable < 0.9
    assert found.unstable == np.mean([spectral_radius(law, one) >= 1 for one in vehicles])
    assert found.peak == np.inf
    assert found.delay == 0.0
    assert found.gain == (1.0, 1.0)


def test_the_gain_margin_that_95_percent_keep_is_theirs_one_by_one() -> None:
    vehicles = believed_possible(model_of(error=0.05), "x", 40, 3)
    law = law_of_bandwidth("predictor", known_dynamics(model_of(), "x"), 1.0, 0.02, 0.015, 0.03)

    each = np.array([margins(law, one).gain for one in vehicles])
    found = robustness(law, doubt(vehicles, 0.02, 0.015, 3)).gain
    wanted = [np.quantile(each[:, i], share, method="inverted_cdf") for i, share in ((0, 0.95), (1, 0.05))]
    np.testing.assert_allclose(found, wanted, rtol=2e-3)


def test_draws_have_the_covariance_of_the_model() -> None:
    model = model_of(error=0.02)
    drawn = np.array(believed_possible(model, "z", 4000, 0))
    there = [model.covariance_names.index(f"z.{name}") for name in ("input", "damping", "delay")]

    np.testing.assert_allclose(np.cov(drawn.T), model.covariance[np.ix_(there, there)], rtol=0.15)


def test_a_model_without_a_covariance_is_not_taken_as_exactly_known() -> None:
    """As those that were fitted to one axis of a vehicle that turns."""
    model = replace(model_of(), covariance_names=(), covariance=np.empty((0, 0)))

    with pytest.raises(ModelError, match="no covariance of x, so no margin can be stated"):
        believed_possible(model, "x", 40, 3)


def test_a_delay_that_nobody_knows_is_that_of_commercial_quadrotors() -> None:
    drawn = np.array(believed_possible(without_delays(model_of()), "x", 2000, 0))

    assert np.median(drawn[:, 2]) == pytest.approx(DELAY[0], abs=0.01)
    assert drawn[:, 2].min() >= 0.0


def test_another_structure_is_tuned_by_its_default_point_and_an_unknown_axis_not_at_all() -> None:
    model = model_of({"x": VEHICLE["x"]})
    plain = Plain(3.0, 0.25, 0.2, {"input": 0.1, "damping": 0.02, "delay": 0.01}, {}, {})
    other = replace(model.axes["x"], structure="climb_descent", plain=plain)
    model = replace(model, axes={**model.axes, "x": other})

    assert known_dynamics(model, "x") == (3.0, 0.25, 0.2)
    assert np.std(np.array(believed_possible(model, "x", 1000, 0)), axis=0) == pytest.approx([0.1, 0.02, 0.01], rel=0.1)
    with pytest.raises(ModelError, match="no numbers for y"):
        known_dynamics(model, "y")


@pytest.mark.parametrize("structure", ["first_order", "first_order_lag", "saturation"])
def test_a_law_without_a_delay_or_margins_of_its_own_promises_those_of_the_first_order_law_with_one(
    structure: str,
) -> None:
    model = model_of()
    x = model.axes["x"]
    plain = Plain(x.input, x.damping, x.delay, x.stderr, x.ci95, x.status, first_order(model, "x"))
    assert x.predictor is not None
    point = replace(x.predictor, delay=0.0, extra={"lag": 0.1, "level": 0.5})
    other = replace(model, axes={**model.axes, "x": replace(x, structure=structure, predictor=point, plain=plain)})

    assert known_vehicle(other, "x") == known_dynamics(model, "x")
    assert believed_possible(other, "x", 20, 3) == believed_possible(model, "x", 20, 3)


def dragged(share: float = 0.8) -> Model:
    """A model of x with much quadratic drag, beside it a first-order law with the damping of the flown speeds."""
    point, errors = Predictor(3.0, 1.5, 0.1, {"drag_share": share, "reference_speed": 0.5}), (0.03, 0.04, 0.002, 0.05)
    covariance = np.diag(errors) ** 2
    covariance[1, 3] = covariance[3, 1] = 0.5 * errors[1] * errors[3]
    model = known_as(Predictor(2.9, 1.7, 0.1), covariance[:3, :3], {})
    x = model.axes["x"]
    plain = Plain(x.input, x.damping, x.delay, x.stderr, x.ci95, x.status, first_order(model, "x"))
    own = replace(x, structure="quadratic_drag", predictor=point, plain=plain, ci95={"damping": (1.42, 1.58)})
    names = (*model.covariance_names, "x.drag_share")
    return replace(model, axes={**model.axes, "x": own}, covariance_names=names, covariance=covariance)


def test_quadratic_drag_is_drawn_as_the_damping_at_hover_which_is_the_least() -> None:
    drawn = np.array(believed_possible(dragged(), "x", 4000, 0))

    slope = np.array([1 - 0.8, -1.5])
    error = np.sqrt(slope @ dragged().covariance[np.ix_([1, 3], [1, 3])] @ slope)
    assert known_vehicle(dragged(), "x") == known_dynamics(dragged(), "x") == pytest.approx((3.0, 0.3, 0.1))
    assert drawn.mean(axis=0) == pytest.approx([3.0, 0.3, 0.1], rel=0.02)
    assert np.std(drawn[:, 1]) == pytest.approx(error, rel=0.05)
    assert np.array(believed_possible(dragged(1.0), "x", 400, 0))[:, 1].min() == 0.0  # drag gives no speed


def limited() -> Model:
    """A model of x that asks for at most 0.9 m/s^2, beside it a first-order law as slow as large commands make it."""
    point = Predictor(5.0, 2.5, 0.2, {"lag": 0.08, "acceleration_limit": 0.9})
    covariance = np.diag((0.1, 0.05, 0.005, 0.004, 0.02)) ** 2
    model = known_as(Predictor(2.0, 1.0, 0.3), covariance[:3, :3], {})
    x = model.axes["x"]
    plain = Plain(x.input, x.damping, x.delay, x.stderr, x.ci95, x.status, first_order(model, "x"))
    extra = {"lag": 0.08, "acceleration_limit": 0.9}
    own = replace(x, structure="limited_acceleration", predictor=point, plain=plain, ci95={}, extra=extra)
    names = (*model.covariance_names, "x.lag", "x.acceleration_limit")
    return replace(model, axes={**model.axes, "x": own}, covariance_names=names, covariance=covariance)


def test_a_limited_acceleration_is_drawn_as_the_motion_below_the_limit_which_is_faster_than_that_flown() -> None:
    slow, fast = np.sort(-np.roots([0.08, 1.0, 2.5]))  # T s^2 + s + b
    assert known_dynamics(limited(), "x") == pytest.approx((5.0 * slow / 2.5, slow, 0.2 + 1 / fast))
    assert known_vehicle(limited(), "x") == pytest.approx((5.0, 2.5, 0.2, 0.08, 0.0, 2))
    drawn = np.array(believed_possible(limited(), "x", 2000, 0))
    assert drawn.mean(axis=0)[:4] == pytest.approx([5.0, 2.5, 0.2, 0.08], rel=0.02)
    assert drawn.std(axis=0)[0] == pytest.approx(0.1, rel=0.1)


def test_a_side_on_which_the_interval_reaches_further_than_the_standard_error_is_drawn_to_its_end() -> None:
    model = model_of()
    x = model.axes["x"]
    g, error = VEHICLE["x"][0], x.stderr["input"]
    skewed = replace(x, ci95={**x.ci95, "input": (g - 1.96 * error, g + 10 * error)})

    drawn = np.array(believed_possible(replace(model, axes={"x": skewed}), "x", 4000, 0))[:, 0]

    low, high = np.quantile(drawn, [0.025, 0.975])
    assert (g - low) / error == pytest.approx(1.96, rel=0.1)
    assert (high - g) / error == pytest.approx(10.0, rel=0.1)


def known_as(point: Predictor, covariance: Array, ci95: Mapping[str, Interval]) -> Model:
    """A model of x under the first-order law, as a flight may know it."""
    model = model_of()
    names, (input_, damping, delay) = ("x.input", "x.damping", "x.delay"), np.sqrt(np.diag(covariance))
    x = replace(
        model.axes["x"],
        input=point.input,
        damping=point.damping,
        delay=point.delay,
        predictor=point,
        ci95=dict(ci95),
        stderr={"input": input_, "damping": damping, "delay": delay},
    )
    return replace(model, axes={**model.axes, "x": x}, covariance_names=names, covariance=covariance)


def test_vehicles_far_out_keep_the_steady_gain_and_the_total_lag_that_the_data_tell() -> None:
    """From slow sines input and damping are known only together; the interval of damping reaches four times as far."""
    g, b, tau = 2.0, 1.8, 0.4
    along, gain, lag = (
        np.array([g / b, 1.0, 1 / b**2]),
        np.array([1 / b, -g / b**2, 0.0]),
        np.array([0.0, -1 / b**2, 1.0]),
    )
    across = np.linalg.pinv(np.array([gain, lag]))
    covariance = 0.2**2 * np.outer(along, along) + across @ np.diag([0.02, 0.01]) ** 2 @ across.T
    error = np.sqrt(covariance[1, 1])
    model = known_as(Predictor(g, b, tau), covariance, {"damping": (b - 1.96 * error, b + 8 * error)})

    drawn = np.array(believed_possible(model, "x", 4000, 0))

    assert np.quantile(drawn[:, 1], 0.975) == pytest.approx(b + 8 * error, rel=0.05)
    assert np.std(drawn[:, 0] / drawn[:, 1]) < 0.04
    assert np.std(drawn[:, 2] + 1 / drawn[:, 1]) < 0.02


def test_a_delay_that_is_known_better_than_the_total_lag_keeps_its_error() -> None:
    model = known_as(Predictor(10.0, 0.15, 0.2), np.diag([0.1, 0.03, 0.01]) ** 2, {})

    assert np.std(np.array(believed_possible(model, "x", 4000, 0))[:, 2]) == pytest.approx(0.01, rel=0.05)


def test_a_sign_that_the_interval_excludes_is_the_tail_of_a_normal_distribution_and_no_vehicle() -> None:
    point, covariance = Predictor(3.7, 0.18, 0.15), np.diag([2.2, 0.1, 0.03]) ** 2
    model = known_as(point, covariance, {"input": (0.3, 9.0), "damping": (0.02, 0.5)})

    vehicles = np.array(believed_possible(known_as(point, covariance, {}), "x", 500, 0))[:, :2]
    known = np.array(believed_possible(model, "x", 500, 0))[:, :2]

    assert (vehicles < 0).any()
    assert 400 < len(known) < 500
    assert (known > 0).all()


def test_no_margin_is_stated_where_hardly_a_drawn_vehicle_agrees_with_the_intervals() -> None:
    model = known_as(Predictor(3.7, 0.18, 0.15), np.diag([0.2, 0.01, 3.0]) ** 2, {"delay": (0.14, 0.16)})

    with pytest.raises(ModelError, match="agree with its intervals, so no margin can be stated"):
        believed_possible(model, "x", 200, 0)


def test_a_delay_that_is_not_known_counts_as_that_of_commercial_quadrotors_and_is_not_predicted_over() -> None:
    model = without_delays(model_of())

    assert known_dynamics(model, "x").delay == 0.0
    assert known_vehicle(model, "x").delay == DELAY[0]
