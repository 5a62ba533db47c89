"""As fast as what is known allows: poorer knowledge gives slower gains, and the promised margins hold."""

from dataclasses import replace

import numpy as np
import pytest
from test_robustness import dragged, limited, without_delays

from models import VEHICLE, demo_card, model_of, with_poses
from rotorfit.control.control_law import KINDS, Kind
from rotorfit.control.loop_vehicle import LaggedAxis
from rotorfit.control.margins import margins
from rotorfit.control.robustness import believed_possible
from rotorfit.control.tuning import DELAY_SHARE, PEAK, RESTLESS, tune
from rotorfit.core.errors import ModelError
from rotorfit.core.finding import Finding, Severity
from rotorfit.core.frames import AXES
from rotorfit.core.model import Combination, Evidence, Model, Plain, Source, first_order
from rotorfit.planning.axis_information import AxisBelief

pytestmark = pytest.mark.flights

DRAWN = 60
"""Vehicles that are drawn where a comparison of gains needs no more."""


@pytest.mark.parametrize("kind", KINDS)
def test_the_better_a_vehicle_is_known_the_faster_are_its_gains(kind: Kind) -> None:
    speed = [
        tune(model_of(error=error), kind, axes=("x",), draws=DRAWN).axes["x"].bandwidth for error in (0.01, 0.1, 0.2)
    ]

    assert speed[0] > speed[1] > speed[2] > 0.3 * speed[0]


def test_a_delay_that_is_not_known_costs_speed_and_is_said() -> None:
    known, unknown = (
        tune(model, axes=("x",), draws=DRAWN).axes["x"] for model in (model_of(), without_delays(model_of()))
    )

    assert unknown.bandwidth < 0.7 * known.bandwidth
    assert "delay is not known" in unknown.note
    assert known.note == ""


def test_gains_of_another_law_tell_where_it_contradicts_what_the_model_knows() -> None:
    model = model_of(error=0.02)
    x, (g, b, _) = model.axes["x"], VEHICLE["x"]
    plain = Plain(x.input, x.damping, x.delay, x.stderr, x.ci95, x.status, first_order(model, "x"))
    own = replace(x, structure="saturation", plain=plain)
    other = replace(own, combinations={
        "steady_gain": Combination(0.75 * g / b, (0.7 * g / b, 0.8 * g / b)),
        "total_lag": Combination(0.5, (0.4, None)),
    })  # fmt: skip

    alike, apart = (
        tune(replace(model, axes={**model.axes, "x": one}), axes=("x",), draws=DRAWN).axes["x"] for one in (own, other)
    )

    assert apart.law == alike.law
    assert "steady gain" not in alike.note
    assert f"steady gain of that law is {g / b:.3g}, of the model {0.75 * g / b:.3g}" in apart.note
    assert "the command is 25 % too small until d" in apart.note
    assert "total lag" not in apart.note  # 5.7 s, in an interval that is open there


@pytest.mark.parametrize("kind", KINDS)
def test_gains_of_a_vehicle_with_quadratic_drag_keep_their_promise_from_hover_to_twice_the_flown_speed(
    kind: Kind,
) -> None:
    one = tune(dragged(), kind, axes=("x",), draws=50).axes["x"]

    for speed in (0.0, 0.25, 0.5, 1.0):
        damping = 1.5 * (1 - 0.8 + 2 * 0.8 * speed / 0.5)  # of the small motion, by the derivative of the drag
        true = margins(one.law, AxisBelief(3.0, damping, 0.1))
        assert true.peak <= one.robustness.peak <= PEAK
        assert true.delay >= one.robustness.delay
    assert one.note.startswith("gains and margins are those of quadratic_drag at hover")


def test_gains_of_a_vehicle_with_a_limit_are_those_of_its_motion_below_it() -> None:
    one = tune(limited(), axes=("x",), draws=50).axes["x"]

    true = margins(one.law, LaggedAxis(5.0, 2.5, 0.2, 0.08, 0.0, 2))
    assert true.peak == pytest.approx(one.margins.peak, rel=1e-6)
    assert one.margins.peak <= one.robustness.peak <= PEAK
    assert one.note.startswith("gains and margins are those of motion that asks for less than the limit, about 0.9 m")


def test_gains_are_for_as_many_commands_as_the_flights_had_poses() -> None:
    slow, usual = (tune(with_poses(model_of(), (hz, AXES)), axes=("x",), draws=20) for hz in (9.97, 46.0))

    assert (slow.rate, usual.rate) == (10.0, 50.0)
    assert slow.axes["x"].law.period == 0.1
    assert slow.note.startswith("the model's flights had 10 fresh poses a second")
    assert "if yours gets more poses, tune with its --rate" in slow.note
    assert usual.note == tune(model_of(), axes=("x",), draws=20).note == ""


def test_more_commands_than_poses_are_tuned_for_as_asked_and_told_of() -> None:
    model = with_poses(model_of(), (100.0, ("x",)), (30.0, ("y",)))
    fast, asked = (tune(model, axes=(axis,), rate=80.0, draws=20) for axis in ("x", "y"))

    assert (fast.note, asked.rate) == ("", 80.0)
    assert "30 fresh poses a second" in asked.note
    assert "gets 80, one for each command: if yours gets as few as those flights, tune with --rate 30" in asked.note
    assert "with --rate" not in tune(with_poses(model, (3.0, ("y",))), axes=("y",), draws=20).note


@pytest.mark.parametrize("kind", KINDS)
def test_margins_hold_for_vehicles_that_were_not_drawn(kind: Kind) -> None:
    model = model_of(error=0.08)
    one = tune(model, kind, axes=("y",)).axes["y"]

    others = [margins(one.law, vehicle) for vehicle in believed_possible(model, "y", 25, 99)]

    kept = [other.peak <= 1.02 * PEAK and other.delay >= DELAY_SHARE * one.law.reach for other in others]
    assert np.mean(kept) >= 0.88
    assert all(other.stable for other in others)


def test_the_next_bandwidth_would_break_the_promise() -> None:
    model = model_of(error=0.05)
    strict, loose = (tune(model, axes=("x",), peak=peak, draws=DRAWN).axes["x"] for peak in (1.4, 2.0))

    assert strict.bandwidth < loose.bandwidth
    assert 1.3 < strict.robustness.peak <= 1.4
    assert 1.85 < loose.robustness.peak <= 2.0


def test_axes_without_numbers_are_refused_in_a_line_and_all_of_them_is_an_error() -> None:
    model = model_of({"x": VEHICLE["x"]})
    tuning = tune(model, draws=20)

    assert set(tuning.axes) == {"x"}
    assert set(tuning.refused) == {"y", "z", "yaw"}
    assert (
        tuning.refused["y"]
        == "the model has no numbers (not_excited): fit a flight that moves it, as `rotorfit plan` designs one"
    )
    with pytest.raises(ModelError, match="no axis can be tuned: y and z: the model has no numbers"):
        tune(model, axes=("y", "z"))


def test_a_vehicle_that_is_hardly_known_gets_no_gains() -> None:
    with pytest.raises(ModelError, match="too poorly known"):
        tune(model_of(error=0.6), "linearising", axes=("x",), draws=100)


def test_noisy_poses_get_a_slower_filter() -> None:
    quiet, noisy = (
        replace(model, axes={**model.axes, "x": replace(model.axes["x"], noise={"pose_variance": sigma**2})})
        for model, sigma in ((model_of(), 0.0005), (model_of(), 0.01))
    )

    first, second = (tune(model, axes=("x",), draws=DRAWN).axes["x"] for model in (quiet, noisy))

    assert first.noise is not None
    assert second.noise is not None
    assert first.noise < RESTLESS
    assert second.bandwidth < first.bandwidth
    assert np.all(np.array(second.law.observer) < np.array(first.law.observer))


def flown_with(largest: float | None) -> Model:
    """A model of x under a card that does not say what its commands mean, flown with commands up to the largest."""
    model = model_of(card=demo_card(x='{ from = "u_x" }'))
    noisy = replace(model.axes["x"], noise={"pose_variance": 1e-6})
    source = Source("flight.csv", "a" * 64, (0.0, 60.0), axes=("x",), commanded={"x": largest} if largest else {})
    return replace(model, axes={**model.axes, "x": noisy}, flights=(source,))


@pytest.mark.parametrize(("largest", "full"), [(0.8, 1.0), (90.0, 90.0)])
def test_commands_are_cut_at_a_fraction_or_the_largest_flown_where_the_card_does_not_say_what_they_mean(
    largest: float, full: float
) -> None:
    tuning = tune(flown_with(largest), axes=("x",), draws=DRAWN)
    x = tuning.axes["x"]

    assert x.full_scale == full
    assert f"x: cut at +-{full:g}" in tuning.note
    assert x.noise_text == f"{100 * x.noise / full:.1f} %"
    assert "cut" not in tune(model_of(card=demo_card()), axes=("x",), draws=DRAWN).note


def test_commands_of_the_world_are_larger_along_the_heading() -> None:
    model = flown_with(1.3)

    turned = tune(replace(model, card=replace(model.card, command_frame="world")), axes=("x",), draws=DRAWN)

    assert turned.axes["x"].full_scale == 1.0


def test_a_model_that_does_not_hold_what_was_flown_cuts_nothing_and_says_so() -> None:
    tuning = tune(flown_with(None), axes=("x",), draws=DRAWN)

    assert tuning.axes["x"].full_scale is None
    assert "x: not cut, as the model does not hold what was flown" in tuning.note


def test_noise_of_the_command_is_in_its_own_unit_where_commands_are_in_si_without_a_limit() -> None:
    model = model_of(card=demo_card(x='{ from = "u_x", meaning = "velocity", unit = "m/s" }'))
    noisy = replace(model, axes={**model.axes, "x": replace(model.axes["x"], noise={"pose_variance": 1e-6})})
    x = tune(noisy, axes=("x",), draws=DRAWN).axes["x"]

    assert x.full_scale is None
    assert float(x.noise_text) == pytest.approx(x.noise, rel=0.05)


@pytest.mark.parametrize(
    ("test", "said"),
    [("bound", "the margins are not those of small motion: no more than 1 m/s^2; fit with --structure limited_"),
     ("time", "the margins are those of the law, which the flights deny: no more than 1 m/s^2")],
)  # fmt: skip
def test_what_the_flights_say_against_the_law_is_said_of_its_margins(test: str, said: str) -> None:
    model = model_of()
    doubted = replace(model.axes["x"], evidence=(Evidence(test, "no more than 1 m/s^2", 1e-9, {}),))

    tuned = tune(replace(model, axes={**model.axes, "x": doubted}), axes=("x", "y"), draws=DRAWN).axes

    assert said in tuned["x"].note
    assert "margins are" not in tuned["y"].note


@pytest.mark.parametrize("code", ["delay_at_bound", "delay_negative", "unit_mistake"])
def test_what_the_findings_deny_is_tuned_for_no_controller(code: str) -> None:
    severity: Severity = "warning" if code == "delay_negative" else "error"
    doubted = Finding(code, severity, "the delay of x ends at its bound", "no number holds", "check the clocks", "x")
    tuning = tune(replace(model_of(), findings=(doubted,)), draws=20)

    assert tuning.refused == {"x": "the delay of x ends at its bound; check the clocks"}
    assert set(tuning.axes) == {"y", "z", "yaw"}


def test_gains_of_x_in_a_wrong_frame_say_so() -> None:
    off = Finding("yaw_offset", "warning", "x acts 30 degrees off", "too small", "turn the heading")
    tuned = tune(replace(model_of({"x": VEHICLE["x"], "z": VEHICLE["z"]}), findings=(off,))).axes

    assert "made in a wrong frame: x acts 30 degrees off; turn the heading" in tuned["x"].note
    assert "wrong frame" not in tuned["z"].note


def test_an_axis_that_moves_backwards_is_not_tuned() -> None:
    g, b, tau = VEHICLE["z"]

    assert (
        "give z of [command] in the card the other sign"
        in tune(model_of({**VEHICLE, "z": (-g, b, tau)}), draws=20).refused["z"]
    )


@pytest.mark.parametrize(
    "asked",
    [{"kind": "pid"}, {"rate": 1.0}, {"latency": -0.1}, {"peak": 1.0}, {"draws": 3}, {"rate": 500.0, "latency": 0.5}],
)
def test_what_cannot_be_asked_is_refused(asked: dict[str, object]) -> None:
    with pytest.raises(ModelError):
        tune(model_of(), **asked)  # type: ignore[arg-type]


def test_a_delay_below_zero_is_tuned_as_none_and_said() -> None:
    g, b, _ = VEHICLE["x"]
    found = tune(model_of({"x": (g, b, -0.08)}), axes=("x",), draws=20).axes["x"]

    assert found.law.delay == 0
    assert "-0.08 s" in found.note
    assert "tuned for none" in found.note


def test_gains_that_are_slow_for_how_little_is_known_say_so() -> None:
    slow, fast = (tune(model_of(error=error), axes=("z",), draws=DRAWN).axes["z"] for error in (0.4, 0.02))

    assert slow.bandwidth < fast.bandwidth / 2
    assert "what slows these gains is how little the axis is known" in slow.note
    assert "slows" not in fast.note
