"""The accuracy table: five standard errors, what moves together, whether flights agree."""

import json
from collections.abc import Sequence
from dataclasses import asdict, replace
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from flights import fit_as_flown, flown, steps
from rotorfit.app.cli import main
from rotorfit.assessment.flight_differences import disagreement_findings
from rotorfit.assessment.uncertainty import observed_covariance, sandwich_covariance, scatter, with_uncertainty
from rotorfit.core.accuracy import Uncertainty
from rotorfit.core.flight_data import Flight
from rotorfit.core.model import COEFFICIENTS
from rotorfit.core.results import Fit
from rotorfit.estimation.fitting import fit
from rotorfit.estimation.likelihood.axis_estimate import estimate_axis
from rotorfit.files.models import from_mapping, to_mapping
from rotorfit.files.schema import structured
from rotorfit.planning.signals import two_sines
from rotorfit.reporting.accuracy import accuracy_lines, error_rows, percent_rows
from rotorfit.simulation.paper_vehicle import GAMMA_B, Truth, simulate_flight, write_bag

ERRORS = ("observed", "sandwich", "bootstrap")


@cache
def one_flight() -> Fit:
    return with_uncertainty(
        fit([flown(Truth(), steps(("z",), seed=4), 40.0, 4)], axes=("z",), structure="first_order_delay"), flights=60
    )


def pair_of_flights(gains: Sequence[float], axis: str = "z") -> list[Flight]:
    truths = [Truth(gamma=(*GAMMA_B[:4], gain, *GAMMA_B[5:])) for gain in gains]
    return [flown(truth, steps((axis,), seed=20 + i), 25.0, 20 + i) for i, truth in enumerate(truths)]


@cache
def alike() -> Fit:
    return fit(pair_of_flights([GAMMA_B[4]] * 3), axes=("z",), structure="first_order_delay")


@cache
def unlike() -> Fit:
    return fit(pair_of_flights([GAMMA_B[4], 1.3 * GAMMA_B[4]]), axes=("z",), structure="first_order_delay")


def test_where_the_model_is_true_all_standard_errors_say_about_the_same() -> None:
    table = one_flight().model.uncertainty
    assert table is not None

    for name, known in table.axes["z"].coefficients.items():
        for error in ERRORS:
            assert getattr(known, error) == pytest.approx(known.expected, rel=0.4), f"{name} {error}"
        assert not known.ragged
        assert known.scatter is None
        assert known.expected <= (one_flight().model.axes["z"].stderr[name] or 0.0)  # that of the vehicle


def test_percentages_are_of_the_value_and_insensitivity_never_passes_the_error() -> None:
    table = one_flight().model.uncertainty
    assert table is not None

    for known in table.axes["z"].coefficients.values():
        assert known.percent is not None
        assert known.insensitivity is not None
        assert known.percent == pytest.approx(100 * known.expected / abs(known.value))
        assert 0 < known.insensitivity <= known.percent


def test_the_correlation_is_that_of_the_covariance_of_the_model() -> None:
    model = one_flight().model
    assert model.uncertainty is not None

    size = np.sqrt(np.diag(model.covariance))
    expected = model.covariance / np.outer(size, size)
    np.testing.assert_allclose(model.uncertainty.axes["z"].correlation, expected, atol=1e-9)


def test_a_servo_faster_than_its_commands_has_one_gain_and_it_is_told() -> None:
    """Slow sines on a fast axis: input and damping are one, their ratio is known."""
    result = fit_as_flown([flown(Truth(), partial(two_sines, axes=("z",), amplitude=2.0), 50.0, 2)], axes=("z",))

    model = with_uncertainty(result, flights=5).model
    table = model.uncertainty
    assert table is not None
    (pair,) = (p for p in table.axes["z"].inseparable if p.pair == ("input", "damping"))
    assert pair.correlation > 0.9
    assert pair.combination == "steady_gain"
    assert pair.ci95 is not None
    low, high = pair.ci95
    assert low < GAMMA_B[4] / GAMMA_B[5] < high
    assert any("steady gain is known" in line for line in accuracy_lines(table, model.axes))
    assert any(cell.endswith("!") for row in percent_rows(table, model.axes) for cell in row)


def test_the_observed_information_does_not_depend_on_the_step_where_the_score_is_smooth() -> None:
    estimate = one_flight().estimates["z"]

    small, large = (observed_covariance(estimate.records, estimate.optimum, step) for step in (0.2, 1.0))
    assert small is not None
    assert large is not None
    np.testing.assert_allclose(np.sqrt(np.diag(small)[:3] / np.diag(large)[:3]), 1.0, atol=0.05)


def test_the_sandwich_sees_a_wobble_that_the_expected_information_does_not() -> None:
    flight = flown(Truth(), steps(("x",), seed=4), 40.0, 4)
    rng, t = np.random.default_rng(4), flight.pose_time
    envelope = np.interp(t, np.arange(0.0, 42.0), np.maximum(rng.standard_normal(42), 0.0))
    moved = flight.position.copy()
    moved[:, 0] += 0.002 * envelope * np.sin(2 * np.pi * 2.5 * t)
    clean, shaken = (estimate_axis([f], "x", True) for f in (flight, replace(flight, position=moved)))

    def ratio(index: int, estimate) -> float:  # type: ignore[no-untyped-def]
        information, free = estimate.optimum.score.information, estimate.optimum.free
        expected = np.linalg.inv(information[np.ix_(free, free)])[index, index]
        return float(np.sqrt(sandwich_covariance(estimate.records, estimate.optimum)[index, index] / expected))

    assert ratio(0, shaken) > 1.1 * ratio(0, clean)


def test_a_coefficient_at_a_bound_has_no_standard_error_there() -> None:
    growing = Truth(gamma=(*GAMMA_B[:5], -0.1, *GAMMA_B[6:]))  # the search keeps the damping positive

    model = with_uncertainty(fit_as_flown([flown(growing, steps(("z",), seed=4), 20.0, 4)], ("z",)), flights=3).model
    table = model.uncertainty
    assert table is not None

    known = table.axes["z"].coefficients
    assert known["damping"].value == pytest.approx(0.001)
    assert known["damping"].observed is None
    assert known["damping"].bootstrap is None
    assert known["input"].observed is not None
    assert known["input"].ragged  # the damping was held
    assert [row[3].strip() for row in error_rows(table)][1] == "-"
    assert any("damping ended at a bound" in line for line in accuracy_lines(table, model.axes))
    assert [row[2].strip() for row in percent_rows(table, model.axes)][1] == "(0.001)"


def test_the_table_says_which_law_it_is_of_and_has_its_further_parameters() -> None:
    model = with_uncertainty(
        fit([flown(Truth(), steps(("z",), seed=4), 20.0, 4)], axes=("z",), structure="first_order_delay_lag"), flights=2
    ).model
    table = model.uncertainty
    assert table is not None

    assert list(table.axes["z"].coefficients) == [*COEFFICIENTS, "lag"]
    assert table.axes["z"].correlation[3][2] < -0.9  # this vehicle has no lag
    assert any("delay and lag move together" in line for line in accuracy_lines(table, model.axes))
    assert [len(row) for row in percent_rows(table, model.axes)] == [8] * 4
    assert "z first_order_delay_lag" in next(accuracy_lines(table, model.axes))


# Flight to flight


def test_flights_of_one_vehicle_agree_and_nothing_is_said() -> None:
    spread = scatter(alike().estimates["z"], [0, 1, 2])
    assert spread is not None

    assert spread.p_value > 0.01
    assert spread.freedom == 6
    assert len(spread.flights) == 3
    assert max(spread.factor.values()) < 2.5
    assert list(disagreement_findings(alike())) == []


def test_the_weighted_mean_of_the_flights_is_what_they_give_together() -> None:
    spread = scatter(alike().estimates["z"], [0, 1, 2])
    assert spread is not None

    together = alike().model.axes["z"]
    for name in COEFFICIENTS:
        error = together.stderr[name]
        assert error is not None
        assert abs(spread.mean[name] - getattr(together, name)) < 0.5 * error


def test_flights_of_two_vehicles_disagree_in_the_coefficient_that_differs() -> None:
    (told,) = disagreement_findings(unlike())
    spread = scatter(unlike().estimates["z"], [0, 1])
    assert spread is not None

    assert told.code == "flights_disagree"
    assert told.axis == "z"
    assert "on the next one" in told.effect
    assert spread.factor["input"] > 3
    assert spread.i_squared["input"] > 0.9
    first, second = (one.value["input"] for one in spread.flights)
    assert second / first == pytest.approx(1.3, rel=0.1)


def test_the_scatter_knows_combinations_that_it_does_not_know_the_parts_of() -> None:
    spread = scatter(unlike().estimates["z"], [0, 1])
    assert spread is not None

    first, second = (one.value["steady_gain"] for one in spread.flights)
    assert second / first == pytest.approx(1.3, rel=0.05)
    assert spread.cochran["steady_gain"] == pytest.approx(
        (second - first) ** 2 / sum(one.stderr["steady_gain"] ** 2 for one in spread.flights)
    )


def test_the_scatter_factor_of_one_coefficient_is_birges() -> None:
    """Two flights that differ in one well known coefficient: sqrt(Q / (flights - 1))."""
    spread = scatter(unlike().estimates["z"], [0, 1])
    assert spread is not None

    assert spread.factor["input"] == pytest.approx(np.sqrt(spread.cochran["input"]), rel=0.5)


def test_one_flight_has_no_scatter() -> None:
    assert scatter(one_flight().estimates["z"], [0]) is None


# Model file and command line


def test_the_table_survives_the_model_file() -> None:
    table = with_uncertainty(unlike(), flights=5).model
    assert table.uncertainty is not None

    raw = json.loads(json.dumps(to_mapping(table), allow_nan=False))
    assert asdict(from_mapping(raw, "here").uncertainty) == asdict(table.uncertainty)  # type: ignore[arg-type]
    assert structured(raw["uncertainty"], Uncertainty).axes["z"].scatter is not None


def test_without_being_asked_for_there_is_no_table_and_the_papers_method_has_none() -> None:
    assert to_mapping(alike().model)["uncertainty"] is None
    older = {k: v for k, v in to_mapping(alike().model).items() if k != "uncertainty"}
    assert from_mapping(older, "here").uncertainty is None
    assert with_uncertainty(fit(list(alike().flights), "paper")).model.uncertainty is None


def test_axes_without_numbers_are_not_in_the_table_and_every_row_is_full() -> None:
    table = one_flight().model.uncertainty
    assert table is not None

    assert list(table.axes) == ["z"]
    assert [len(row) for row in percent_rows(table, one_flight().model.axes)] == [8, 8, 8]
    assert [len(row) for row in error_rows(table)] == [7, 7, 7]


def test_two_vehicles_in_one_fit_are_told_on_the_command_line_with_the_table(tmp_path: Path) -> None:
    for number, gain in enumerate((GAMMA_B[4], 1.3 * GAMMA_B[4])):
        truth = Truth(gamma=(*GAMMA_B[:4], gain, *GAMMA_B[5:]))
        commands = steps(("z",), seed=30 + number)
        write_bag(simulate_flight(truth, commands, 25.0, 30 + number), tmp_path / f"{number}.bag")

    logs, model = [str(tmp_path / f"{number}.bag") for number in range(2)], str(tmp_path / "m.json")
    result = CliRunner().invoke(
        main, ["fit", *logs, "--axes", "z", "--structure", "first_order_delay", "--uncertainty", "-o", model]
    )
    assert result.exit_code == 0, result.output
    assert "warning flights_disagree: the 2 flights that determine z differ" in result.output
    assert "insens. %" in result.output
    assert "bootstrap: 200 flights drawn in blocks of 2 s, seed 0" in result.output
    stored = json.loads((tmp_path / "m.json").read_text())
    assert stored["uncertainty"]["axes"]["z"]["coefficients"]["input"]["scatter"] > 0
    assert "flights_disagree" in {finding["code"] for finding in stored["findings"]}
