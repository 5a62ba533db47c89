"""Convert: gains follow the limits, everything else stays, there and back is where it began."""

import json
import tomllib
from dataclasses import astuple, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result

from flights import steps
from models import VEHICLE, demo_card, model_of
from rotorfit.app.cli import main
from rotorfit.app.workflows import training_flights
from rotorfit.assessment.plausibility import findings_of_settings
from rotorfit.core.accuracy import PriorUse
from rotorfit.core.errors import CardError, ModelError
from rotorfit.core.frames import AXES
from rotorfit.core.limits import limits_from_text
from rotorfit.core.model import Combination, Model, Spread
from rotorfit.core.physics import physics
from rotorfit.dynamics.other_limits import convert, scaled
from rotorfit.dynamics.trajectory import simulate
from rotorfit.files.cards import card_from_mapping
from rotorfit.files.models import load, save, to_mapping
from rotorfit.planning.signals import two_sines
from rotorfit.reporting.reproduce import recipe_of
from rotorfit.simulation.paper_vehicle import Truth, simulate_flight, write_bag

OTHER = limits_from_text("tilt=35deg,vertical_speed=3,yaw_rate=40deg/s")
BACK = limits_from_text("tilt=20deg,vertical_speed=1.2m/s,yaw_rate=100deg/s")
FACTORS = {
    "x": float(np.tan(np.radians(35)) / np.tan(np.radians(20))),
    "y": float(np.tan(np.radians(35)) / np.tan(np.radians(20))),
    "z": 2.5,
    "yaw": 0.4,
}


def numbers(value: Any) -> list[float]:
    """All numbers of a file, in order."""
    if isinstance(value, dict):
        return [number for part in value.values() for number in numbers(part)]
    if isinstance(value, list):
        return [number for part in value for number in numbers(part)]
    return [float(value)] if isinstance(value, int | float) and not isinstance(value, bool) else []


def file_of(model: Model) -> dict[str, Any]:
    again: dict[str, Any] = json.loads(json.dumps(to_mapping(model), allow_nan=False))
    return again


def test_gains_are_multiplied_and_what_is_the_vehicles_stays() -> None:
    model = model_of()
    other = convert(model, OTHER)

    for k, (name, factor) in enumerate(FACTORS.items()):
        old, new = model.axes[name], other.axes[name]
        assert new.input == pytest.approx(old.input and old.input * factor)
        assert new.stderr["input"] == pytest.approx((old.stderr["input"] or 0) * factor)
        assert new.ci95["input"] == pytest.approx([(end or 0) * factor for end in old.ci95["input"]])
        gain, before = new.combinations["steady_gain"], old.combinations["steady_gain"]
        assert gain.value == pytest.approx(before.value * factor)
        assert gain.ci95 == pytest.approx([(end or 0) * factor for end in before.ci95])
        assert new.modes[0].input == pytest.approx(old.modes[0].input * factor)
        assert new.predictor is not None
        assert new.predictor.input == pytest.approx(VEHICLE[name][0] * factor)
        assert (new.predictor.damping, new.predictor.delay) == VEHICLE[name][1:]
        assert new.combinations["total_lag"] == old.combinations["total_lag"]
        for part in ("damping", "delay"):
            assert getattr(new, part) == getattr(old, part)
            assert (new.stderr[part], new.ci95[part], new.status[part]) == (
                old.stderr[part], old.ci95[part], old.status[part],
            )  # fmt: skip
        assert (new.trim, new.noise, new.profile, new.status) == (old.trim, old.noise, old.profile, old.status)
        assert other.paper[2 * k] == pytest.approx((model.paper[2 * k] or 0) * factor)
        assert other.paper[2 * k + 1] == model.paper[2 * k + 1]
    assert other.flights == model.flights


def test_the_covariance_goes_with_the_gains_so_that_correlations_stay() -> None:
    model = model_of()
    other = convert(model, OTHER)

    def correlation(matrix: np.ndarray) -> np.ndarray:
        deviation = np.sqrt(np.diag(matrix))
        return np.asarray(matrix / np.outer(deviation, deviation))

    np.testing.assert_allclose(correlation(other.covariance), correlation(model.covariance), rtol=1e-13)
    place = model.covariance_names.index("yaw.input")
    assert np.sqrt(other.covariance[place, place]) == pytest.approx(other.axes["yaw"].stderr["input"])


def test_what_is_per_command_or_in_commands_goes_by_its_name_wherever_it_stands() -> None:
    model = model_of()
    axis = replace(model.axes["z"], combinations={"input_up": Combination(2.0, (1.0, None))})
    names = ("z.input", "z.dead_zone", "z.damping", "yaw.level")
    model = replace(model, axes={**model.axes, "z": axis}, covariance_names=names, covariance=np.ones((4, 4)))
    other = convert(model, OTHER)

    assert other.axes["z"].combinations["input_up"] == Combination(5.0, (2.5, None))
    scale = np.array([2.5, 1 / 2.5, 1.0, 1 / 0.4])
    np.testing.assert_allclose(other.covariance, np.outer(scale, scale))
    assert scaled({"status": {"input": "ok"}, "input": True}, 2.0) == {"status": {"input": "ok"}, "input": True}


def test_there_and_back_the_file_has_the_same_numbers_and_no_conversion() -> None:
    model = model_of()
    there = convert(model, OTHER)
    again = convert(there, BACK)

    assert numbers(file_of(there)) != numbers(file_of(model))
    assert numbers(file_of(again)) == pytest.approx(numbers(file_of(model)), rel=1e-13)
    assert again.conversion is None
    assert again.card.raw == model.card.raw
    assert again.findings == model.findings


def test_priors_go_with_the_gains_there_and_back_and_the_recipe_has_those_of_the_flights() -> None:
    given = {"z": {"input": {"mean": 2.4, "sd": 0.2}, "damping": {"mean": 2.0, "sd": 0.3}}}
    card = card_from_mapping({**model_of().card.raw, "prior": given}, "test")
    used = {"z.input": PriorUse(2.4, 0.2, 2.5, 0.3, 0.1, 0.5), "z.damping": PriorUse(2.0, 0.3, 2.1, 0.1, 0.1, 0.3)}
    model = replace(model_of(), card=card, prior=used)
    other = convert(model, OTHER)

    assert other.prior is not None
    assert astuple(other.prior["z.input"]) == pytest.approx((6.0, 0.5, 6.25, 0.3, 0.1, 0.5))
    assert other.prior["z.damping"] == used["z.damping"]
    assert astuple(other.card.prior["z"]["input"]) == pytest.approx((6.0, 0.5))
    assert other.card.prior["z"]["damping"] == card.prior["z"]["damping"]
    assert numbers(file_of(convert(other, BACK))) == pytest.approx(numbers(file_of(model)), rel=1e-13)
    recipe = tomllib.loads(recipe_of(other, ()).card)
    assert recipe["prior"]["z"]["input"] == pytest.approx(given["z"]["input"])


def test_what_each_flight_gave_is_scaled_with_the_spread_of_logarithms() -> None:
    spread = Spread("flights", 0.1, 0.1, 0.1, 2, 0.5, (1.0, 2.0), True, ((0.5, 0.1), None))

    other = scaled({"input": spread}, 2.0)["input"]

    assert other.each == ((pytest.approx(0.5 + np.log(2)), 0.1), None)
    assert (other.sd, other.next_flight) == (0.1, (2.0, 4.0))
    plain = scaled({"dead_zone": replace(spread, logarithmic=False)}, 2.0)["dead_zone"]
    assert (plain.sd, plain.flights, plain.p_value, plain.each) == (0.05, 2, 0.5, ((0.25, 0.05), None))


def test_two_conversions_are_one() -> None:
    direct = convert(model_of(), OTHER)
    by_way = convert(convert(model_of(), limits_from_text("tilt=5deg,yaw_rate=1")), OTHER)

    assert numbers(file_of(by_way)) == pytest.approx(numbers(file_of(direct)), rel=1e-13)
    assert by_way.conversion is not None
    assert dict(by_way.conversion.factor) == pytest.approx(FACTORS)


def test_commands_divided_by_the_factor_move_the_converted_model_the_same() -> None:
    model = model_of()
    other = convert(model, OTHER)
    at = np.arange(0.0, 20.0, 0.05)
    command = steps(seed=4)(at)
    time = np.arange(0.0, 20.0, 0.01)

    flown = simulate(model, at, command, time)
    scaled = simulate(other, at, command / np.array(list(FACTORS.values())), time)
    assert np.abs(flown.pose).max() > 1.0
    np.testing.assert_allclose(scaled.pose, flown.pose, atol=1e-11)
    np.testing.assert_allclose(scaled.velocity, flown.velocity, atol=1e-11)


def test_a_turning_motion_is_the_same_at_few_times_as_at_many() -> None:
    at, command = np.array([0.0, 1.0]), np.array([[0.2, 0.1, 0.2, 0.2], [-0.2, 0.0, 0.1, -0.3]])
    few, many = (simulate(model_of(), at, command, np.linspace(0.0, 3.0, n)) for n in (4, 3001))

    assert abs(many.pose[-1, 3]) > 0.1
    np.testing.assert_allclose(few.pose, many.pose[::1000], atol=1e-4)
    np.testing.assert_allclose(few.velocity, many.velocity[::1000], atol=1e-4)


def test_limits_that_are_not_named_stay_and_physics_keeps_its_ratios() -> None:
    model = model_of()
    other = convert(model, limits_from_text("tilt=10deg"))

    assert other.axes["z"] == model.axes["z"]
    assert other.card.raw["limits"]["vertical_speed"] == model.card.raw["limits"]["vertical_speed"]
    old, new = physics(model)["x"]["acceleration"], physics(other)["x"]["acceleration"]
    assert old.ratio is not None
    assert new.ratio is not None
    assert new.ratio.value == pytest.approx(old.ratio.value)
    assert new.expected == pytest.approx(9.81 * np.tan(np.radians(10)))
    assert [f.code for f in findings_of_settings(other)] == [f.code for f in findings_of_settings(model)]


def test_a_converted_model_says_from_what_and_its_recipe_leads_to_it() -> None:
    other = convert(model_of(), limits_from_text("tilt=10deg"))

    assert other.conversion is not None
    assert other.conversion.limits["tilt"] == {"value": 20, "unit": "deg"}
    (told,) = (finding for finding in other.findings if finding.code == "converted")
    assert "tilt 20 deg to 10 deg; gains times x 0.4845, y 0.4845" in told.evidence
    assert [f.code for f in convert(other, limits_from_text("yaw_rate=1")).findings] == ["converted"]
    recipe = recipe_of(other, ())
    assert recipe.commands[1] == "rotorfit convert fitted.json --limits tilt=0.174532925199433 -o model.json"
    assert "tilt = { value = 20" in recipe.card
    assert len(recipe_of(model_of(), ()).commands) == 1
    assert "other" not in training_flights(other)[1][0]
    assert "limits that they were not flown under" in training_flights(other)[1][0]


@pytest.mark.parametrize(
    ("limits", "model", "kind", "why"),
    [
        ("tilt=20deg", model_of(card=demo_card("")), ModelError, "does not say what tilt was set"),
        ("speed=3", model_of(), ModelError, "x is a fraction of tilt"),
        ("tilt=20deg", model_of(card=demo_card("", x="'a'", y="'b'")), ModelError, "give the channel a meaning"),
        ("tilt=20deg", model_of(card=demo_card(x="{ from = 'a', unit = 'rad' }", y="'b'")), ModelError, "in SI units"),
        ("tilt=20degg", model_of(), CardError, "nearest: 'deg'"),
        ("tilt=20m/s", model_of(), CardError, "is not one of rad, deg"),
        ("tilt=90deg", model_of(), CardError, "no tilt below 90 deg"),
        ("tilt=20", model_of(), CardError, "a number alone is rad"),
        ("yaw_rate=0", model_of(), CardError, "must be positive"),
        ("tild=20deg", model_of(), CardError, "nearest: 'tilt'"),
    ],
)
def test_what_cannot_be_converted_is_one_line_that_says_why(
    limits: str, model: Model, kind: type[Exception], why: str
) -> None:
    with pytest.raises(kind, match=why) as error:
        convert(model, limits_from_text(limits))
    assert "\n" not in str(error.value)


def test_a_conversion_to_no_limit_at_all_says_so() -> None:
    with pytest.raises(ModelError, match="no limit is named"):
        convert(model_of(), {})


# The command line


def run(*arguments: object) -> Result:
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


def test_the_verb_writes_the_other_model_and_prints_it(tmp_path: Path) -> None:
    save(model_of(), tmp_path / "model.json")
    line = ("convert", tmp_path / "model.json", "--limits", "tilt=10deg", "-o", tmp_path / "other.json")

    shown = run(*line)
    assert shown.exit_code == 0, shown.output
    assert "in physics" in shown.output
    assert "info converted" in shown.output
    told = run(*line, "--json")
    assert json.loads(told.stdout) == json.loads((tmp_path / "other.json").read_text())
    assert load(tmp_path / "other.json").gamma[0] == pytest.approx(VEHICLE["x"][0] * 0.48445, rel=1e-4)


def test_errors_of_the_verb_are_one_line_and_nothing_is_written(tmp_path: Path) -> None:
    save(model_of(), tmp_path / "model.json")
    for limits in ("tild=20deg", "tilt=95deg", "speed=2", "tilt=20degg"):
        result = run("convert", tmp_path / "model.json", "--limits", limits, "-o", tmp_path / "other.json", "--json")
        assert result.exit_code == 1
        assert result.stdout == ""
        assert len(result.stderr.splitlines()) == 1
        assert not (tmp_path / "other.json").exists()


def test_a_converted_model_predicts_a_flight_under_the_new_limits(tmp_path: Path) -> None:
    """The proof on other data: the same vehicle under half of the climb limit needs commands twice as large."""
    for name, gain, amplitude, seed in (("fast", 4.0, 2.0, 5), ("slow", 2.0, 4.0, 6)):
        truth = replace(Truth(), gamma=(*Truth().gamma[:4], gain, 2.0, *Truth().gamma[6:]))
        commands = partial(two_sines, axes=("z",), amplitude=amplitude)
        write_bag(simulate_flight(truth, commands, 30.0, seed), tmp_path / f"{name}.bag")
    fit = run(
        "fit", tmp_path / "fast.bag", "--axes", "z", "--structure", "first_order_delay", "-o", tmp_path / "fast.json"
    )
    assert fit.exit_code == 0, fit.output
    run("convert", tmp_path / "fast.json", "--limits", "vertical_speed=0.6", "-o", tmp_path / "slow.json")

    errors = []
    for name in ("fast", "slow"):
        found = json.loads(run("validate", tmp_path / f"{name}.json", tmp_path / "slow.bag", "--json").stdout)
        errors.append(found["flights"][0]["axes"]["z"]["horizons"]["1"]["velocity_rmse"])
    assert errors[1] < 0.2 * errors[0]


def test_all_axes_are_among_the_factors() -> None:
    other = convert(model_of(), OTHER)

    assert other.conversion is not None
    assert tuple(other.conversion.factor) == AXES
