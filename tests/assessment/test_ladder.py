"""The ladder: every method on the same flights, the agreement test, the table, the command line."""

import json
from collections.abc import Mapping
from dataclasses import replace
from functools import cache, partial
from io import StringIO
from pathlib import Path
from typing import cast

import numpy as np
import pytest
from click.testing import CliRunner
from rich.console import Console, Group

from flights import flown, steps, truth_of
from rotorfit.app.cli import main
from rotorfit.app.terminal.scores import ladder_view
from rotorfit.assessment import method_comparison
from rotorfit.assessment.method_comparison import (
    DIFFERS,
    NOT_VALID,
    Ladder,
    MethodRow,
    agreement,
    ladder,
    statuses,
    to_mapping,
)
from rotorfit.core.finding import Finding
from rotorfit.core.model import COEFFICIENTS, NORMAL, Axis, unknown_axis
from rotorfit.estimation.fitting import fit
from rotorfit.estimation.methods import BEST, compared_methods
from rotorfit.files.models import from_mapping
from rotorfit.files.models import to_mapping as model_mapping
from rotorfit.planning.signals import two_sines
from rotorfit.simulation.paper_vehicle import Controller, Truth, simulate_flight, write_bag

pytestmark = pytest.mark.flights

BREEZE = replace(Truth(), wind_sigma=(0.02, 0.02, 0.1, 0.02))


@cache
def opened() -> Ladder:
    """z in an open loop, light wind."""
    return ladder([flown(Truth(), steps(("z",)), 40.0, 11)], ("z",))


@cache
def closed() -> Ladder:
    """z in a tight feedback loop, in a wind that matters."""
    return ladder([flown(BREEZE, steps(("z",)), 40.0, 14, controller=Controller(3.0, 3.0))], ("z",))


def rows(result: Ladder, axis: str = "z") -> dict[str, MethodRow]:
    return {row.method: row for row in result.axes[axis]}


def holds(axis: Axis, name: str) -> bool:
    low, high = axis.ci95[name]
    assert low is not None
    assert high is not None
    return low < truth_of(Truth(), "z")[name] < high


# What the rungs find


def test_every_method_has_a_row_of_every_axis_in_the_order_of_the_ladder() -> None:
    assert [row.method for row in opened().axes["z"]] == list(compared_methods())
    assert list(opened().axes) == ["z"]


@pytest.mark.parametrize("method", ["iv", "oe", "ml"])
def test_in_an_open_loop_instruments_output_error_and_likelihood_hold_the_truth(method: str) -> None:
    axis = rows(opened())[method].axis

    assert [name for name in COEFFICIENTS if not holds(axis, name)] == []


def test_a_delay_biases_the_paper_and_the_test_says_so() -> None:
    paper = rows(opened())["paper"]

    assert not holds(paper.axis, "input")
    assert not holds(paper.axis, "damping")
    assert not paper.agreement["damping"].agrees
    assert "delay" not in paper.agreement


def test_in_a_closed_loop_least_squares_is_biased_and_the_likelihood_is_not() -> None:
    found = rows(closed())

    for method in ("paper", "svf", "weak"):
        assert not holds(found[method].axis, "damping")
        assert not found[method].agreement["damping"].agrees
    assert [name for name in COEFFICIENTS if not holds(found["ml"].axis, name)] == []


def test_an_instrument_from_commands_that_answer_the_motion_is_remarked() -> None:
    assert [NOT_VALID in rows(result)["iv"].remark for result in (opened(), closed())] == [False, True]


def test_the_rung_that_is_biased_predicts_worse_and_none_worse_than_holding_the_velocity() -> None:
    error = {method: row.prediction for method, row in rows(opened()).items()}

    assert error["paper"] is not None
    assert error["ml"] is not None
    assert 1.5 * error["ml"] < error["paper"] < (opened().held["z"] or 0)


def test_an_axis_that_is_not_commanded_is_so_on_every_rung_and_findings_of_the_flight_are_told() -> None:
    flight = replace(flown(Truth(), steps(("z",)), 20.0, 13), findings=(zeros("x"), zeros("z")))
    result = ladder([flight], ("x",))

    assert [told.axis for told in result.findings if told.code == "zeros_between_commands"] == ["x"]
    assert {row.axis.status["input"] for row in result.axes["x"]} == {"not_excited"}
    assert all(row.prediction is None and not row.agreement for row in result.axes["x"])


def zeros(axis: str) -> Finding:
    return Finding("zeros_between_commands", "error", f"the {axis} command is 0 in two rows of three", "-", "-", axis)


# What the likelihood denies


@pytest.mark.parametrize("denied", ["refuted", "not_excited", "pose_frozen"])
def test_a_rung_keeps_a_number_that_the_likelihood_denies_but_not_the_status_ok(denied: str) -> None:
    best = replace(unknown_axis(denied), status={"input": denied, "damping": "not_identifiable", "delay": "ok"})
    rung = replace(known(1.0, 0.1), status={"input": "ok", "damping": "ok", "delay": "not_identifiable"})

    assert statuses(rung, best) == {"input": denied, "damping": "ok", "delay": "not_identifiable"}


# The test of agreement


def known(value: float, error: float) -> Axis:
    same: Mapping[str, float] = dict.fromkeys(COEFFICIENTS, error)
    return replace(unknown_axis("ok"), input=value, damping=value, delay=value, stderr=same)


def test_the_variance_of_the_difference_is_the_difference_of_the_variances() -> None:
    test = agreement(known(1.5, 0.5), known(1.0, 0.3))["damping"]

    assert (test.difference, test.how) == (pytest.approx(0.5), "hausman")
    assert test.stderr == pytest.approx(0.4)
    assert test.agrees


def test_a_rung_that_looks_as_sure_as_the_likelihood_is_tested_by_the_bound() -> None:
    test = agreement(known(1.5, 0.31), known(1.0, 0.3))["input"]

    assert (test.how, test.stderr) == ("bound", pytest.approx(0.61))


def test_the_test_is_of_this_flight_and_counts_errors_as_wide_as_the_intervals() -> None:
    """What the vehicle is on other flights is no part of the difference of two estimates from one flight."""
    rung = replace(known(1.5, 0.3), ci95=dict.fromkeys(COEFFICIENTS, (1.5 - 0.5 * NORMAL, 1.5 + 0.5 * NORMAL)))
    flight = dict.fromkeys(COEFFICIENTS, (1.0 - 0.3 * NORMAL, 1.0 + 0.3 * NORMAL))
    best = replace(known(1.0, 0.6), ci95=dict.fromkeys(COEFFICIENTS, (-0.2, 2.2)), ci95_flight=flight)
    test = agreement(rung, best)["damping"]

    assert (test.how, test.stderr) == ("hausman", pytest.approx(0.4))


def test_the_verdict_turns_at_the_stated_number_of_standard_errors() -> None:
    for share, agrees in ((0.99, True), (1.01, False)):
        assert agreement(known(1 + share * DIFFERS * 0.4, 0.5), known(1.0, 0.3))["delay"].agrees is agrees


def test_what_has_no_number_is_not_tested() -> None:
    nothing = unknown_axis("diverged")

    assert agreement(nothing, known(1.0, 0.1)) == {}
    assert agreement(known(1.0, 0.1), nothing) == {}
    assert set(agreement(replace(known(1.0, 0.1), delay=None), known(1.0, 0.1))) == {"input", "damping"}


@pytest.mark.slow
def test_where_both_are_right_few_are_rejected() -> None:
    """40 flights in an open loop, seeds 100 to 139: iv against ml, three coefficients each, not independent."""
    tests = []
    for seed in range(100, 140):
        flight = flown(Truth(), steps(("z",), seed=seed), 60.0, seed)
        one, two = (fit([flight], method, ("z",)).model.axes["z"] for method in ("iv", "ml"))
        tests += [test.agrees for test in agreement(one, two).values()]

    assert len(tests) >= 116  # two of the coefficients are not identifiable
    assert np.mean(tests) > 0.9


# What is written and shown


def shown(result: Ladder) -> str:
    console = Console(width=200, file=StringIO())
    console.print(Group(*ladder_view(result)))
    return cast(StringIO, console.file).getvalue()


def of_two(rung: Axis, best: Axis, *findings: Finding) -> Ladder:
    both = {"svf": rung, BEST: best}
    lines = [
        MethodRow(name, axis, statuses(axis, best), agreement(axis, best) if name != BEST else {}, None, "")
        for name, axis in both.items()
    ]
    return Ladder(("a.bag",), {"z": tuple(lines)}, {"z": None}, findings)


def test_errors_of_the_data_are_told_above_the_tables_and_every_finding_below_and_in_json() -> None:
    clean, spoiled = (of_two(known(1.0, 0.2), known(1.0, 0.1), *told) for told in ((), (zeros("z"),)))
    first, lines = "Do not use z before you have read the findings.", shown(spoiled).splitlines()

    assert first not in shown(clean)
    assert lines[1] == first
    assert lines.index("error zeros_between_commands: the z command is 0 in two rows of three") > lines.index(
        next(line for line in lines if line.startswith("svf"))
    )
    assert [told["code"] for told in to_mapping(spoiled)["findings"]] == ["zeros_between_commands"]


def test_a_number_of_a_refuted_law_is_in_brackets_and_the_reason_is_told() -> None:
    part = replace(known(1.0, 0.1), damping=None, status={"input": "ok", "damping": "refuted", "delay": "ok"})
    some, none = shown(of_two(known(1.0, 0.2), part)), shown(of_two(known(1.0, 0.2), unknown_axis("refuted")))

    assert some.splitlines()[4].split()[:7] == ["svf", "1.00", "+-", "0.20", "(1.00", "+-", "0.20)"]
    assert "agrees: input, delay" in some
    assert "ml: no damping: the flights deny the law that it belongs to, on every row; `rotorfit fit`" in some
    assert none.count("(1.00 +- 0.20)") == 3
    assert "ml: refuted" in none
    assert "ml: no number: the flights deny the law" in none


def test_the_mapping_is_json_without_nan_and_holds_every_row() -> None:
    found = json.loads(json.dumps(to_mapping(closed()), allow_nan=False))

    assert [row["method"] for row in found["axes"]["z"]["rungs"]] == list(compared_methods())
    assert found["axes"]["z"]["held"] > 0


@pytest.mark.parametrize("method", ["svf", "weak", "iv", "oe"])
def test_a_model_by_a_rung_goes_through_its_file(method: str) -> None:
    flight = flown(Truth(), steps(("z", "yaw")), 20.0, 14)
    model = fit([flight], method, axes=("z", "yaw")).model  # type: ignore[arg-type]
    again = from_mapping(json.loads(json.dumps(model_mapping(model), allow_nan=False)), "memory")

    assert model_mapping(again) == model_mapping(model)
    assert again.method == method
    for name in ("z", "yaw"):
        axis = again.axes[name]
        assert axis.predictor is not None
        assert axis.predictor.delay == pytest.approx(0.15, abs=0.15 if method == "oe" else 0.02)
        assert axis.noise["pose_variance"] == pytest.approx(Truth().mocap_noise[2 if name == "z" else 3] ** 2, rel=0.3)
    assert {f"{axis}.delay" for axis in ("z", "yaw")} <= set(again.covariance_names)
    assert np.linalg.eigvalsh(again.covariance).min() > 0


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("ladder") / "z.bag"
    write_bag(simulate_flight(Truth(), partial(two_sines, axes=("z",), amplitude=3.0), 20.0, 15), path)
    return path


def test_the_verb_prints_one_table_an_axis_with_every_rung(bag: Path) -> None:
    result = CliRunner().invoke(main, ["ladder", str(bag), "--axes", "z"])

    assert result.exit_code == 0, result.output
    lines = [line.split() for line in result.stdout.splitlines() if line]
    firsts = [line[0] for line in lines]
    assert [first for first in firsts if first in compared_methods()] == list(compared_methods())
    assert "hold" in firsts
    assert "differs: input, damping" in result.stdout


def test_the_verb_gives_json_and_fit_takes_the_rungs(bag: Path, tmp_path: Path) -> None:
    result = CliRunner().invoke(main, ["ladder", str(bag), "--axes", "z", "--json"])
    found = {row["method"]: row for row in json.loads(result.stdout)["axes"]["z"]["rungs"]}
    output = tmp_path / "svf.json"
    fitted = CliRunner().invoke(main, ["fit", str(bag), "--axes", "z", "--method", "svf", "-o", str(output), "--json"])

    assert fitted.exit_code == 0, fitted.output
    assert json.loads(output.read_text())["axes"]["z"]["input"] == pytest.approx(found["svf"]["input"])
    scored = CliRunner().invoke(main, ["validate", str(output), str(bag), "--json"])
    error = json.loads(scored.stdout)["flights"][0]["axes"]["z"]["horizons"]["1"]["velocity_rmse"]
    assert error == pytest.approx(found["svf"]["prediction"])


def test_where_the_heading_turns_x_without_the_commanded_y_is_told_to_be_predicted_without_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """By two of the rungs: what is told is of the axes that are asked for, whatever fits them."""
    monkeypatch.setattr(method_comparison, "compared_methods", lambda: ("svf", BEST))
    flight = flown(Truth(), steps(("x", "y", "yaw"), seed=1), 12.0, 1)

    found = {axes: [one.axis for one in ladder([flight], axes).findings if one.code == "other_axis_unknown"]
             for axes in (("x",), ("x", "y"))}  # fmt: skip
    assert found == {("x",): ["x"], ("x", "y"): []}
