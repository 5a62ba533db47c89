"""Priors from cards: read and checked, added as a Gaussian term, never in silence."""

import json
import tomllib
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from flights import CARD, flown, steps
from rotorfit.app.cli import main
from rotorfit.assessment.prior_influence import prior_findings, with_influence
from rotorfit.assessment.uncertainty import with_uncertainty
from rotorfit.core.card import Prior
from rotorfit.core.errors import CardError
from rotorfit.core.flight_data import Flight
from rotorfit.core.model import COEFFICIENTS
from rotorfit.core.results import Fit
from rotorfit.estimation.fitting import fit
from rotorfit.estimation.likelihood.axis_estimate import free_of
from rotorfit.estimation.likelihood.blocks import record
from rotorfit.estimation.likelihood.fisher_scoring import maximise
from rotorfit.estimation.likelihood.likelihood import restriction, score
from rotorfit.estimation.likelihood.optima import start_point
from rotorfit.estimation.likelihood.prior import gaussian_prior, with_prior
from rotorfit.files.cards import card_from_mapping
from rotorfit.files.models import from_mapping, to_mapping
from rotorfit.reporting.reproduce import card_text
from rotorfit.simulation.paper_vehicle import GAMMA_B, Truth, simulate_flight, write_bag

GAIN = GAMMA_B[4]


def believing(flight: Flight, prior: dict) -> Flight:
    return replace(flight, card=card_from_mapping({**flight.card.raw, "prior": prior}, "test"))


@cache
def short() -> Flight:
    return flown(Truth(), steps(("z",), seed=6), 15.0, 6)


@cache
def alone() -> Fit:
    return fit([short()], axes=("z",), structure="first_order_delay")


def believed(**coefficients: dict) -> Fit:
    return with_influence(
        fit([believing(short(), {"z": coefficients})], axes=("z",), prior=True, structure="first_order_delay")
    )


# The card


@pytest.mark.parametrize(
    ("prior", "told"),
    [
        ({"w": {}}, "unknown key 'w'"),
        ({"x": {"inputs": {"mean": 4.0, "sd": 0.5}}}, "unknown key 'inputs'; nearest: 'input'"),
        ({"x": {"input": {"mean": 4.0, "std": 0.5}}}, "unknown key 'std'; nearest: 'sd'"),
        ({"x": {"input": {"mean": 4.0}}}, "key 'sd' is missing"),
        ({"x": {"input": {"mean": 4.0, "sd": 0.0}}}, "must be positive"),
        ({"x": {"damping": {"mean": -0.2, "sd": 0.1}}}, "must be positive"),
        ({"x": {"input": 4.0}}, "must be { mean = ..., sd = ... }"),
        ({"x": 4.0}, "must be coefficients"),
    ],
)
def test_a_prior_that_cannot_be_is_refused_with_its_place(prior: dict, told: str) -> None:
    with pytest.raises(CardError) as refused:
        card_from_mapping({**CARD.raw, "prior": prior}, "mine")
    assert told in str(refused.value)
    assert "[prior]" in str(refused.value)


def test_a_prior_is_read_from_toml_in_the_dotted_form() -> None:
    section = tomllib.loads("[prior]\nx.input = { mean = 4.0, sd = 0.5 }\nx.delay = { mean = 0.2, sd = 0.05 }")
    card = card_from_mapping({**CARD.raw, **section}, "mine")

    assert card.prior == {"x": {"input": Prior(4.0, 0.5), "delay": Prior(0.2, 0.05)}}
    assert tomllib.loads(card_text(card.raw))["prior"] == section["prior"]


# The term


def test_the_term_is_the_gaussians_and_its_slope_the_gradients() -> None:
    rec = record(short(), ("z",))
    assert rec is not None
    prior = gaussian_prior({"z": {"damping": Prior(2.0, 0.5), "delay": Prior(0.1, 0.02)}}, ["z"])
    assert prior is not None
    point = start_point([rec], 0.15, 1.0, np.log([[0.1, 1e-7, 2.5, 0.64]]))
    restricted = restriction([rec], point, free_of([rec], [True]))

    def at(step: np.ndarray) -> float:
        moved = point.with_flat(point.flat() + step)
        return with_prior(score([rec], moved, restricted), moved, prior).objective

    plain, both = score([rec], point, restricted), with_prior(score([rec], point, restricted), point, prior)
    expected = -0.5 * ((np.log(1.0 / 2.0) / 0.25) ** 2 + (0.05 / 0.02) ** 2)
    assert both.objective - plain.objective == pytest.approx(expected)
    assert both.log_likelihood == plain.log_likelihood
    for i in (1, 2):
        step = np.zeros(point.flat().size)
        step[i] = 1e-5
        slope = (at(step) - at(-step)) / 2e-5
        assert slope == pytest.approx(both.gradient[i], rel=1e-3)


def test_of_what_the_card_does_not_speak_there_is_no_term() -> None:
    assert gaussian_prior({"x": {"input": Prior(4.0, 0.5)}}, ["z"]) is None
    both = gaussian_prior({"x": {"input": Prior(4.0, 0.5)}}, ["x", "y"])
    assert both is not None
    assert both.precision.tolist() == [4.0, 0, 0, 0, 0, 0]


# The fit


def test_a_vague_prior_changes_nothing_and_a_sharp_one_is_the_answer() -> None:
    plain = alone().model.axes["z"]
    vague = believed(input={"mean": GAIN, "sd": 100.0}).model
    sharp = believed(input={"mean": GAIN, "sd": 1e-4}).model

    assert vague.axes["z"].input == pytest.approx(plain.input, rel=1e-3)
    assert sharp.axes["z"].input == pytest.approx(GAIN, abs=1e-3)
    assert vague.prior is not None
    assert sharp.prior is not None
    assert vague.prior["z.input"].share < 1e-4
    assert sharp.prior["z.input"].share > 0.99


def test_prior_and_flight_are_weighted_by_their_information() -> None:
    plain = alone().model.axes["z"]
    early, late = plain.ci95_flight["delay"]
    assert early is not None
    assert late is not None
    error = (late - early) / (2 * 1.96)
    assert plain.delay is not None
    result = believed(delay={"mean": plain.delay + error, "sd": error}).model

    assert result.axes["z"].delay == pytest.approx(plain.delay + 0.5 * error, abs=0.1 * error)
    assert result.prior is not None
    use = result.prior["z.delay"]
    assert use.moved == pytest.approx(0.5, abs=0.1)
    assert use.share == pytest.approx(0.5, abs=0.1)
    assert use.conflict == pytest.approx(np.sqrt(0.5), abs=0.1)
    low, high = result.axes["z"].ci95_flight["delay"]
    assert (high - low) / (late - early) == pytest.approx(1 / np.sqrt(2), rel=0.15)  # type: ignore[operator]


def test_a_prior_is_always_told_and_a_conflict_is_a_warning() -> None:
    agreeing = list(prior_findings(believed(input={"mean": GAIN, "sd": 0.3})))
    torn = list(prior_findings(believed(input={"mean": 2 * GAIN, "sd": 0.05})))

    assert [(f.code, f.severity) for f in agreeing] == [("prior_used", "info")]
    assert [(f.code, f.severity) for f in torn] == [("prior_used", "info"), ("prior_conflict", "warning")]
    assert "combined standard errors apart" in torn[1].evidence


def test_what_the_card_moved_under_the_default_laws_does_not_hold_what_their_own_prior_of_the_lag_did() -> None:
    gusty = flown(replace(Truth(), wind_sigma=(1.0,) * 4), steps(("z",), seed=1), 20.0, 1)
    believing_flight = believing(gusty, {"z": {"delay": {"mean": 0.15, "sd": 0.05}}})
    model = with_influence(fit([believing_flight], axes=("z",), prior=True)).model

    assert "lag" in model.axes["z"].extra
    assert model.prior is not None
    use = model.prior["z.delay"]
    assert use.share < 0.05
    assert abs(use.moved) < 0.1


def test_a_prior_that_is_not_asked_for_is_not_used() -> None:
    result = fit(
        [believing(short(), {"z": {"input": {"mean": 9.0, "sd": 0.01}}})], axes=("z",), structure="first_order_delay"
    )

    assert result.model.prior is None
    for name in COEFFICIENTS:
        assert getattr(result.model.axes["z"], name) == getattr(alone().model.axes["z"], name)


def test_priors_of_x_and_y_of_a_vehicle_that_turns_go_to_their_own_axes() -> None:
    flight = flown(Truth(), steps(("x", "y", "yaw"), seed=1), 20.0, 1)
    prior = {"x": {"delay": {"mean": 0.2, "sd": 1e-5}}, "y": {"input": {"mean": 5.0, "sd": 1e-4}}}

    axes = fit([believing(flight, prior)], axes=("x", "y"), prior=True).model.axes
    assert axes["x"].predictor is not None
    assert axes["y"].predictor is not None
    assert axes["x"].predictor.delay == pytest.approx(0.2, abs=1e-3)
    assert axes["y"].predictor.input == pytest.approx(5.0, abs=0.01)
    assert axes["x"].predictor.input < 4.5


def test_without_a_prior_section_or_by_the_papers_method_there_is_one_line() -> None:
    with pytest.raises(CardError, match=r"no \[prior\]"):
        fit([short()], prior=True)
    with pytest.raises(CardError, match="takes no prior"):
        fit([believing(short(), {"z": {"input": {"mean": 3.0, "sd": 1.0}}})], "paper", prior=True)


def test_a_climb_with_a_prior_hands_it_on() -> None:
    rec = record(short(), ("z",))
    assert rec is not None
    prior = gaussian_prior({"z": {"input": Prior(GAIN, 0.1)}}, ["z"])

    point = start_point([rec], 0.15, 2.0, np.log([[0.1, 1e-7, 2.5, 0.64]]))
    optimum = maximise([rec], point, free_of([rec], [True]), prior=prior)
    assert optimum.prior is prior
    assert optimum.gain < 1e-3


def test_the_five_standard_errors_hold_the_prior() -> None:
    table = with_uncertainty(believed(delay={"mean": 0.15, "sd": 1e-3}), flights=40).model.uncertainty
    assert table is not None

    known = table.axes["z"].coefficients["delay"]
    assert known.expected < 1.05e-3
    for error in (known.observed, known.sandwich, known.bootstrap):
        assert error == pytest.approx(known.expected, rel=0.4)


def test_from_the_command_line_the_prior_is_in_the_summary_the_findings_and_the_file(tmp_path: Path) -> None:
    write_bag(simulate_flight(Truth(), steps(("z",), seed=6), 15.0, 6), tmp_path / "a.bag")
    text = card_text({**CARD.raw, "prior": {"z": {"input": {"mean": 5.0, "sd": 0.02}}}})
    (tmp_path / "card.toml").write_text(text)

    words = ["fit", str(tmp_path / "a.bag"), "--card", str(tmp_path / "card.toml"), "--axes", "z", "--prior"]
    result = CliRunner().invoke(main, [*words, "-o", str(tmp_path / "m.json")])
    assert result.exit_code == 0, result.output
    assert "with the card's prior" in result.output
    assert "info prior_used" in result.output
    assert "warning prior_conflict" in result.output
    stored = json.loads((tmp_path / "m.json").read_text())
    assert set(stored["prior"]) == {"z.input"}
    assert from_mapping(stored, "m").prior is not None
    without = to_mapping(alone().model)
    assert without["prior"] is None
