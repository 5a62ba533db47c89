"""Two intervals of every number, and what refutes it."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from flights import by_hand, fit_as_flown, flown, steps
from other_laws import TRUTH, flown_by
from rotorfit.app.workflows import load_flight
from rotorfit.assessment.advice import findings_of_fit
from rotorfit.assessment.summary import summary_of_model
from rotorfit.core.flight_data import Flight
from rotorfit.core.laws import STRUCTURES
from rotorfit.core.model import COEFFICIENTS, Axis, Combination
from rotorfit.core.results import Fit
from rotorfit.dynamics.other_limits import scaled
from rotorfit.estimation.fitting import fit
from rotorfit.estimation.judgement.cross_check import with_instruments
from rotorfit.estimation.judgement.judge import _combination, _times, _with_spread, _within
from rotorfit.estimation.judgement.refutation import Homogeneity, agreement, cuts, estimates_of_parts
from rotorfit.estimation.judgement.residual_variance import Weighted, weighted_innovations
from rotorfit.estimation.likelihood.estimand import estimands
from rotorfit.files.cards import card_from_mapping
from rotorfit.files.log_span import parse_log
from rotorfit.files.models import from_mapping, to_mapping
from rotorfit.flights.assemble import flight_from_log
from rotorfit.simulation.flight_room import Conditions, fly_commands, log_of_room_flight
from rotorfit.simulation.paper_vehicle import GAMMA_B, Truth
from rotorfit.simulation.vehicle import builtin_vehicles


@cache
def of_law() -> Fit:
    return fit_as_flown([flown(Truth(), steps(("z",), seed=4), 40.0, 4)], axes=("z",))


@cache
def of_vehicles(*gains: float) -> Fit:
    truths = [Truth(gamma=(*GAMMA_B[:4], gain * GAMMA_B[4], *GAMMA_B[5:])) for gain in gains]
    flights = [flown(truth, steps(("z",), seed=20 + i), 25.0, 20 + i) for i, truth in enumerate(truths)]
    return fit(flights, axes=("z",), structure="first_order_delay")


def width(ends: tuple[float | None, float | None]) -> float:
    low, high = ends
    assert low is not None
    assert high is not None
    return high - low


def ratio(axis: Axis, name: str) -> float:
    return width(axis.ci95[name]) / width(axis.ci95_flight[name])


def test_the_sum_of_delay_and_lag_is_as_doubtful_as_the_delay_where_the_law_has_no_lag() -> None:
    judged = {name: SimpleNamespace(ratio=ratio) for name, ratio in (("input", 2.0), ("delay", 5.0))}
    part = Combination(0.2, (0.19, 0.22))

    assert _combination("delay_plus_lag", part, judged).ci95 == pytest.approx((0.15, 0.3))  # type: ignore[arg-type]
    assert _combination("input_up", part, judged).ci95 == pytest.approx((0.18, 0.24))  # type: ignore[arg-type]


def test_the_vehicles_interval_has_nothing_that_the_parameter_cannot_be() -> None:
    flight = flown_by("quadratic_drag", duration=8.0, amplitude=0.1, wind=0.3, noise=0.002)

    z = fit([flight], axes=("z",), structure="quadratic_drag").model.axes["z"]

    assert z.ci95["drag_share"] == z.ci95_flight["drag_share"] == (None, 1.0)


def test_an_end_that_the_vehicles_spread_moves_out_of_the_range_is_open() -> None:
    lag, zero = STRUCTURES["second_order_zero"].extras

    assert _within((-0.04, 0.77), zero) == (None, 0.77)
    assert _within((0.1, 2.5), zero) == (0.1, None)
    assert _within((0.001, 0.4), lag) == (None, 0.4)
    assert _within((0.02, 0.4), lag) == (0.02, 0.4)


def test_a_vehicle_that_obeys_the_law_has_an_interval_hardly_wider_than_its_flight() -> None:
    axis = of_law().model.axes["z"]

    assert axis.status == dict.fromkeys(COEFFICIENTS, "ok")
    assert axis.evidence == ()
    for name in COEFFICIENTS:
        assert 1.0 < ratio(axis, name) < 3.0
        assert axis.spread[name].source == "prior"
        assert axis.spread[name].flights_sd is None
    assert axis.combinations["steady_gain"].ci95_flight is not None


def test_covariance_and_standard_errors_are_those_of_the_vehicle() -> None:
    model = of_law().model
    axis = model.axes["z"]
    place = model.covariance_names.index("z.input")

    assert axis.stderr["input"] == pytest.approx(model.covariance[place, place] ** 0.5)
    assert axis.input is not None
    assert width(axis.ci95["input"]) == pytest.approx(2 * 1.96 * (axis.stderr["input"] or 0.0), rel=0.1)


def test_flights_of_different_vehicles_widen_the_interval_by_what_they_differ() -> None:
    axis = of_vehicles(1.0, 1.1, 0.9, 1.2).model.axes["z"]
    spread = axis.spread["input"]

    assert spread.source == "flights"
    assert spread.flights == 4
    assert spread.flights_sd == pytest.approx(np.std(np.log([1.0, 1.1, 0.9, 1.2]), ddof=1), rel=0.25)
    assert ratio(axis, "input") > 3
    assert width(spread.next_flight) > width(axis.ci95["input"])
    assert spread.p_value is not None
    assert spread.p_value < 1e-6


def test_flights_that_differ_are_no_evidence_against_the_law() -> None:
    result = of_vehicles(1.0, 1.1, 0.9, 1.2)
    axis = result.model.axes["z"]

    assert axis.evidence == ()
    assert axis.status == dict.fromkeys(COEFFICIENTS, "ok")
    told = {one.code for one in findings_of_fit(result) if one.axis == "z"}
    assert "flights_disagree" in told
    assert not any(code.startswith("law_") for code in told)
    for name in ("damping", "delay"):  # which do not differ
        assert ratio(axis, name) < 1.6


def test_flights_that_differ_do_not_hide_that_each_disobeys_the_law() -> None:
    flights = [flown_by("quadratic_drag", duration=40.0, seed=seed) for seed in (1, 2)]
    flights[1] = replace(flights[1], command=flights[1].command / 1.1)

    axis = fit(flights, axes=("z",), structure="first_order_delay").model.axes["z"]

    assert {one.test for one in axis.evidence} >= {"size"}
    assert axis.spread["input"].flights_sd == pytest.approx(np.log(1.1) / np.sqrt(2), rel=0.5)


def test_flights_of_unlike_commands_that_differ_are_told_with_their_sizes() -> None:
    """A dead zone makes the gain of small commands smaller, though each flight obeys the law with one of its own."""
    flights = [flown_by("dead_zone", duration=40.0, seed=seed, amplitude=a) for seed, a in ((1, 0.2), (2, 0.6))]

    told = {one.code: one for one in findings_of_fit(fit(flights, axes=("z",), structure="first_order_delay"))}
    assert "their commands differ in size: 0.1" in told["flights_disagree"].evidence
    assert "depends on the size or speed of the commands" in told["flights_disagree"].remedy


def test_parts_are_compared_within_their_flights() -> None:
    """Two flights put a quantity 20 standard errors apart, and what was flown in each changes it by 12 or by none."""
    for size, found in ((12.0, True), (0.0, False)):
        rng, flights, labels = np.random.default_rng(6), [], []
        for level in (-10.0, 10.0):
            label = np.repeat([0, 1], 500)
            weight = np.full((1000, 1, 1), 2000**-0.5)
            effect = (level + size * (label - 0.5))[:, None] * weight[:, :, 0]
            flights.append(
                Weighted(np.arange(1000.0), rng.standard_normal((1000, 1)) + effect, weight, weight, np.zeros(1))
            )
            labels.append(label)
        test = agreement({"input": estimates_of_parts(flights, labels, 0, 1.0)}, lambda _name: 0.3)["input"]

        assert test.freedom == 1
        assert (test.p_value < 1e-3) == found
        assert (test.sd > 1.0) == found


def test_flights_in_gusts_tell_the_input_apart_since_each_keeps_the_prior_of_the_lag() -> None:
    flights = [flown_by("first_order_delay_lag", duration=20.0, seed=s, wind=1.0, noise=0.005) for s in (1, 2, 3)]
    axis = fit(flights, axes=("z",)).model.axes["z"]

    assert axis.structure == "first_order_delay_lag"
    for name in ("input", "lag"):
        spread = axis.spread[name]
        assert spread.source == "flights"
        assert spread.flights == 3
        for each in spread.each:
            assert each is not None
            assert abs(each[0] - np.log(TRUTH["first_order_delay_lag"][name])) < 3 * each[1]


def test_calm_flights_do_not_drag_the_value_of_the_vehicle_away_from_windy_ones() -> None:
    """All flights share the levels of the wind, so that calm ones weigh less than alone: no shift corrects that."""
    gains, winds = (1.0, 0.9, 1.0, 0.9), (0.02, 0.1, 0.02, 0.1)
    truths = [
        Truth(gamma=(*GAMMA_B[:4], gain * GAMMA_B[4], *GAMMA_B[5:]), wind_sigma=(0.02, 0.02, wind, 0.01))
        for gain, wind in zip(gains, winds, strict=True)
    ]
    flights = [flown(truth, steps(("z",), seed=70 + i), 30.0, 70 + i) for i, truth in enumerate(truths)]
    axis = fit_as_flown(flights, axes=("z",)).model.axes["z"]
    mean, (low, high) = 0.95 * GAMMA_B[4], axis.ci95["input"]

    assert axis.input is not None
    assert axis.predictor is not None
    assert low is not None
    assert high is not None
    assert axis.input == pytest.approx(axis.predictor.input, rel=0.01)
    assert low < mean < high
    assert high / low < 1.2


def test_a_measured_spread_adds_to_a_long_tail_what_it_adds_to_a_short_one() -> None:
    below, above = _with_spread((1.0, 3.0), 2.0)

    assert below == pytest.approx(2.0)
    assert above == pytest.approx(np.sqrt(12.0))
    assert _with_spread((None, 1.0), 2.0) == (None, pytest.approx(2.0))
    assert _times((1.0, 3.0), 2.0) == (2.0, 6.0)


def test_flights_that_agree_share_one_narrow_interval() -> None:
    axis = of_vehicles(1.0, 1.0, 1.0, 1.0).model.axes["z"]

    assert ratio(axis, "input") < 1.6
    low, high = axis.ci95["input"]
    assert low is not None
    assert high is not None
    assert low < GAMMA_B[4] < high


def test_a_vehicle_of_another_law_is_refuted_with_the_evidence_and_what_to_do() -> None:
    result = fit([flown_by("second_order", wind=0.05, noise=0.001)], axes=("z",), structure="first_order_delay")
    axis = result.model.axes["z"]

    assert "refuted" in axis.status.values()
    assert axis.evidence[0].p_value < 1e-6
    (told,) = [one for one in findings_of_fit(result) if one.code == "law_refuted"]
    assert "does not obey first_order_delay" in told.evidence
    assert "--structure auto" in told.remedy
    said = summary_of_model(result.model, ("z",))
    assert "refuted" in said
    assert "Known: " not in said


def test_the_right_law_of_the_same_flight_is_not() -> None:
    flight = flown_by("second_order", wind=0.05, noise=0.001)
    axis = fit([flight], axes=("z",), structure="second_order").model.axes["z"]

    assert "refuted" not in axis.status.values()
    assert not axis.evidence


def test_the_model_file_keeps_both_intervals_and_reads_files_without() -> None:
    model = of_vehicles(1.0, 1.1, 0.9, 1.2).model
    raw = to_mapping(model)

    assert from_mapping(raw, "here").axes["z"] == model.axes["z"]
    for part in ("ci95_flight", "spread", "evidence"):
        raw["axes"]["z"].pop(part, None)
    for combination in raw["axes"]["z"]["combinations"].values():
        combination.pop("ci95_flight", None)
    old = from_mapping(raw, "here").axes["z"]
    assert old.ci95 == model.axes["z"].ci95
    assert old.ci95_flight == {}


def test_other_limits_scale_both_intervals_and_leave_the_spread_of_logarithms() -> None:
    axis = of_law().model.axes["z"]
    twice = scaled(axis, 2.0)

    assert twice.ci95_flight["input"] == pytest.approx([2 * end for end in axis.ci95_flight["input"] if end])
    assert twice.spread["input"].sd == axis.spread["input"].sd
    assert twice.spread["input"].next_flight[0] == pytest.approx(2 * (axis.spread["input"].next_flight[0] or 0.0))


def test_several_flights_name_the_one_that_stands_out() -> None:
    result = of_vehicles(1.0, 1.0, 1.0, 1.4)

    (told,) = [one for one in findings_of_fit(result) if one.code == "flights_disagree"]
    assert told.evidence.count("stands out") == 1


def test_a_vehicle_that_brakes_at_command_zero_is_found_and_its_commanded_parts_are_not_refuted() -> None:
    """Drag alone lets it coast; its autopilot stops it: another law below a threshold, which no coefficient holds."""
    vehicle = builtin_vehicles()["bebop2"]
    assert vehicle.autopilot.brakes_on_zero
    t = np.arange(0.0, 60.0, 0.033)
    level = np.array([0, 0.25, 0, -0.25, 0, 0.15, 0, -0.2, 0, 0.3, 0, -0.3])
    command = np.zeros((t.size, 4))
    command[:, 0] = level[(t / 2.5).astype(int) % level.size]
    stamps = np.round(t * 1e9).astype(np.int64)
    flown_in_the_room = fly_commands(vehicle, Conditions(), stamps, command, 60.0, 1, (0.0, 0.0, 30.0, 0.0))
    flight = flight_from_log(log_of_room_flight(flown_in_the_room), card_from_mapping(vehicle.card(), vehicle.name))

    result = fit([flight], axes=("x",), structure="first_order_delay")
    axis = result.model.axes["x"]
    assert "brakes_at_zero" in {finding.code for finding in findings_of_fit(result)}
    whole, commanded = result.braking["x"]
    assert commanded < 40.0
    assert "refuted" not in axis.status.values()
    assert axis.damping is not None
    assert axis.damping == pytest.approx(vehicle.drag[0], rel=0.05)
    assert axis.damping < 0.5 * whole.damping  # of braking and coasting together


def test_a_coefficient_that_drifts_is_found_however_long_the_flight_is() -> None:
    """Stretches of 12 s of half an hour would each hold too little information to be compared."""
    time = np.arange(0.0, 1800.0, 0.1)
    weight = np.full((time.size, 1, 1), time.size**-0.5)
    drift = 100.0 * (time[:, None] / 1800.0 - 0.5) * weight[:, :, 0]
    noise = np.random.default_rng(5).standard_normal((time.size, 1))
    commands = SimpleNamespace(command_time=time, command=np.sin(time)[:, None])
    for innovation, found in ((noise + drift, True), (noise, False)):
        flight = Weighted(time, innovation, weight, weight, np.zeros(1))
        parts = estimates_of_parts([flight], cuts([commands], [flight], 0)["time"], 0, 1.0)  # type: ignore[list-item]
        test = agreement({"input": parts}, lambda _name: 1.0)["input"]

        assert (test.p_value < 1e-6) == found


def test_a_steady_gain_is_as_uncertain_as_the_input_that_changed() -> None:
    """Each part knows it too little to show the change, of which the input leaves no doubt."""
    before = flown(Truth(), steps(("z",), seed=4), 120.0, 4)
    late = before.command_time > 60.0
    gain, damping = Truth().gamma[4:6]
    changed = replace(before, command=np.where(late[:, None], before.command / 0.9, before.command))

    axis = fit([changed], axes=("z",), structure="first_order_delay").model.axes["z"]
    low, high = axis.combinations["steady_gain"].ci95
    assert low is not None
    assert high is not None
    assert low < 0.9 * gain / damping
    assert high > gain / damping
    assert {one.test for one in axis.evidence} >= {"time", "quarter"}
    assert not {one.test for one in fit([before], axes=("z",), structure="first_order_delay").model.axes["z"].evidence}


def test_a_combination_that_is_not_judged_itself_is_widened_as_the_coefficients_are() -> None:
    """The inputs up and down are published, and no test of the law is made of them."""
    axis = fit([flown(Truth(), steps(("z",), seed=4), 40.0, 4)], axes=("z",), structure="climb_descent").model.axes["z"]
    wider = max(ratio(axis, name) for name in ("input", "damping", "asymmetry"))

    for name in ("input_up", "input_down"):
        part = axis.combinations[name]
        assert part.ci95_flight is not None
        assert width(part.ci95) / width(part.ci95_flight) == pytest.approx(wider, rel=0.1)
    assert wider > 1.2


# A feedback loop


def yaw_in_a_loop(swing: float, seed: int) -> Flight:
    """A minute of a first-order yaw under eight sines and feedback; what disturbs it is wind, and a swing at 1.3 Hz."""
    rng = np.random.default_rng(seed)
    step, late, every = 0.005, 24, 4
    sines, phases = np.linspace(1.6, 4.7, 8), rng.uniform(0.0, 2 * np.pi, 8)
    angle = rate = slope = before = pushed = turned = 0.0
    waiting, commands, poses = [0.0] * late, [], []
    for i in range(12_000):
        if i % every == 0:
            seen = angle + 3e-5 * rng.normal()
            slope, before = slope + 0.3 * ((seen - before) / (every * step) - slope), seen
            commands.append(0.06 * np.sin(sines * i * step + phases).sum() - 0.6 * seen - 0.5 * slope)
            poses.append(seen)
        waiting.append(commands[-1])
        turned += step * (-0.48 * turned - 64.0 * pushed) + swing * np.sqrt(step) * rng.normal()
        pushed += step * turned
        rate += step * (4.0 * waiting.pop(0) - 2.5 * rate + turned) + 0.05 * np.sqrt(step) * rng.normal()
        angle += step * rate
    time = every * step * np.arange(len(poses))
    columns = np.zeros((2, time.size, 4))
    columns[:, :, 3] = poses, commands
    return by_hand(time, columns[0], time, columns[1])


def instruments_of(flight: Flight) -> dict[str, Homogeneity]:
    estimate = fit([flight], axes=("yaw",), structure="first_order_delay").estimates["yaw"]
    assert estimate.loop.closed
    wanted = estimands(estimate.optimum, estimate.place)
    weighted = weighted_innovations(estimate, list(wanted.values()))
    errors = {name: one.error(estimate.optimum) for name, one in wanted.items()}
    return with_instruments(estimate, weighted, wanted, errors)


def test_in_a_loop_with_wind_as_modelled_the_likelihood_is_believed() -> None:
    assert instruments_of(yaw_in_a_loop(0.0, 0)) == {}


def test_in_a_loop_a_swing_that_the_filter_lacks_is_not_taken_for_excitation() -> None:
    found = instruments_of(yaw_in_a_loop(0.15, 0))

    assert set(found) == {"input", "damping", "delay", "steady_gain", "total_lag"}
    assert all(one.sd > 1.0 for one in found.values())


def test_a_real_autopilots_loop_does_not_hide_its_steady_gain(real_flights: Path) -> None:
    flight = load_flight(parse_log(str(real_flights / "arducopter-sitl" / "s01.mcap")))
    axis = fit([flight], axes=("yaw",)).model.axes["yaw"]

    gain, known = axis.combinations["steady_gain"], 1.006  # by steps, in truth.json
    assert gain.ci95_flight is not None
    assert gain.ci95_flight[1] is not None
    assert gain.ci95[0] is not None
    assert gain.ci95[1] is not None
    assert gain.ci95_flight[1] < known
    assert gain.ci95[0] < known < gain.ci95[1]
    assert axis.ci95["delay"][0] is not None
    assert axis.ci95["delay"][0] < 0.09 < axis.ci95_flight["delay"][0]  # type: ignore[operator]
