"""The default laws: the law that the vehicle has, intervals that hold it, and a lag that a gusty flight cannot lose."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drifting_pose import DELAY, B, G, drifting
from flights import flown, steps
from other_laws import TRUTH, flown_by
from rotorfit.app.workflows import load_flight
from rotorfit.control.tuning import tune
from rotorfit.core.laws import structure_named
from rotorfit.core.model import Axis, Model, first_order
from rotorfit.dynamics.trajectory import state_space
from rotorfit.dynamics.transfer_function import law_response
from rotorfit.estimation import fitting
from rotorfit.estimation.fitting import estimate_group, fit
from rotorfit.estimation.likelihood import law_average, richer_laws
from rotorfit.estimation.likelihood.blocks import Record
from rotorfit.estimation.likelihood.extra_parameters import structure_at
from rotorfit.estimation.likelihood.fisher_scoring import Optimum
from rotorfit.estimation.likelihood.parameters import Point
from rotorfit.estimation.likelihood.richer_laws import under_law
from rotorfit.files.log_span import parse_log
from rotorfit.files.models import from_mapping, to_mapping
from rotorfit.simulation.paper_vehicle import Truth

LOOP, LAGGED, PLAIN = "second_order_zero", "first_order_delay_lag", "first_order_delay"


def missed(axis: Axis, truth: dict[str, float]) -> list[str]:
    """What of a truth lies outside of its interval."""
    ends = dict(axis.ci95) | {name: part.ci95 for name, part in axis.combinations.items()}
    return [
        name
        for name, value in truth.items()
        if not ((ends[name][0] or -np.inf) <= value <= (np.inf if ends[name][1] is None else ends[name][1]))
    ]


@pytest.fixture(scope="module")
def models() -> dict[str, Model]:
    """z of three vehicles under the default laws."""
    flights = {name: flown_by(name, duration=40.0, seed=4, wind=0.05, noise=0.001) for name in (PLAIN, LAGGED, LOOP)}
    return {name: fit([flight], axes=("z",)).model for name, flight in flights.items()}


@pytest.mark.parametrize("name", [PLAIN, LAGGED, LOOP])
def test_the_law_of_the_vehicle_is_among_those_that_hold_and_its_numbers_inside(
    name: str, models: dict[str, Model]
) -> None:
    axis = models[name].axes["z"]

    assert name in [law.structure for law in axis.laws]
    assert sum(law.weight for law in axis.laws) == pytest.approx(1.0)
    assert missed(axis, TRUTH[name]) == []


@pytest.mark.parametrize(
    ("axis", "seed"),
    [
        ("z", 0),
        ("yaw", 3),
        pytest.param("z", 6, marks=pytest.mark.slow),
        pytest.param("yaw", 6, marks=pytest.mark.slow),
    ],
)
def test_a_zero_that_cancels_a_pole_takes_no_number_from_a_vehicle_without_either(axis: str, seed: int) -> None:
    """Any lag will do with the zero that belongs to it: much spread of each, and next to nothing of the pair."""
    flight = flown(Truth(), steps((axis,), seed=seed), 40.0, seed)
    known = fit([flight], axes=(axis,)).model.axes[axis]

    assert LOOP not in [law.structure for law in known.laws]
    assert set(known.status.values()) == {"ok"}


def test_a_slow_pole_that_a_zero_may_cancel_leaves_the_first_order_law_its_reading() -> None:
    """A drift of the pose makes the pair 10 log units likelier; what it leaves is a first-order law all the same."""
    known = fit([drifting(47)], axes=("z",)).model.axes["z"]

    assert known.structure == LOOP
    assert known.laws[0].weight > 0.9
    assert [law.structure for law in known.laws] == [LOOP, PLAIN]
    assert (
        missed(known, {"input": G, "damping": B, "delay": DELAY, "steady_gain": G / B, "total_lag": DELAY + 1 / B})
        == []
    )
    assert known.status["damping"] == "not_identifiable"


def test_a_loop_that_overshoots_keeps_no_law_beside_it(models: dict[str, Model]) -> None:
    assert [law.structure for law in models[LOOP].axes["z"].laws] == [LOOP]


def test_every_law_that_an_axis_may_have_is_climbed_also_one_that_is_then_left_out() -> None:
    flight = flown(Truth(), steps(("z",), seed=0), 40.0, 0)
    estimates = estimate_group([flight], ("z",), {})

    climbed = law_average.default_laws([flight], estimates, {})["z"]
    kept = law_average.families([flight], estimates, {})["z"].laws

    assert [structure_at(one.optimum, one.place).name for one in climbed] == [PLAIN, LAGGED, LOOP]
    assert LOOP not in [structure_at(law.estimate.optimum, law.estimate.place).name for law in kept]


def test_a_climb_is_given_up_only_where_its_law_would_be_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    flight, climbed = flown(Truth(), steps(("z",), seed=2), 40.0, 2), list[str]()
    finished = richer_laws.finished

    def noted(records: Sequence[Record], point: Point, *others: Any) -> Optimum:
        climbed.append(point.structures[0].name)
        return finished(records, point, *others)

    monkeypatch.setattr(richer_laws, "finished", noted)

    quick = fit([flight], axes=("z",)).model
    assert climbed == [LAGGED]
    monkeypatch.setattr(law_average, "_cannot_hold", lambda *_: False)
    thorough = fit([flight], axes=("z",)).model
    assert climbed[1] == LAGGED
    assert set(climbed[2:]) == {LOOP}
    assert to_mapping(quick) == to_mapping(thorough)


def test_a_loop_that_overshoots_is_taken_for_what_it_is_where_a_delay_alone_reads_the_peak_as_gain(
    models: dict[str, Model],
) -> None:
    axis = models[LOOP].axes["z"]

    assert axis.structure == LOOP
    assert axis.plain is not None
    assert axis.combinations["steady_gain"].value == pytest.approx(TRUTH[LOOP]["steady_gain"], rel=0.05)
    assert axis.input is not None
    assert axis.damping is not None
    assert axis.input / axis.damping == pytest.approx(axis.combinations["steady_gain"].value)


def test_a_law_that_is_asked_for_is_neither_averaged_nor_told_a_prior(models: dict[str, Model]) -> None:
    flight = flown_by(PLAIN, duration=30.0, seed=4, wind=0.05, noise=0.001)
    axis = fit([flight], axes=("z",), structure=PLAIN).model.axes["z"]

    assert axis.structure == PLAIN
    assert axis.laws == ()
    assert axis.lag_prior is None
    assert axis.plain is None
    assert models[LAGGED].axes["z"].lag_prior is not None


def test_a_zero_that_vanishes_leaves_the_delay_as_uncertain_as_its_interval_and_their_difference_known() -> None:
    """There the zero has exactly the effect of a shorter delay: curvature tells nothing of either."""
    model = fit([flown_by("second_order", duration=30.0, seed=5, wind=0.05, noise=0.001)], axes=("z",)).model
    axis = model.axes["z"]
    (low, high), error = axis.ci95["delay"], axis.stderr["delay"]

    assert axis.structure == LOOP
    assert axis.predictor is not None
    assert axis.predictor.extra["zero"] < 1e-3
    assert axis.status["delay"] == "ok"
    assert missed(axis, TRUTH["second_order"]) == []
    assert low is not None
    assert high is not None
    assert error is not None
    assert (high - low) / 4 / 3 < error < high - low
    at = [model.covariance_names.index(f"z.{name}") for name in ("delay", "zero")]
    assert np.array([1.0, -1.0]) @ model.covariance[np.ix_(at, at)] @ [1.0, -1.0] < (0.5 * error) ** 2
    assert all(law.stderr["delay"] < high - low for law in axis.laws)


def test_in_gusts_the_prior_of_the_lag_keeps_the_input_finite() -> None:
    flight = flown_by(LAGGED, duration=30.0, seed=2, wind=0.6, noise=0.005)
    axis = fit([flight], axes=("z",)).model.axes["z"]
    low, high = axis.ci95["input"]

    assert low is not None
    assert high is not None
    assert low <= TRUTH[LAGGED]["input"] <= high
    assert high < 3 * low


def test_an_input_whose_sign_no_lagged_law_has_is_fitted_nevertheless() -> None:
    """Of an input near zero, noise decides the sign, and perhaps otherwise under another law."""
    flight = flown(Truth(), steps(("z",), seed=3, every=4.0), 20.0, 3)
    plain = fit([flight], axes=("z",), structure=PLAIN).estimates["z"]
    point = plain.optimum.point
    backwards = replace(plain, optimum=replace(plain.optimum, point=replace(point, gain=-point.gain)))

    found = under_law(backwards, "z", structure_named(LAGGED)).optimum.point
    assert found.gain[0] == pytest.approx(point.gain[0], rel=0.05)


@pytest.mark.parametrize(("delay", "taken"), [(0.1, True), (-0.02, False)])
def test_a_climb_from_other_levels_that_ends_at_the_inverse_of_a_loop_is_not_taken(
    monkeypatch: pytest.MonkeyPatch, delay: float, taken: bool
) -> None:
    """It can be likelier by far; on the recorded flight X the yaw ends there, with a gain of -130 and -0.017 s."""
    flight = flown(Truth(), steps(("z",), seed=3), 20.0, 3)
    plain = fit([flight], axes=("z",), structure=PLAIN).estimates["z"]
    point = replace(plain.optimum.point, gain=np.array([-100.0]), log_damping=np.array([4.5]), delay=np.array([delay]))
    likelier = replace(plain.optimum.score, log_likelihood=plain.optimum.score.log_likelihood + 100.0)
    other = replace(plain.optimum, point=point, score=likelier)
    monkeypatch.setattr(law_average, "maximise_restricted", lambda *_: other)

    assert (law_average._relevelled({"z": plain})["z"].optimum is other) == taken


def test_an_axis_faster_than_the_log_has_no_damping() -> None:
    flight = flown_by(LAGGED, duration=30.0, seed=2, wind=0.02, noise=0.001)
    sparse = replace(flight, pose_time=flight.pose_time[::100], position=flight.position[::100], yaw=flight.yaw[::100])
    axis = fit([sparse], axes=("z",), structure=PLAIN).model.axes["z"]

    assert axis.status["damping"] == axis.status["input"] == "not_identifiable"
    assert axis.damping is None


@pytest.mark.parametrize("name", [LAGGED, LOOP])
def test_the_first_order_law_beside_another_has_the_errors_of_the_vehicle_and_can_be_flown_by(
    name: str, models: dict[str, Model]
) -> None:
    model = models[name]
    beside = first_order(model, "z")
    one = fit([flown_by(name, duration=40.0, seed=4, wind=0.05, noise=0.001)], axes=("z",), structure=PLAIN)
    errors = np.sqrt(np.diag(one.estimates["z"].optimum.inverse))[[0, 2]]  # input and delay, as the likelihood has them

    assert model.axes["z"].structure == name
    assert beside.stderr["input"] > errors[0]  # its levels are the lower ones of the other law
    assert beside.stderr["delay"] > 1.05 * errors[1]
    assert tune(model, axes=("z",)).axes["z"].robustness.unstable == 0


def test_the_model_file_keeps_the_laws(models: dict[str, Model]) -> None:
    again = from_mapping(to_mapping(models[LOOP]), "here")

    assert again.axes["z"].laws == models[LOOP].axes["z"].laws
    assert again.axes["z"].plain == models[LOOP].axes["z"].plain
    assert first_order(again, "z").structure == PLAIN


@pytest.mark.parametrize("name", [PLAIN, LAGGED, LOOP])
def test_the_response_to_a_sine_is_that_of_the_state_space(name: str) -> None:
    model = fit([flown_by(name, duration=30.0, seed=1)], axes=("z",), structure=name).model
    space, point = state_space(model), model.axes["z"].predictor
    assert point is not None
    for w in (0.5, 3.0, 9.0):
        n = len(space.A)
        direct = (space.C @ np.linalg.solve(1j * w * np.eye(n) - space.A, space.B))[0, 0] * 1j * w
        direct *= np.exp(-1j * w * space.delay[0])
        assert law_response(structure_named(name), point, np.array([w]))[0] == pytest.approx(direct, rel=1e-9)


def test_no_law_brings_back_an_optimum_that_the_search_has_left_out(
    real_flights: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Yaw of the Bebop 2 is only held in these parts of a flight: one predicts worse, one is its controller."""
    # as of an axis that a loop holds and something else moves
    monkeypatch.setattr(fitting, "restored_axes", lambda *_, **__: ())
    folder = real_flights / "bebop2-wsu"
    early, late = (
        fit(
            [load_flight(parse_log(f"{folder}/Training_CT_TestDay_X.mat@{part}"), f"{folder}/card.toml")], axes=("yaw",)
        )
        for part in ("0:56", "112:168")
    )

    known = early.model.axes["yaw"].predictor
    assert known is None or known.delay > 0.1  # of the likelier optimum it is 0.02 s
    known = late.model.axes["yaw"].predictor
    assert known is None or known.input > 0
