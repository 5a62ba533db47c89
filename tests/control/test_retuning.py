"""Gains change in flight where the vehicle calls for it, once its interval has settled, and not otherwise."""

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from types import MappingProxyType

import numpy as np
import pytest
from scipy.linalg import block_diag
from test_robustness import dragged

from models import VEHICLE, Point, next_fit, with_poses
from rotorfit.control.loop_vehicle import LaggedAxis
from rotorfit.control.margins import margins
from rotorfit.control.retuning import FASTER, Flown, Retuned, Retuning
from rotorfit.control.tuning import tune
from rotorfit.core.model import Model, Plain, Predictor, first_order
from rotorfit.planning.axis_information import AxisBelief

pytestmark = pytest.mark.flights


def of_x(point: Point = VEHICLE["x"], error: float = 0.05) -> Model:
    """A model of x alone."""
    return next_fit({"x": point}, error)


@cache
def flown(error: float = 0.05) -> Mapping[str, Flown]:
    """Gains of the vehicle as it is."""
    one = tune(of_x(error=error), axes=("x",)).axes["x"]
    return MappingProxyType({"x": Flown(one.law, one.bandwidth)})


def looks(retuning: Retuning, *models: Model) -> list[Retuned]:
    """What comes of models in a row."""
    return [found for model in models if (found := retuning.look(model, ("x",)))]


def test_the_first_gains_come_when_a_second_fit_says_the_same() -> None:
    retuning, first = Retuning(), of_x()

    assert looks(retuning, first, first) == []  # no new fit, nothing new
    (found,) = looks(retuning, of_x())
    assert found.tuning.axes["x"].law == tune(of_x(), axes=("x",)).axes["x"].law
    assert "settled" in found.why["x"]


def test_where_no_rate_is_given_it_is_that_of_the_poses_of_the_flight_and_stays() -> None:
    retuning = Retuning()
    (first,) = looks(retuning, *(with_poses(of_x(error=0.2), (10.0, ("x",))) for _ in range(2)))
    (better,) = looks(retuning, *(with_poses(of_x(error=0.005), (30.0, ("x",))) for _ in range(3)))

    assert [found.tuning.rate for found in (first, better)] == [10.0, 10.0]
    assert "10 fresh poses a second" in first.tuning.note


def test_a_new_fit_of_another_axis_is_no_new_fit_of_this_one() -> None:
    """Its trims are then told for another number of flights, which makes the axis another object."""
    first = of_x()
    x = replace(first.axes["x"], trim=(None, 0.01))
    beside = replace(first, axes={**first.axes, "x": x, "z": next_fit({"z": VEHICLE["z"]}).axes["z"]})

    assert looks(Retuning(), first, beside) == []


def test_after_a_change_all_that_the_settled_fit_told_may_be_carried_over() -> None:
    g, b, tau = VEHICLE["x"]

    def bandwidth(*causes: str) -> float:
        retuning = Retuning(flown=flown(0.02))
        for cause in causes:
            looks(retuning, *(of_x(error=0.02) for _ in range(3)))
            retuning.changed(["x"], cause)
            assert "x" not in retuning.kept  # it was of the vehicle before
        (found,) = looks(retuning, *(of_x((1.6 * g, b, tau), error=0.2) for _ in range(3)))
        return found.tuning.axes["x"].bandwidth

    assert bandwidth("other", "limits") == bandwidth("limits") > bandwidth("other")


def lagged(lag: float = 0.1, point: Point = VEHICLE["x"], error: float = 0.05) -> Model:
    """The same with a lag, and the first-order law beside it, which has the lag in its delay."""
    model = of_x(point, error)
    x, (g, b, tau) = model.axes["x"], point
    plain = Plain(x.input, x.damping, x.delay, x.stderr, x.ci95, x.status, first_order(model, "x"))
    own = replace(
        x,
        structure="first_order_delay_lag",
        plain=plain,
        predictor=Predictor(g, b, tau - 0.8 * lag, {"lag": lag}),
        ci95={},
    )
    names = (*model.covariance_names, "x.lag")
    covariance = block_diag(model.covariance, [[(0.02 * lag) ** 2]])
    return replace(model, axes={**model.axes, "x": own}, covariance_names=names, covariance=covariance)


def test_an_axis_with_a_lag_has_gains_of_the_first_order_law_beside_it_and_margins_of_its_own() -> None:
    (found,) = looks(Retuning(), lagged(), lagged())

    x, (g, b, tau) = found.tuning.axes["x"], VEHICLE["x"]
    assert (x.law.input, x.law.damping, x.law.delay) == VEHICLE["x"]
    own, plain = margins(x.law, LaggedAxis(g, b, tau - 0.08, 0.1, 0.0, 1)), margins(x.law, AxisBelief(*VEHICLE["x"]))
    assert (x.margins.peak, x.margins.delay) == pytest.approx((own.peak, own.delay))
    assert abs(own.peak - plain.peak) > 0.01
    assert "margins its own of first_order_delay_lag" in x.note


def dragged_fits(share: float = 0.8, number: int = 4) -> list[Model]:
    """New fits of the same vehicle."""
    model = dragged(share)
    x = model.axes["x"]
    errors = [{**x.stderr, "input": 0.03 + 1e-12 * k} for k in range(number)]
    return [replace(model, axes={**model.axes, "x": replace(x, stderr=each)}) for each in errors]


def test_gains_at_hover_of_an_axis_with_quadratic_drag_are_not_those_of_another_vehicle() -> None:
    """Their damping is far from that of the first-order law beside it."""
    assert [one.tuning.axes["x"].law.damping for one in looks(Retuning(), *dragged_fits())] == pytest.approx([0.3])


def test_nothing_that_knows_no_hover_is_carried_over_to_quadratic_drag() -> None:
    """The first-order law beside it agrees with what is known: its damping is that of the flown speeds."""
    retuning = Retuning(flown=flown(0.02), before=of_x((2.9, 1.7, 0.1), error=0.002))
    retuning.changed(["x"], "limits")
    (found,) = looks(retuning, *dragged_fits())

    assert found.tuning.axes["x"].law.damping == pytest.approx(0.3)


def test_a_drag_at_its_bound_gives_gains_once() -> None:
    """It has no error: the damping at hover is 0 in all that is believed possible."""
    sure = [
        replace(one, covariance=one.covariance[:3, :3], covariance_names=one.covariance_names[:3])
        for one in dragged_fits(1.0)
    ]

    assert [one.tuning.axes["x"].law.damping for one in looks(Retuning(), *sure)] == [0.0]


def test_fits_that_move_by_their_noise_never_make_it_chatter() -> None:
    rng, (g, b, tau), retuning = np.random.default_rng(1), VEHICLE["x"], Retuning(flown=flown())
    noise = rng.standard_normal((12, 3)) * (0.05 * g, 0.05 * b, 0.005)

    assert looks(retuning, *(of_x((g + i, b + j, tau + k)) for i, j, k in noise.tolist())) == []


def test_gains_of_a_flight_that_told_more_are_not_given_up_for_one_that_tells_less() -> None:
    assert looks(Retuning(flown=flown(0.01)), *(of_x(error=0.2) for _ in range(4))) == []


def test_a_vehicle_that_is_known_better_gets_faster_gains_once() -> None:
    retuning, slow = Retuning(flown=flown(0.2)), flown(0.2)["x"].bandwidth

    (found,) = looks(retuning, *(of_x(error=0.01) for _ in range(5)))
    assert found.tuning.axes["x"].bandwidth >= FASTER * slow
    assert "known better" in found.why["x"]


@pytest.mark.parametrize("factor", [0.6, 1.6])
def test_gains_of_another_vehicle_are_replaced_once(factor: float) -> None:
    g, b, tau = VEHICLE["x"]
    (found,) = looks(Retuning(flown=flown()), *(of_x((factor * g, b, tau)) for _ in range(5)))

    assert found.tuning.axes["x"].law.input == pytest.approx(factor * g)


def test_after_a_change_what_was_fitted_before_says_nothing() -> None:
    g, b, tau = VEHICLE["x"]
    retuning, other = Retuning(flown=flown()), (g, b, tau + 0.1)
    assert looks(retuning, of_x(), of_x()) == []
    retuning.changed(["x"], "other")

    assert looks(retuning, of_x(other)) == []  # one fit has not settled
    (found,) = looks(retuning, of_x(other), of_x(other))
    assert found.why["x"].startswith("the vehicle has changed")


def test_a_revised_change_is_as_if_it_had_been_named_so_at_once() -> None:
    retuning = Retuning(flown=flown(0.02), before=of_x(error=0.02))
    retuning.changed(["x"], "other")
    retuning.changed(["x"], "payload", revised=True)

    assert looks(retuning, *(of_x(error=0.2) for _ in range(3))) == []


def test_fits_that_still_learn_have_not_settled() -> None:
    assert looks(Retuning(), of_x(error=0.3), of_x(error=0.15), of_x(error=0.07)) == []
    g, b, tau = VEHICLE["x"]
    assert looks(Retuning(), of_x(), of_x((1.5 * g, b, tau)), of_x((g, b, tau))) == []


def test_after_a_change_of_limits_what_was_known_of_damping_and_delay_still_is() -> None:
    g, b, tau = VEHICLE["x"]
    retuning, vague = Retuning(flown=flown(0.02), before=of_x(error=0.02)), (1.5 * g, 1.1 * b, tau + 0.004)
    assert looks(retuning, of_x(), of_x()) == []
    retuning.changed(["x"], "limits")
    (found,) = looks(retuning, *(of_x(vague, error=0.15) for _ in range(3)))
    law = found.tuning.axes["x"].law

    assert (law.damping, law.delay) == pytest.approx((b, tau))
    assert law.input == pytest.approx(1.5 * g, rel=0.15)


def test_what_is_carried_over_gives_way_where_the_flight_contradicts_it() -> None:
    g, b, tau = VEHICLE["x"]
    retuning, other = Retuning(flown=flown(0.02), before=of_x(error=0.02)), (1.5 * g, b, tau + 0.1)
    retuning.changed(["x"], "limits")
    (found,) = looks(retuning, *(of_x(other) for _ in range(3)))

    assert found.tuning.axes["x"].law.delay == pytest.approx(tau + 0.1)


def test_an_earlier_model_that_says_more_is_what_the_vehicle_is_believed_to_be() -> None:
    g, b, tau = VEHICLE["x"]
    (found,) = looks(Retuning(before=of_x(error=0.02)), *(of_x((1.1 * g, b, tau), error=0.2) for _ in range(3)))

    assert found.tuning.axes["x"].law.input == pytest.approx(g)


def test_after_a_payload_input_and_delay_are_still_known_and_the_damping_is_learnt_anew() -> None:
    g, b, tau = VEHICLE["x"]
    lighter = [of_x((1.05 * g, 3.0 * b, tau + 0.002), error=0.1) for _ in range(3)]
    retuning = Retuning(before=of_x(error=0.02))
    retuning.changed(["x"], "payload")
    (found,) = looks(retuning, *lighter)
    law = found.tuning.axes["x"].law

    assert (law.input, law.delay) == pytest.approx((g, tau))
    assert law.damping > 2.0 * b


def test_an_axis_that_is_not_told_in_full_is_tuned_only_where_the_rest_is_carried_over() -> None:
    g, b, tau = VEHICLE["x"]
    others = [of_x((1.5 * g, b, tau), error=0.15) for _ in range(3)]
    alone, after = Retuning(flown=flown(0.02)), Retuning(flown=flown(0.02), before=of_x(error=0.02))
    for retuning in (alone, after):
        retuning.changed(["x"], "limits")

    assert [alone.look(model, (), ("x",)) for model in others] == [None] * 3
    assert any(after.look(model, (), ("x",)) for model in others)


def test_gains_that_are_the_first_after_a_change_are_flown_like_any_other() -> None:
    """A change before there were gains is no reason to replace them later by less evidence."""
    g, b, tau = VEHICLE["x"]
    other = of_x((1.3 * g, b, tau))
    found = []
    for changed in (False, True):
        retuning = Retuning()
        if changed:
            retuning.changed(["x"], "other")
        found.append([new.why["x"] for new in looks(retuning, of_x(), of_x(), other, other, other)])

    assert found[0] == found[1] == ["the first, as its estimate has settled"]


def test_the_last_revision_counts_alone() -> None:
    once, twice = Retuning(flown=flown(0.02)), Retuning(flown=flown(0.02))
    for retuning in (once, twice):
        looks(retuning, of_x(), of_x())
        retuning.changed(["x"], "limits")
    twice.changed(["x"], "delay", revised=True)
    for retuning in (once, twice):
        retuning.changed(["x"], "thrust", revised=True)
    g, b, tau = VEHICLE["x"]
    models = [of_x((0.5 * g, b, tau))] * 3

    assert [new.why for new in looks(twice, *models)] == [new.why for new in looks(once, *models)]
    assert twice.kept == once.kept


def test_a_vehicle_that_is_believed_to_be_as_before_has_the_gains_and_margins_of_the_earlier_model() -> None:
    """Its lag, which this flight does not tell yet, is not lost."""
    (found,) = looks(Retuning(before=lagged(error=0.02), name="m.json"), *(of_x(error=0.2) for _ in range(3)))
    x, as_tuned = found.tuning.axes["x"], tune(lagged(error=0.02), axes=("x",)).axes["x"]

    assert x.law == as_tuned.law
    assert x.robustness.peak == pytest.approx(as_tuned.robustness.peak)
    assert found.why["x"].endswith("input, damping and delay are from m.json, which this flight does not contradict")


def test_what_a_change_leaves_is_carried_over_under_the_law_with_a_lag_too() -> None:
    g, b, tau = VEHICLE["x"]
    retuning = Retuning(flown=flown(0.02))
    looks(retuning, *(lagged(0.15, error=0.02) for _ in range(3)))
    retuning.changed(["x"], "delay")
    found = looks(retuning, *(lagged(0.15, (1.05 * g, b, tau + 0.06), 0.1) for _ in range(3)))[-1]
    x = found.tuning.axes["x"]
    true = margins(x.law, LaggedAxis(g, b, tau + 0.06 - 0.12, 0.15, 0.0, 1))

    assert x.law.input == pytest.approx(g)
    assert "margins its own of first_order_delay_lag" in x.note
    assert (true.peak < x.robustness.peak, true.delay > x.robustness.delay) == (True, True)
    assert "; input and damping are from before the change" in found.why["x"]


def test_an_earlier_model_without_a_lag_does_not_stand_for_a_flight_that_shows_one() -> None:
    fits = [lagged(error=0.2) for _ in range(3)]
    (found,) = looks(Retuning(before=of_x(error=0.02)), *fits)

    assert found.tuning.axes["x"].law == tune(fits[0], axes=("x",)).axes["x"].law


def test_nothing_is_combined_across_two_laws() -> None:
    g, b, tau = VEHICLE["x"]
    retuning = Retuning(flown=flown(0.02), before=lagged(error=0.02))
    retuning.changed(["x"], "limits")
    (found,) = looks(retuning, *(of_x((1.5 * g, 1.1 * b, tau + 0.004), error=0.1) for _ in range(3)))

    assert found.tuning.axes["x"].law.damping == pytest.approx(1.1 * b)
    assert "from" not in found.why["x"]


@pytest.mark.parametrize("doubted", [False, True])
def test_nothing_is_carried_over_to_another_vehicle_or_while_an_axis_contradicts_it(doubted: bool) -> None:
    g, b, tau = VEHICLE["x"]
    vague, retuning = [of_x((1.1 * g, b, tau), error=0.2) for _ in range(5)], Retuning(before=of_x(error=0.02))
    if not doubted:
        retuning.another()
    found = [retuning.look(model, ("x",), doubted=doubted) for model in vague[:3]]

    assert [new.tuning.axes["x"].law.input for new in found if new] == pytest.approx([1.1 * g])
    assert [retuning.look(model, (), ("x",), doubted=doubted) for model in vague[3:]] == [None, None]


def test_after_another_vehicle_only_what_this_flight_told_is_carried_past_a_change() -> None:
    g, b, tau = VEHICLE["x"]
    retuning = Retuning(before=of_x(error=0.02))
    looks(retuning, *(of_x((1.1 * g, 1.1 * b, tau), error=0.1) for _ in range(3)))
    retuning.another()
    retuning.changed(["x"], "limits")
    (found,) = looks(retuning, *(of_x((2.0 * g, 1.2 * b, tau), error=0.2) for _ in range(3)))

    assert found.tuning.axes["x"].law.damping == pytest.approx(1.1 * b)


def test_a_revision_takes_nothing_back_of_what_another_vehicle_means() -> None:
    retuning = Retuning(flown=flown())
    retuning.changed(("z",), "payload")
    retuning.another()
    retuning.changed(("z",), "payload", revised=True)

    assert retuning._anew >= flown().keys()


def test_what_settles_while_it_is_withheld_is_tuned_for_afterwards() -> None:
    fits, retuning = [next_fit({"x": VEHICLE["x"]}) for _ in range(2)], Retuning()

    assert [retuning.look(fit, ("x",), withheld=("x",)) for fit in fits] == [None, None]
    assert retuning.look(fits[-1], ("x",)) is not None
    assert retuning.look(fits[-1], ("x",)) is None


def test_what_settled_while_it_was_withheld_is_not_tuned_for_against_a_newer_fit() -> None:
    gain, *rest = VEHICLE["x"]
    fits, retuning = [next_fit({"x": (1.6 * gain, *rest)}) for _ in range(2)], Retuning()
    for fit in fits:
        retuning.look(fit, ("x",), withheld=("x",))

    assert retuning.look(next_fit({"x": VEHICLE["x"]}), ("x",)) is None
    later = retuning.look(next_fit({"x": VEHICLE["x"]}), ("x",))
    assert later is not None
    assert later.tuning.axes["x"].law == tune(next_fit({"x": VEHICLE["x"]}), rate=later.tuning.rate).axes["x"].law
