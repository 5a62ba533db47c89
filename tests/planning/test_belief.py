"""What is believed of a vehicle before a flight, by card, model and published set, and its draws."""

from dataclasses import replace

import numpy as np
import pytest

from models import VEHICLE, model_of, with_poses
from rotorfit.core.card import Channel, Prior
from rotorfit.core.errors import PlanError
from rotorfit.core.finding import Finding
from rotorfit.core.model import COEFFICIENTS, Plain, weighed
from rotorfit.files.cards import card_from_mapping, load_card
from rotorfit.planning.belief import (
    DELAY,
    GAIN_SHARE,
    NAMES,
    Belief,
    belief_from_card,
    belief_from_mapping,
    belief_from_model,
    belief_mapping,
    coefficients_of,
    levels_of,
    sample_vehicles,
)
from rotorfit.planning.next_flight import errors_after
from rotorfit.simulation.paper_vehicle import GAMMA_B, Truth

CARD = load_card("rotorfit-demo")

ASSUMED = "120 poses a second are assumed: the model does not tell those of its flights"


def errors(belief: Belief) -> dict[str, float]:
    return dict(zip(NAMES, np.sqrt(np.diag(belief.covariance)), strict=True))


def test_a_full_tilt_is_believed_to_accelerate_by_g_tan_tilt_and_a_full_speed_to_be_reached() -> None:
    belief = belief_from_card(CARD)
    gamma = belief.truth.gamma
    assert gamma[0] == pytest.approx(9.81 * np.tan(np.radians(20)))
    assert gamma[4] / gamma[5] == pytest.approx(1.2)
    assert gamma[6] / gamma[7] == pytest.approx(np.radians(100))
    assert belief.truth.delay == (DELAY[0],) * 4
    assert errors(belief)["x.delay"] == pytest.approx(DELAY[1])


def test_the_speed_that_a_full_command_reaches_is_better_known_than_input_and_damping() -> None:
    belief = belief_from_card(CARD)
    gains = [truth.gamma[4] / truth.gamma[5] for truth in sample_vehicles(belief, 4000, 1)]
    assert np.std(gains) / np.mean(gains) == pytest.approx(GAIN_SHARE, rel=0.2)
    assert errors(belief)["z.input"] / belief.truth.gamma[4] > 1.5 * GAIN_SHARE


def test_a_prior_of_the_card_holds() -> None:
    card = replace(CARD, prior={"x": {"damping": Prior(0.3, 0.01)}})
    belief = belief_from_card(card)
    assert belief.truth.gamma[1] == 0.3
    assert errors(belief)["x.damping"] == pytest.approx(0.01)


@pytest.mark.parametrize(("name", "mean"), [("input", 0.0), ("damping", 0.0), ("delay", -0.05)])
def test_a_prior_by_which_nothing_can_be_planned_is_refused(name: str, mean: float) -> None:
    with pytest.raises(PlanError, match=r"\[prior\] x: no flight can be planned"):
        belief_from_card(replace(CARD, prior={"x": {name: Prior(mean, 0.1)}}))


def test_a_card_without_limits_of_a_known_vehicle_is_believed_to_be_like_its_published_sets() -> None:
    belief = belief_from_card(load_card("bebop2"))
    assert belief.truth.gamma[0] == pytest.approx(np.mean([4.33, 1.742, 3.6976, 4.5752, 0.8417]))
    assert errors(belief)["x.input"] > 1.0
    assert any("5 published sets" in note for note in belief.notes)


def test_a_card_that_does_not_say_what_a_command_reaches_is_told_what_to_give() -> None:
    raw = {**CARD.raw, "name": "a stranger", "limits": {"tilt": 0.3}}
    with pytest.raises(PlanError, match=r"what a command of 1 on z reaches; give \[limits\] vertical_speed, or plan"):
        belief_from_card(card_from_mapping(raw, "stranger"))


def test_of_a_command_that_the_card_calls_a_fraction_and_a_value_the_contradiction_is_said() -> None:
    x = Channel("u", meaning="velocity", full_scale="speed", unit="m/s")
    both = replace(CARD, name="stranger", command={**CARD.command, "x": x}, limits={**CARD.limits, "speed": 3.0})

    with pytest.raises(PlanError, match=r"contradicts itself on x: full_scale .* limit speed, unit a value in m/s; "):
        belief_from_card(both)
    for part in ("full_scale", "unit"):
        sound = replace(both, command={**CARD.command, "x": replace(x, **{part: None})})
        assert belief_from_card(sound).truth.gamma[0] > 0


def test_draws_have_the_mean_and_the_deviation_of_the_belief_and_keep_their_signs() -> None:
    belief = belief_from_card(CARD)
    table = np.array([coefficients_of(truth) for truth in sample_vehicles(belief, 20_000, 3)])
    np.testing.assert_allclose(table.mean(axis=0), belief.coefficients, rtol=0.02)
    np.testing.assert_allclose(table.std(axis=0), np.sqrt(np.diag(belief.covariance)), rtol=0.06)
    assert np.all(table > 0)
    trims = np.array([truth.trim for truth in sample_vehicles(belief, 5000, 3)])
    np.testing.assert_allclose(trims.std(axis=0), belief.trim_sigma, rtol=0.05)


def test_draws_of_a_negative_gain_mirror_those_of_a_positive_one() -> None:
    right = belief_from_model(model_of(), "m.json")
    g = [value * (-1 if place == 0 else 1) for place, value in enumerate(right.truth.gamma)]
    turned = right.covariance.copy()
    turned[0, 1:] *= -1
    turned[1:, 0] *= -1
    left = replace(right, truth=replace(right.truth, gamma=tuple(g)), covariance=turned)

    one, other = (
        np.array([coefficients_of(truth) for truth in sample_vehicles(belief, 4000, 3)]) for belief in (right, left)
    )
    assert abs(right.covariance[0, 1]) > 0
    assert np.std(other[:, 0] / other[:, 1]) == pytest.approx(np.std(one[:, 0] / one[:, 1]), rel=0.1)
    assert np.sign(np.cov(other[:, 0], other[:, 1])[0, 1]) == -np.sign(np.cov(one[:, 0], one[:, 1])[0, 1])


def test_a_delay_near_zero_keeps_its_uncertainty() -> None:
    belief = belief_from_model(model_of(), "m.json")
    none = replace(belief, truth=replace(belief.truth, delay=(0.0, 1e-4, *belief.truth.delay[2:])))

    drawn = np.array([truth.delay[:2] for truth in sample_vehicles(none, 4000, 3)])
    sd = np.sqrt(np.diag(belief.covariance))[[2, 5]]
    assert np.all(drawn >= 0)
    np.testing.assert_allclose(np.quantile(drawn, 0.975, axis=0), 1.96 * sd, rtol=0.1)


def test_a_model_is_believed_as_far_as_it_goes_and_the_card_beyond() -> None:
    belief = belief_from_model(model_of({axis: VEHICLE[axis] for axis in ("x", "y")}, CARD), "m.json")
    assert belief.truth.gamma[:4] == GAMMA_B[:4]
    assert belief.truth.delay[:2] == (0.1, pytest.approx(0.15))
    assert errors(belief)["x.input"] == pytest.approx(0.02 * GAMMA_B[0], rel=0.01)
    assert errors(belief)["z.delay"] == DELAY[1]
    assert belief.source == "model m.json"
    quiet = "noise and wind of z, yaw: those of a quiet motion-capture room (0.5 mm, 0.02 m/s^2)"
    assert belief.notes == (quiet, ASSUMED)


def test_a_richer_law_than_the_planned_one_is_told() -> None:
    model = model_of(VEHICLE, CARD)
    lagged = {axis: replace(model.axes[axis], structure="first_order_delay_lag") for axis in ("x", "z")}
    notes = belief_from_model(replace(model, axes={**model.axes, **lagged}), "m.json").notes

    assert notes[0].startswith("x, z: planned for the first-order law with a delay, not for first_order_delay_lag")
    assert notes[1:] == (ASSUMED,)


def test_poses_come_as_often_as_in_the_flights_of_the_model() -> None:
    belief = belief_from_model(with_poses(model_of(), (10.0, ("x", "y"))), "m.json")

    assert (belief.truth.pose_rate, belief.truth.stale_share) == (10.0, 0.0)
    assert "10 fresh poses a second, as in the model's flights" in belief.notes


def test_of_several_flights_the_one_with_the_fewest_poses_counts_if_it_tells_of_a_known_axis() -> None:
    model = with_poses(model_of({"x": VEHICLE["x"]}), (100.0, ("x",)), (30.0, ("x",)), (8.0, ("yaw",)))
    belief = belief_from_model(model, "m.json")

    assert belief.truth.pose_rate == 30.0
    assert "30 fresh poses a second, the fewest, 100 the most, of the model's flights" in belief.notes


def test_poses_faster_than_any_that_are_planned_with_survive_the_plain_form() -> None:
    belief = belief_from_model(with_poses(model_of(), (5000.0, ("x",))), "m.json")
    assert belief_from_mapping(belief_mapping(belief), "p").truth.pose_rate == belief.truth.pose_rate == 1000.0


def test_a_model_of_velocities_alone_does_not_tell_the_noise_of_positions() -> None:
    model = with_poses(model_of({"x": VEHICLE["x"]}, CARD), (50.0, ("x",)))
    noise = {"wind_power": 1e-3, "velocity_variance": 1e-4, "wind_damping": 1.0, "wind_overlap": 1.0}
    x = replace(model.axes["x"], noise={**noise, "trim_variance": 0.01})
    notes = belief_from_model(replace(model, axes={**model.axes, "x": x}), "m.json").notes

    assert any(note.startswith("x: the model's flights had a velocity and no position") for note in notes)
    assert notes[-1] == ASSUMED


def test_a_model_that_must_not_be_used_says_so_before_all_else() -> None:
    flipped = Finding("sign_flipped", "error", "y turns over", "no number of y", "mend the flight", "y")
    loud = Finding("few", "warning", "a", "b", "c", "y")
    notes = belief_from_model(replace(model_of(), findings=(loud, flipped)), "m.json").notes

    assert notes[0] == "this plan rests on numbers that must not be used: y turns over; mend the flight"
    assert not any("must not be used" in note for note in belief_from_model(model_of(), "m.json").notes)


def test_a_belief_from_a_card_says_how_many_poses_it_assumes() -> None:
    assert "120 poses a second are assumed" in belief_from_card(CARD).notes[-1]


def test_errors_of_several_laws_are_those_of_the_intervals() -> None:
    model = model_of(VEHICLE, CARD)
    x = model.axes["x"]
    assert x.predictor
    one = weighed("first_order_delay", x.predictor, ["input", "damping", "delay"], np.diag([0.05, 0.03, 0.004]) ** 2)
    ends = {"input": (5.0, 5.4), "damping": (None, 0.3), "delay": (0.114, 0.230)}
    unsure = replace(x, laws=(one, replace(one, structure="first_order_delay_lag")), ci95=ends)
    belief = belief_from_model(replace(model, axes={**model.axes, "x": unsure}), "m.json")

    assert errors(belief)["x.input"] == pytest.approx(0.2 / 1.96, rel=1e-4)
    assert errors(belief)["x.delay"] == pytest.approx(0.058 / 1.96, rel=1e-4)
    assert errors(belief)["x.damping"] == pytest.approx(0.7 * x.predictor.damping)
    assert errors(belief)["y.delay"] == errors(belief_from_model(model, "m.json"))["y.delay"]
    assert "x: the model does not decide between laws" in belief.notes[0]

    now, own = np.sqrt(np.diag(belief.covariance)), np.array([x.stderr[name] for name in COEFFICIENTS])
    np.testing.assert_allclose(belief.widening[:3], now[:3] / own)
    np.testing.assert_array_equal(belief.widening[3:], 1.0)
    under_one_law = np.linalg.inv(belief.covariance / np.outer(belief.widening, belief.widening))
    after = errors_after(under_one_law[None], belief)
    np.testing.assert_allclose(after, now / np.sqrt(2))  # as much more data narrow the intervals as those under one law


def test_errors_of_a_richer_law_are_those_of_its_intervals_not_of_the_law_stored_beside_it() -> None:
    model = model_of(VEHICLE, CARD)
    x = model.axes["x"]
    assert x.predictor
    half = replace(x.predictor, input=0.5 * x.predictor.input)
    beside = weighed("first_order_delay", half, ["input", "damping", "delay"], np.diag([0.05, 0.01, 0.002]) ** 2)
    ends = {"input": (4.5, 6.0), "damping": (0.2, 0.3), "delay": (0.114, 0.230)}
    plain = Plain(x.input, x.damping, x.delay, beside.stderr, {}, x.status, beside)
    lagged = replace(x, structure="first_order_delay_lag", plain=plain, ci95=ends)
    belief = belief_from_model(replace(model, axes={**model.axes, "x": lagged}), "m.json")

    for name, (low, high) in ends.items():
        planned = 0.5 if name == "input" else 1.0  # as wide in proportion
        assert errors(belief)[f"x.{name}"] == pytest.approx(planned * (high - low) / 2 / 1.96, rel=1e-4)


def test_of_what_a_model_knows_no_note_of_its_card_is_left() -> None:
    bare = load_card("bebop2")  # without limits: on its own it is believed to be like the published sets
    unlimited = replace(bare, name="a drone that nobody has published", raw={})

    assert len(belief_from_card(bare).notes) > 1
    assert belief_from_model(model_of(VEHICLE, bare), "m.json").notes == (ASSUMED,)
    assert belief_from_model(model_of(VEHICLE, unlimited), "m.json").notes == (ASSUMED,)
    half = belief_from_model(model_of({axis: VEHICLE[axis] for axis in ("x", "y")}, unlimited), "m.json")
    assert [note.split(":")[0] for note in half.notes[-2:-1]] == ["noise and wind of z, yaw"]
    assert all("of 1 on x " not in note and "of 1 on y " not in note for note in half.notes)


def test_the_levels_of_a_model_are_kept_and_its_wind_is_their_own() -> None:
    truth = Truth(gamma=GAMMA_B, wind_sigma=(0.05,) * 4, wind_time=(2.0,) * 4)
    levels = levels_of(Belief(truth, np.zeros((12, 12)), (0.0,) * 4), truth, "x")
    model = model_of(VEHICLE, CARD)
    names = ("wind_power", "pose_variance", "wind_damping", "wind_overlap")
    noise = dict(zip(names, map(float, levels), strict=True)) | {"trim_variance": 0.01}
    axes = {**model.axes, "x": replace(model.axes["x"], noise=noise)}
    belief = belief_from_model(replace(model, axes=axes), "m.json")
    np.testing.assert_allclose(levels_of(belief, belief.truth, "x"), levels)
    assert belief.truth.wind_sigma[0] == pytest.approx(0.05)
    assert belief.truth.wind_time[0] == pytest.approx(2.0)
    assert belief.truth.mocap_noise[0] == pytest.approx(truth.mocap_noise[0])


@pytest.mark.parametrize("belief", [belief_from_card(CARD), belief_from_model(model_of(), "m")])
def test_a_belief_survives_its_plain_form_to_six_digits(belief: Belief) -> None:
    again = belief_from_mapping(belief_mapping(belief), "plan p")
    np.testing.assert_allclose(again.coefficients, belief.coefficients, rtol=1e-5)
    np.testing.assert_allclose(again.covariance, belief.covariance, rtol=1e-5, atol=1e-12)
    assert (again.source, again.notes, again.trim_sigma) == (belief.source, belief.notes, belief.trim_sigma)
    assert belief_mapping(again) == belief_mapping(belief)


def test_a_damaged_belief_is_told() -> None:
    raw = belief_mapping(belief_from_card(CARD))
    with pytest.raises(PlanError, match=r"plan p, \[belief\]: 'delay' is missing"):
        belief_from_mapping({name: value for name, value in raw.items() if name != "delay"}, "plan p")
    with pytest.raises(PlanError, match="one for each of x, y, z, yaw"):
        belief_from_mapping({**raw, "delay": [0.1]}, "plan p")
    with pytest.raises(PlanError, match="is unstable"):
        belief_from_mapping({**raw, "gamma": [1.0, -0.2] * 4}, "plan p")
