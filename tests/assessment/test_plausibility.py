"""Findings of limits, symmetry and published sets: each from the command line, and silence where all is well."""

import json
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from flights import CARD, steps
from models import VEHICLE, demo_card, model_of, without
from rotorfit.app.cli import main
from rotorfit.assessment.plausibility import DAMPING_SYMMETRY, GAIN_SYMMETRY, LIMIT_MARGIN, findings_of_settings
from rotorfit.core.finding import Finding
from rotorfit.core.frames import AXES
from rotorfit.core.model import Model
from rotorfit.reporting.reproduce import card_text
from rotorfit.simulation.paper_vehicle import Truth, simulate_flight, write_bag
from rotorfit.simulation.published import PUBLISHED

CODES = {
    "gain_contradicts_limit",
    "final_speed_above_command",
    "final_speed_below_command",
    "axes_differ",
    "published_sets_disagree",
}


def found(model: Model) -> dict[tuple[str, str | None], Finding]:
    return {(finding.code, finding.axis): finding for finding in findings_of_settings(model)}


# From the command line


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A clean flight of the demo's vehicle that moves x, y and z."""
    path = tmp_path_factory.mktemp("flights") / "clean.bag"
    write_bag(simulate_flight(Truth(), steps(("x", "y", "z"), (0.2, 0.2, 0.4, 0.0), seed=3), 40.0, 3), path)
    return path


def fitted(bag: Path, raw: dict) -> dict[tuple[str, str | None], str]:
    """Code and axis to the evidence of the findings that `fit` prints with a card."""
    card = bag.parent / "card.toml"
    card.write_text(card_text(raw))
    result = CliRunner().invoke(main, ["fit", str(bag), "--card", str(card), "--axes", "x,y,z", "--json"])
    assert result.exit_code == 0, result.output
    return {(f["code"], f["axis"]): f["evidence"] for f in json.loads(result.stdout)["findings"] if f["code"] in CODES}


def test_on_a_clean_flight_with_the_right_card_nothing_is_said(bag: Path) -> None:
    assert fitted(bag, dict(CARD.raw)) == {}


def test_wrong_limits_and_a_wrong_scale_are_told_from_a_log(bag: Path) -> None:
    raw = {**CARD.raw, "name": "Parrot Bebop 2, simulated"}
    raw["limits"] = tomllib.loads("tilt = { value = 10, unit = 'deg' }\nvertical_speed = 2.5")
    raw["command"] = {**CARD.raw["command"], "y": {**CARD.raw["command"]["y"], "scale": 0.5}}
    told = fitted(bag, raw)

    assert set(told) == {
        ("gain_contradicts_limit", "x"),
        ("gain_contradicts_limit", "y"),
        ("gain_contradicts_limit", "z"),
        ("axes_differ", None),
        ("published_sets_disagree", None),
    }
    assert "outside the published values for the Bebop 2: x gain 2.1" in told["published_sets_disagree", None]
    assert "as if the tilt limit were 20." in told["gain_contradicts_limit", "x"]
    assert "and not 10 deg" in told["gain_contradicts_limit", "x"]
    assert "as if the vertical speed limit were 1.1" in told["gain_contradicts_limit", "z"]
    assert "input gains 3.6" in told["axes_differ", None] or "input gains 3.7" in told["axes_differ", None]


def test_of_recorded_flights_under_known_limits_the_climb_agrees_and_the_tilt_shows_its_lag(real_flights: Path) -> None:
    told = {}
    for name, axis in (("vert", "z"), ("pitch", "x")):
        log = real_flights / "bebop2-optitrack" / f"monster_{name}_trn.bag"
        result = json.loads(CliRunner().invoke(main, ["fit", str(log), "--axes", axis, "--json"]).stdout)
        told[name] = {finding["code"] for finding in result["findings"]}
        if name == "vert":
            low, high = result["physics"]["z"]["steady_speed"]["ratio"]["ci95"]
            assert low < 1 < high

    assert "gain_contradicts_limit" not in told["vert"]
    assert "gravity_supports_lag" in told["pitch"]


# Limits


def test_the_whole_interval_must_lie_outside_the_margin() -> None:
    g, b, tau = VEHICLE["x"]
    expected = 9.81 * np.tan(np.radians(20))
    for ratio, error, speaks in ((1.3, 0.02, True), (1.3, 0.06, False), (0.75, 0.02, True), (1.1, 0.001, False)):
        told = found(model_of({"x": (ratio * expected, b, tau)}, error=error))
        assert (("gain_contradicts_limit", "x") in told) == speaks, (ratio, error)
    assert not found(model_of({"x": (g, b, tau)}))


def test_where_a_tilt_does_too_little_the_lag_of_the_attitude_loop_is_named_as_a_cause() -> None:
    _, b, tau = VEHICLE["x"]
    low, high = (found(model_of({"x": (g, b, tau)}))["gain_contradicts_limit", "x"] for g in (2.0, 6.0))

    assert "a structure with a lag" in low.remedy
    assert "lag" not in high.remedy


def test_a_flipped_sign_or_an_open_interval_is_no_matter_of_limits() -> None:
    g, b, tau = VEHICLE["x"]

    assert not found(model_of({"x": (-2 * g, b, tau)}))
    assert not found(without(model_of({"x": (2 * g, b, tau)}), "x", "input"))


def test_of_commands_in_si_the_scale_is_told_and_for_a_tilt_the_limit_that_it_would_be() -> None:
    card = demo_card("", x="{ from = 'a', meaning = 'tilt' }", z="{ from = 'b', unit = 'm/s' }")
    told = found(model_of({"x": (7.0, 0.2, 0.1), "z": (4.0, 2.0, 0.1)}, card))

    assert "7 m/s^2 per rad" in told["gain_contradicts_limit", "x"].evidence
    assert "as if the command were 0.71 times what was logged, or a fraction of a tilt limit of 35.5 deg" in (
        told["gain_contradicts_limit", "x"].evidence
    )
    assert "as if the command were 2.00 times what was logged" in told["gain_contradicts_limit", "z"].evidence
    assert "tilt" not in told["gain_contradicts_limit", "z"].evidence


def test_no_velocity_loop_ends_above_what_is_commanded() -> None:
    card = demo_card("", x="{ from = 'a', meaning = 'tilt' }", z="{ from = 'b', unit = 'm/s' }")
    for ratio, speaks in ((1.1, True), (0.9, False), (1.0, False), (1.5, False)):
        told = found(model_of({"x": (1.1 * 9.81, 1.0, 0.1), "z": (2 * ratio, 2.0, 0.1)}, card, error=0.01))
        assert (("final_speed_above_command", "z") in told) == speaks, ratio
        assert (("final_speed_below_command", "z") in told) == (ratio == 0.9), ratio
        assert ("final_speed_above_command", "x") not in told
    assert not found(model_of({"z": (2.2, 2.0, 0.1)}, card, error=0.2))


def test_without_limits_nothing_contradicts_them() -> None:
    g, b, tau = VEHICLE["x"]

    assert not found(model_of({"x": (3 * g, b, tau)}, demo_card("")))


# Symmetry


def pair(gains: tuple[float, float], dampings: tuple[float, float], error: float = 0.02) -> Model:
    points = {axis: (g, b, 0.15) for axis, g, b in zip("xy", gains, dampings, strict=True)}
    return model_of(points, demo_card(""), error)


def test_x_and_y_may_differ_by_noise_and_by_what_a_body_explains_but_not_by_more() -> None:
    big = 1.3 * GAIN_SYMMETRY
    for model, speaks in (
        (pair((3.0, 3.0), (0.3, 0.3)), False),
        (pair((3.0 * big, 3.0), (0.3, 0.3)), True),
        (pair((3.0, 3.0 * big), (0.3, 0.3)), True),
        (pair((3.0 * big, 3.0), (0.3, 0.3), error=0.2), False),
        (pair((3.0, 3.0), (0.3, 0.3 * 2.1)), False),
        (pair((3.0, 3.0), (0.3, 0.3 * 1.3 * DAMPING_SYMMETRY)), True),
    ):
        assert (("axes_differ", None) in found(model)) == speaks


def test_the_covariance_of_x_and_y_is_part_of_the_test() -> None:
    """Errors that x and y share do not hide a difference: with correlation 0.98 the ratio is sharp."""
    model = pair((3.0 * 1.3, 3.0), (0.3, 0.3), error=0.08)
    shared = model.covariance.copy()
    i, j = (model.covariance_names.index(f"{axis}.input") for axis in "xy")
    shared[i, j] = shared[j, i] = 0.98 * np.sqrt(shared[i, i] * shared[j, j])

    assert ("axes_differ", None) not in found(model)
    assert ("axes_differ", None) in found(replace(model, covariance=shared))


def test_gains_of_commanded_speeds_and_channels_of_two_meanings_are_not_compared() -> None:
    points = {"x": (6.0, 0.3, 0.15), "y": (3.0, 0.3, 0.15)}
    speeds = demo_card("", x="{ from = 'a', unit = 'm/s' }", y="{ from = 'b', unit = 'm/s' }")
    mixed = demo_card("", x="{ from = 'a', unit = 'm/s' }")

    assert ("axes_differ", None) not in found(model_of(points, speeds))
    assert ("axes_differ", None) not in found(model_of(points, mixed))
    assert ("axes_differ", None) in found(model_of(points, demo_card("")))


def test_an_axis_without_a_number_is_not_compared() -> None:
    model = pair((6.0, 3.0), (0.3, 0.3))

    assert ("axes_differ", None) not in found(without(model, "x", "input"))
    assert ("axes_differ", None) not in found(replace(model, axes={**model.axes, "x": model_of({}).axes["x"]}))


# Published sets


def test_what_lies_within_the_published_sets_is_not_told_and_what_lies_outside_is_in_one_sentence() -> None:
    for known in PUBLISHED:
        if known.name not in ("A", "B", "E"):
            continue
        points = {axis: (known.gamma[2 * k] or 0.0, known.gamma[2 * k + 1] or 0.0, 0.15) for k, axis in enumerate(AXES)}
        assert ("published_sets_disagree", None) not in found(model_of(points, demo_card("", "Bebop 2")))

    told = found(model_of({"x": (3.7, 0.2, 0.15), "z": (2.5, 8.0, 0.1)}, demo_card("", "Bebop 2")))
    assert told["published_sets_disagree", None].evidence == (
        "outside the published values for the Bebop 2: z damping 8 1/s (published: 1.79 to 4)"
    )


def test_gains_are_compared_where_the_limits_allow_a_conversion() -> None:
    points = {"x": (2 * 9.81 * np.tan(np.radians(20)), 0.2, 0.15)}
    limited, free = (found(model_of(points, demo_card(limits, "Bebop 2"))) for limits in (None, ""))

    assert "x gain 2 times what the card leads one to expect (published: 0.558 to 1)" in (
        limited["published_sets_disagree", None].evidence
    )
    assert ("published_sets_disagree", None) not in free


def test_a_vehicle_with_one_published_set_is_compared_with_that() -> None:
    (known,) = (known for known in PUBLISHED if known.vehicle == "AR.Drone 2")
    g, b = known.gamma[4:6]
    assert g is not None
    assert b is not None
    card = demo_card("", "Parrot AR.Drone 2")

    assert ("published_sets_disagree", None) not in found(model_of({"z": (g, 1.1 * b, 0.1)}, card))
    told = found(model_of({"z": (g, 1.5 * b, 0.1)}, card))["published_sets_disagree", None].evidence
    assert "z damping 3.86 1/s (published: 2.58)" in told


def test_of_an_unknown_vehicle_or_a_model_without_numbers_nothing_is_said() -> None:
    assert ("published_sets_disagree", None) not in found(model_of())
    assert not found(model_of({}, demo_card("", "Bebop 2")))


# All of them


def test_every_finding_is_whole_sentences_in_one_line_each_and_its_margins_are_ratios() -> None:
    model = pair((9.0, 3.0), (0.1, 0.6))
    card = demo_card("tilt = { value = 10, unit = 'deg' }", "Bebop 2")
    above = model_of({"z": (2.2, 2.0, 0.1)}, demo_card("", z="{ from = 'b', unit = 'm/s' }"), error=0.01)
    below = model_of({"z": (1.8, 2.0, 0.1)}, above.card, error=0.01)
    models = (replace(model, card=card), above, below)
    told = [finding for one in models for finding in findings_of_settings(one)]

    assert {finding.code for finding in told} == CODES
    for finding in told:
        for text in (finding.evidence, finding.effect, finding.remedy):
            assert text
            assert not any(word in text for word in ("\n", "nan", "None", "inf "))
    assert min(LIMIT_MARGIN, GAIN_SYMMETRY, DAMPING_SYMMETRY) > 1
