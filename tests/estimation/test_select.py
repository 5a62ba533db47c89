"""`auto` takes a richer structure where the vehicle has it, and the default where it has not."""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from click.testing import CliRunner

from flights import flown, steps
from other_laws import DELAY, TRUTH, flown_by
from rotorfit.app.cli import main
from rotorfit.app.terminal import show
from rotorfit.app.terminal.coefficients import model_view
from rotorfit.assessment.leave_one_out import leave_one_out
from rotorfit.core.flight_data import Flight
from rotorfit.core.laws import STRUCTURES
from rotorfit.core.model import Axis, Model
from rotorfit.core.physics import physics
from rotorfit.estimation.fitting import fit
from rotorfit.estimation.likelihood.law_selection import FAR, NEAR, HeldOut, _Trial, _verdict, change_of
from rotorfit.files.models import from_mapping, to_mapping
from rotorfit.planning.signals import two_sines
from rotorfit.simulation.paper_vehicle import Truth

pytestmark = pytest.mark.flights


def chosen(flight: Flight, axis: str = "z") -> Axis:
    return fit([flight], axes=(axis,), structure="auto").model.axes[axis]


@cache
def strong(name: str) -> Model:
    """z of a vehicle of this law in a little wind; the law is chosen."""
    flight = flown_by(name, duration=40.0, seed=2, wind=0.05, noise=0.0005)
    return fit([flight], axes=("z",), structure="auto").model


@pytest.mark.parametrize("name", ["first_order_delay_lag", "quadratic_drag", "climb_descent", "limited_acceleration"])
def test_a_strong_lag_drag_or_asymmetry_is_found(name: str) -> None:
    axis = strong(name).axes["z"]

    assert axis.structure == name
    rows = {row.structure: row for row in axis.candidates}
    assert [row.structure for row in axis.candidates if row.chosen] == [name]
    assert rows[name].verdict.startswith("preferred to ")
    assert rows[name].bic < rows["first_order_delay"].bic == 0.0
    assert rows[name].velocity < rows["first_order_delay"].velocity  # type: ignore[operator]
    assert axis.plain is not None
    assert axis.plain.status["input"] == "ok"


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_vehicle_of_the_default_structure_keeps_it(seed: int) -> None:
    axis = chosen(flown_by("first_order_delay", duration=50.0, seed=seed, wind=0.1, noise=0.001))

    assert axis.structure == "first_order_delay"
    assert axis.plain is None
    low, high = axis.combinations["delay_plus_lag"].ci95
    assert low is not None
    assert high is not None
    assert low < DELAY < high < low + 0.03
    assert all(row.verdict.startswith(("rejected", "not ")) for row in axis.candidates[1:])
    assert axis.candidates[0].chosen


@pytest.mark.parametrize("name", ["second_order", "first_order_delay_lag"])
def test_a_law_with_a_lag_holds_a_vehicle_without_one(name: str) -> None:
    """The search ends at a lag of 5 ms, the delay then 5 ms too short."""
    flight = flown_by("first_order_delay", duration=50.0, seed=1, wind=0.05, noise=0.0002)
    axis = fit([flight], axes=("z",), structure=name).model.axes["z"]

    assert axis.plain is not None
    assert axis.structure == name
    assert axis.status["lag"] == "not_identifiable"
    for each, truth in TRUTH["first_order_delay"].items():
        (low, high), beside = axis.ci95[each], axis.plain.ci95[each]
        assert axis.status[each] == "ok"
        assert (low or -np.inf) <= min(truth, beside[0] or -np.inf)
        assert (high or np.inf) >= max(truth, beside[1] or np.inf)


@pytest.mark.parametrize(("name", "axes"), [("quadratic_drag", ("z",)), ("coupled", ("x", "y"))])
def test_a_law_whose_steady_speed_is_not_in_proportion_to_the_command_alone_has_no_steady_gain(
    name: str, axes: tuple[str, ...]
) -> None:
    flight = flown_by(name, axes, duration=20.0, seed=1, wind=0.05, noise=0.0005)
    model = fit([flight], axes=axes, structure=name).model
    axis = model.axes[axes[0]]

    assert axis.structure == name
    assert not {"steady_gain", "total_lag"} & set(axis.combinations)
    quantities = physics(model)[axes[0]]
    assert quantities["steady_speed"].measured is None
    assert quantities["steady_speed"].reason == f"steady_gain: under {name} it depends on the commands"


def test_without_a_delay_the_papers_own_structure_is_enough() -> None:
    axis = chosen(flown_by("first_order", duration=50.0, seed=4, wind=0.1, noise=0.001))

    assert axis.structure == "first_order"
    assert axis.delay == 0.0
    assert axis.ci95["delay"] == (0.0, 0.0)


def test_several_flights_are_held_out_in_turn_and_x_with_y_are_chosen_for_one_by_one() -> None:
    flights = [flown(Truth(), steps(("x", "y"), seed=seed), 15.0, seed) for seed in (1, 2)]
    model = fit(flights, axes=("x", "y"), structure="auto").model

    assert {axis: model.axes[axis].structure for axis in ("x", "y")} == dict.fromkeys("xy", "first_order_delay")
    assert "coupled" in {row.structure for row in model.axes["x"].candidates}
    assert model.axes["x"].samples is not None


@pytest.mark.slow
def test_of_twenty_simulated_default_flights_hardly_any_gets_another_structure() -> None:
    other = []
    for seed in range(20, 40):  # the rules were settled in view of seeds 0 to 19
        excitation = two_sines if seed % 2 else steps(seed=seed)
        model = fit([flown(Truth(), excitation, 60.0, seed)], structure="auto").model
        other += [
            (seed, name, axis.structure) for name, axis in model.axes.items() if axis.candidates[0].chosen is False
        ]
    assert len(other) <= 4, other  # of 80 axes


def test_the_table_of_candidates_is_kept_in_the_file_and_printed(capsys: pytest.CaptureFixture[str]) -> None:
    model = strong("first_order_delay_lag")
    raw = json.loads(json.dumps(to_mapping(model), allow_nan=False))

    assert to_mapping(from_mapping(raw, "here")) == to_mapping(model)
    show(model_view(model, ("z",)))
    printed = capsys.readouterr().out
    assert "z: structures tried" in printed
    assert "first_order_delay_lag *" in printed
    assert "With a delay alone instead: input " in printed


def test_an_unknown_structure_is_wrong_usage_in_one_line() -> None:
    result = CliRunner().invoke(main, ["fit", "a.csv", "--structure", "cubic"])

    assert result.exit_code == 2
    assert "no such structure: 'cubic'; structures are averaged, auto, first_order, " in result.output


def test_the_uncertainty_of_a_change_counts_blocks_and_not_starts() -> None:
    rng = np.random.default_rng(4)
    total, typical = [], []
    for _ in range(400):
        level = np.repeat(rng.standard_normal(12), 10)  # ten starts of a block see the same gust
        block, same = np.repeat(np.arange(12.0), 10), np.full(120, 5.0)
        rival = HeldOut({NEAR: block}, {NEAR: same})
        change = change_of(HeldOut({NEAR: block}, {NEAR: same + level}), rival, NEAR)
        assert change is not None
        total.append(abs(change.total) > change.reach * change.total_error)
        change = change_of(HeldOut({NEAR: block}, {NEAR: same * np.exp(0.3 * level)}), rival, NEAR)
        assert change is not None
        typical.append(abs(change.typical) > change.reach * change.typical_error)
    assert 0.025 < np.mean(total) < 0.08  # 5 % on both sides together
    assert 0.025 < np.mean(typical) < 0.08


def tried(name: str, bic: float, near: float, far: float, seed: int = 0) -> _Trial:
    """A law with errors of this size in a minute's flight, which vary from block to block."""
    varied = np.exp(np.random.default_rng(seed).standard_normal(12))
    held_out = HeldOut({NEAR: np.arange(12.0), FAR: np.arange(12.0)}, {NEAR: near * varied, FAR: far * varied})
    return _Trial(STRUCTURES[name], 0.0, bic, held_out, True, 0.0, None)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("criterion", "near", "far", "taken"),
    [(-300.0, 0.5, 0.8, True), (-40.0, 0.5, 0.8, False), (-300.0, 1.5, 0.8, False), (-300.0, 0.5, 3.0, False)],
)
def test_a_much_likelier_law_need_not_predict_better_beyond_doubt_but_better_and_not_worse_later(
    criterion: float, near: float, far: float, taken: bool
) -> None:
    """The criterion falls by hundreds on flights too short for predictions to be surely better."""
    rival = tried("first_order_delay", -100.0, 1.0, 1.0)
    both = tried("first_order_delay_lag", -100.0 + criterion, near, far, seed=1)
    change = change_of(both.held_out, rival.held_out, NEAR, 9)

    assert change is not None
    assert not change.better
    assert _verdict(both, rival, 9).passed == taken


@pytest.mark.parametrize(("rival", "taken"), [("first_order_lag", True), ("first_order_delay", False)])
def test_a_law_without_a_delay_does_not_stand_against_very_strong_evidence_of_one(rival: str, taken: bool) -> None:
    """The delay would be told as 0, and the lag as too long, though predictions hardly differ."""
    without = tried(rival, -100.0, 1.0, 1.0)
    both = tried("first_order_delay_lag", -140.0, 0.9, 0.9, seed=1)

    assert _verdict(both, without, 9).passed == taken


def test_where_too_little_is_held_out_for_a_test_only_very_strong_evidence_counts() -> None:
    lagging = chosen(flown_by("first_order_delay_lag", duration=18.0, seed=2, wind=0.02, noise=0.0005))
    plain = chosen(flown_by("first_order_delay", duration=18.0, seed=2, wind=0.02, noise=0.0005))

    assert lagging.structure == "first_order_delay_lag"
    (taken,) = [row for row in lagging.candidates if row.chosen]
    assert taken.verdict.startswith("preferred to first_order_delay on few data: criterion -")
    assert plain.structure == "first_order_delay"
    words = {row.verdict.split(":")[0].split(" (")[0] for row in plain.candidates[1:]}
    assert words <= {"rejected", "not judged", "not identifiable"}


def test_a_flight_is_cut_from_the_command_that_acts() -> None:
    from rotorfit.estimation.likelihood.optima import between

    flown_to = flown_by("first_order_delay", duration=20.0)
    flight = replace(flown_to, reference=2.0 * flown_to.command)
    part = between(flight, 10.0, 15.0)

    assert part.command_time[0] <= 10.0 < part.command_time[1]
    assert part.pose_time[0] >= part.command_time[0]
    assert part.pose_time[-1] <= 15.0
    assert part.reference is not None
    np.testing.assert_array_equal(part.reference, 2.0 * part.command)
    assert replace(part, command_time=flight.command_time) != flight


def test_leaving_flights_out_keeps_the_structure_that_was_asked_for() -> None:
    flights = [flown_by("first_order_delay_lag", duration=25.0, seed=s, wind=0.05, noise=0.0005) for s in (1, 2)]
    errors = [
        [
            scores.axes["z"].horizons["1"].velocity_rmse
            for scores in leave_one_out(flights, axes=("z",), structure=more).flights
        ]
        for more in ("first_order_delay_lag", "first_order_delay")
    ]

    assert all(own < 0.8 * plain for own, plain in zip(*errors, strict=True))  # type: ignore[operator]
