"""Every flight scored by a model of the others; axes that cannot be left out are said to be so."""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from flights import fit_as_flown, flown, steps
from rotorfit.assessment.leave_one_out import LeaveOneOut, leave_one_out, leave_one_out_mapping
from rotorfit.assessment.validation import validate
from rotorfit.core.errors import FlightError
from rotorfit.core.flight_data import Flight
from rotorfit.estimation.fitting import fit
from rotorfit.files.models import from_mapping, to_mapping
from rotorfit.simulation.paper_vehicle import GAMMA_B, Truth

SEEDS = (1, 2, 3)
LAW = "first_order_delay"


@cache
def flights() -> tuple[Flight, ...]:
    """Three flights: x moves in all, z in the second only."""
    moved = {1: ("x",), 2: ("x", "z"), 3: ("x",)}
    parts = (flown(Truth(), steps(moved[seed], seed=seed), 25.0, seed) for seed in SEEDS)
    return tuple(replace(part, path=f"{seed}.bag") for seed, part in zip(SEEDS, parts, strict=True))


@cache
def result() -> LeaveOneOut:
    return leave_one_out(flights(), axes=("x", "z"), horizons=(1.0, 2.0), structure=LAW)


def test_each_flight_has_the_scores_of_the_model_of_the_others() -> None:
    others = fit_as_flown([flights()[0], flights()[2]], axes=("x", "z")).model
    alone = validate(others, [flights()[1]], (1.0, 2.0))

    assert [each.path for each in result().flights] == ["1.bag", "2.bag", "3.bag"]
    assert result().flights[1] == alone.flights[0]
    assert result().baselines["paper"][1] == alone.baselines["paper"][0]
    assert not any(each.fitted for each in result().flights)


def test_an_axis_that_only_one_flight_moves_is_said_not_to_be_proved() -> None:
    assert result().notes == ("z: only 2.bag moves it, so it cannot be left out: z is not tested",)
    assert result().flights[1].axes["z"].horizons["1"].velocity_rmse is None


def test_an_axis_that_the_others_cannot_tell_is_named_with_the_flight_and_the_reason() -> None:
    short = flown(Truth(), steps(("z",), seed=4), 4.0, 4)
    found = leave_one_out(
        [*flights()[1:2], replace(short, path="short.bag")], axes=("z",), horizons=(1.0,), structure=LAW
    )

    assert found.notes == ("z: without 2.bag the others do not determine it (too_short)",)
    assert found.spread[0].values[0] is None
    assert found.spread[0].jackknife_stderr is None


def test_the_spread_holds_the_coefficients_of_the_fits_and_their_jackknife_error() -> None:
    spread = {(each.axis, each.name): each for each in result().spread}
    models = [fit_as_flown([f for f in flights() if f is not left], axes=("x",)).model for left in flights()]
    values = [model.axes["x"].predictor.damping for model in models if model.axes["x"].predictor]

    x = spread["x", "damping"]
    assert x.values == pytest.approx(values)
    assert (x.low, x.high) == (min(x.values), max(x.values))
    assert x.jackknife_stderr == pytest.approx(np.sqrt(2 / 3 * np.sum((np.array(values) - np.mean(values)) ** 2)))
    assert x.low < GAMMA_B[1] + 0.1
    assert set(spread) >= {("x", "input"), ("x", "delay"), ("x", "steady_gain"), ("x", "total_lag")}


@pytest.mark.slow
def test_the_jackknife_error_is_near_the_stated_one_where_flights_differ_by_noise_alone() -> None:
    """Eight flights: the error of an error from eight values is a quarter of it."""
    many = [flown(Truth(), steps(("z",), seed=seed), 15.0, seed) for seed in range(8)]
    stated = fit(many, axes=("z",), structure=LAW).model.axes["z"].stderr["input"]
    found = leave_one_out(many, axes=("z",), horizons=(1.0,), structure=LAW)

    jackknife = next(each.jackknife_stderr for each in found.spread if each.name == "input")
    assert stated is not None
    assert jackknife is not None
    assert 0.4 < jackknife / stated < 2.2


def test_the_models_are_tested_against_the_baselines() -> None:
    against = {test.second: test.axes["x"]["1"]["velocity"] for test in result().paired}

    assert set(against) == {"hold", "paper"}
    assert len(against["hold"].flights) == 3
    assert against["hold"].pooled is not None
    assert against["hold"].pooled.verdict == "better"


def test_the_model_file_keeps_it() -> None:
    model = fit_as_flown(flights()[:1], axes=("x",)).model
    assert to_mapping(model)["leave_one_out"] is None

    kept = replace(model, leave_one_out=leave_one_out_mapping(result()))
    raw = json.loads(json.dumps(to_mapping(kept), allow_nan=False))
    assert raw["leave_one_out"]["flights"][2]["axes"]["x"]["horizons"]["2"]["n"] > 0
    assert from_mapping(raw, "model.json").leave_one_out == raw["leave_one_out"]


def test_a_file_of_an_earlier_version_without_it_is_read() -> None:
    raw = to_mapping(fit_as_flown(flights()[:1], axes=("x",)).model)
    del raw["leave_one_out"]

    assert from_mapping(raw, "model.json").leave_one_out is None


def test_progress_is_told_and_one_flight_is_refused_in_one_line() -> None:
    said: list[str] = []
    leave_one_out(flights()[:2], "paper", ("x",), (1.0,), lambda _fraction, text: said.append(text))
    assert said == ["all but 1.bag", "all but 2.bag"]

    with pytest.raises(FlightError, match="at least two logs"):
        leave_one_out(flights()[:1])
