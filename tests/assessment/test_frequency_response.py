"""The empirical frequency response: known truth under each law, in open and closed loop; bands counted."""

import json
import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from flights import STILL, by_hand, flown, steps, truth_of
from models import VEHICLE, model_of
from other_laws import TRUTH, flown_by
from rotorfit.app.workflows import load_flight
from rotorfit.assessment.frequency.comparison import (
    findings_of_responses,
    model_bands,
    response_mapping,
    response_test,
)
from rotorfit.assessment.frequency.law_test import law_test, matched
from rotorfit.assessment.frequency.loop import answers_motion, seem_to_answer
from rotorfit.assessment.frequency.response import frequency_response, response_bands, response_of_bands
from rotorfit.assessment.frequency.spectra import held_integrals, spectra_of, windows_of
from rotorfit.core.flight_data import Flight, Segment
from rotorfit.core.flight_plan import value
from rotorfit.core.frames import AXES, Array
from rotorfit.core.frequency_response import FrequencyResponse
from rotorfit.core.laws import FIRST_ORDER_DELAY, STRUCTURES
from rotorfit.core.model import COEFFICIENTS, Predictor, weighed
from rotorfit.dynamics.irregular_fourier import IrregularFourier
from rotorfit.dynamics.tones import tones_of
from rotorfit.dynamics.transfer_function import has_transfer_function, law_phase, law_response
from rotorfit.files.log_span import LogSpan
from rotorfit.planning.signals import multisine
from rotorfit.reporting.frequency import response_charts, response_line, response_rows
from rotorfit.simulation.paper_vehicle import Controller, Truth

LOOP = Controller(stiffness=0.5, damping=0.8)


def many_sines(duration: float) -> Callable[[Array], Array]:
    sines = [multisine(size, duration - 2, (0.8, 6.0), k, 4) for k, size in enumerate((0.2, 0.2, 0.2, 0.3))]
    return lambda t: np.stack([value(s, t - 1) * ((t > 1) & (t < duration - 1)) for s in sines], axis=-1)


def point_of(truth: Truth, axis: str) -> Predictor:
    known = truth_of(truth, axis)
    return Predictor(known["input"], known["damping"], known["delay"])


def inside(found: FrequencyResponse, true: Array) -> Array:
    """Whether the true gain and the true delay are in the bands, shape (K, 2)."""
    phase = found.phase + np.angle(true / found.response)
    return np.stack([
        (found.gain_band[:, 0] <= np.abs(true)) & (np.abs(true) <= found.gain_band[:, 1]),
        (found.delay_band[:, 0] <= -phase / found.frequency) & (-phase / found.frequency <= found.delay_band[:, 1]),
    ], axis=1)  # fmt: skip


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("damping", [0.05, 0.5, 3.0])
def test_the_delay_of_a_slow_vehicle_is_not_off_by_half_a_turn(damping: float, sign: float) -> None:
    """Far above its damping a line through its phases begins a quarter turn below zero."""
    w = np.array([2.0, 2.6, 3.1, 5.0])
    law, point = STRUCTURES["first_order_delay"], Predictor(sign * 4.0, damping, 0.3)
    late, unclear = 0.3 + np.arctan(w / damping) / w, np.ones(4)
    alone = FrequencyResponse("x", w, law_response(law, point, w), np.ones((4, 2)), unclear, unclear, "command")

    np.testing.assert_allclose(-law_phase(law, point, w) / w, late)
    np.testing.assert_allclose(alone.delay, late)
    np.testing.assert_allclose(replace(alone, expected=law_phase(law, point, w) + 0.4).delay, late)
    noisy = alone.response * np.array([1.0, -1.0, 1.0, 1.0])  # one point says nothing: the others keep their turns
    beside = replace(alone, response=noisy, expected=law_phase(law, point, w))
    np.testing.assert_allclose(beside.delay[[0, 2, 3]], late[[0, 2, 3]])


# The transfer functions of the laws


@pytest.mark.parametrize("name", [n for n, s in STRUCTURES.items() if has_transfer_function(s)])
def test_each_linear_law_gives_the_motion_that_was_flown(name: str) -> None:
    flight = flown_by(name, duration=60.0, seed=3)
    truth = TRUTH[name]
    structure = STRUCTURES[name]
    extra = {one.name: truth[one.name] for one in structure.extras}
    point = Predictor(truth["input"], truth["damping"], truth.get("delay", 0.0), extra)

    found = frequency_response(flight, "z")
    assert found.instrument == "command"
    true = law_response(structure, point, found.frequency)
    assert found.frequency.size >= 8
    assert np.abs(found.response / true - 1).max() < 0.06
    assert np.median(np.abs(found.response / true - 1)) < 0.01


def test_laws_that_are_not_linear_have_none() -> None:
    assert not has_transfer_function(STRUCTURES["quadratic_drag"])
    assert not has_transfer_function(STRUCTURES["saturation"])
    assert not has_transfer_function(STRUCTURES["coupled"])


# Spectra


def test_held_commands_are_integrated_exactly() -> None:
    switch, held = np.array([2.0, 2.5, 4.0]), np.array([1.0, -2.0])
    s = 1j * np.pi * np.arange(1, 8)
    exact = (1 - np.exp(-0.5 * s)) / s - 2 * (np.exp(-0.5 * s) - np.exp(-2 * s)) / s
    found, nothing = held_integrals(switch, [held, 0 * held], 7)
    np.testing.assert_allclose(found, exact, rtol=1e-12, atol=1e-14)
    assert not nothing.any()


def test_sums_over_irregular_points_are_those_of_the_matrix() -> None:
    rng = np.random.default_rng(5)
    for points, count in ((1, 1), (300, 7), (40, 501), (0, 5)):
        x = rng.uniform(-3, 900, points)
        matrix = np.exp(-1j * np.outer(np.arange(count), x))
        over, at = rng.standard_normal(points) * (1 + 2j), rng.standard_normal(count)
        sums = IrregularFourier(x, count)
        np.testing.assert_allclose(sums.over_points(over), matrix @ over, rtol=0, atol=1e-9)
        np.testing.assert_allclose(sums.at_points(at), at @ matrix, rtol=0, atol=1e-9)


def test_what_a_law_leaves_of_a_still_flight_is_smooth() -> None:
    (window,) = windows_of(flown(STILL, steps(("yaw",)), 30.0), "yaw")
    spectra = spectra_of(window)
    rest = spectra.motion - law_response(FIRST_ORDER_DELAY, point_of(STILL, "yaw"), spectra.frequency) * spectra.command
    rough = np.abs(np.diff(rest, 2)).max()
    assert rough < 0.02 * np.abs(spectra.motion).max()
    assert rough < 0.1 * np.abs(np.diff(spectra.motion, 2)).max()


def test_a_hole_in_the_poses_parts_the_windows() -> None:
    flight = flown(STILL, steps(("z",)), 40.0)
    kept = (flight.pose_time < 18) | (flight.pose_time > 19)
    parted = by_hand(
        flight.pose_time[kept],
        np.column_stack([flight.position, flight.yaw])[kept],
        flight.command_time,
        flight.command,
    )
    assert [w.duration for w in windows_of(parted, "z")] == pytest.approx([18, 21], abs=1.0)
    found = frequency_response(parted, "z")
    true = law_response(FIRST_ORDER_DELAY, point_of(STILL, "z"), found.frequency)
    assert np.median(np.abs(found.response / true - 1)) < 0.04


# Tones


def test_tones_are_found_between_bins_and_beside_noise() -> None:
    rng, t = np.random.default_rng(1), np.arange(0.0, 60.0, 0.1)
    signal = 0.3 * np.sin(1.0 * t) + 0.3 * np.cos(1.33 * t + 1) + 0.02 * rng.standard_normal(t.size) + 5.0
    tones = tones_of(t, signal, 12.0)
    np.testing.assert_allclose(tones.frequency, [1.0, 1.33], atol=0.005)
    assert tones.share > 0.98
    assert np.std(tones.value(t) - (signal - signal.mean())) < 0.03


def test_noise_and_steps_have_no_tones_to_speak_of() -> None:
    rng, t = np.random.default_rng(2), np.arange(0.0, 60.0, 0.1)
    assert tones_of(t, rng.standard_normal(t.size), 12.0).share < 0.3
    assert tones_of(t, steps(("z",), seed=4)(t)[:, 2], 12.0).share < 0.6


# Responses and their bands


def test_tones_are_the_instrument_in_a_loop() -> None:
    found = frequency_response(flown(Truth(), many_sines(60.0), 60.0, seed=3, controller=LOOP), "z")
    assert found.instrument == "tones"
    assert found.coherence.min() > 0.9


def test_a_loop_without_tones_or_reference_has_no_response() -> None:
    windy = Truth(wind_sigma=(0.3, 0.3, 0.3, 0.3))
    found = frequency_response(flown(windy, steps(amplitude=0.1), 60.0, seed=3, controller=Controller(2.0, 2.5)), "z")
    assert found.frequency.size == 0
    assert found.instrument == "none"
    assert "responds to its motion" in found.why_none


@pytest.mark.parametrize("seed", range(4))
def test_a_turning_vehicle_is_no_loop(seed: int) -> None:
    """With x and y alike: their commands mix as the heading turns, and so do their responses."""
    both = steps(("x", "y"), 0.2, seed=seed)

    def turning(t: Array) -> Array:
        command = both(t)
        command[:, 3] = np.where((t / 2.0).astype(int) % 2, -0.15, 0.15)
        return command

    alike = replace(Truth(), gamma=(4.0, 0.5, 4.0, 0.5, *Truth().gamma[4:]), stale_share=0.0)
    flight = flown(alike, turning, 60.0, seed)
    assert np.ptp(flight.yaw) > np.radians(20)
    assert [frequency_response(flight, axis).why_none for axis in ("x", "y")] == ["", ""]


@pytest.mark.parametrize("seed", range(5))
def test_long_legs_on_every_axis_are_no_loop(seed: int) -> None:
    """Along the mean heading the commands turn with the vehicle, which gusts turn; as they are sent they do not."""
    rng = np.random.default_rng(seed)
    _, leg, half = rng.uniform(0.4, 3.0, (4, 2)), rng.uniform(0.0, 6.0, (4, 2))[:, 0], rng.uniform(4.0, 8.0, 4)

    def legs(t: Array) -> Array:
        return np.array([0.15, 0.15, 0.15, 0.05]) * np.sign(np.sin(np.pi * (t[:, None] / half + leg)))

    flight = flown(replace(Truth(), wind_sigma=(0.3,) * 4, stale_share=0.0), legs, 90.0, seed)
    assert not [axis for axis in AXES if seem_to_answer([flight], axis)]


def test_windows_in_which_the_heading_turns_are_tested_beside_others_in_which_it_stays() -> None:
    stays, turns = (flown(STILL, steps(axes), 30.0) for axes in (("x", "y"), AXES))
    windows = [*windows_of(stays, "x"), *windows_of(turns, "x")]
    assert [bool(window.turned.any()) for window in windows] == [False, True]
    assert not answers_motion(windows)


def test_an_axis_that_is_not_commanded_has_none() -> None:
    found = frequency_response(flown(STILL, steps(("x",)), 20.0), "z")
    assert "not commanded" in found.why_none
    assert found.gain_band.shape == (0, 2)
    assert found.delay.size == 0


def test_a_negative_input_turns_the_gain_and_not_the_delay() -> None:
    flight = flown(STILL, steps(("z",)), 40.0)
    turned = by_hand(
        flight.pose_time, np.column_stack([flight.position, flight.yaw]), flight.command_time, -flight.command
    )
    one, other = frequency_response(flight, "z"), frequency_response(turned, "z")
    np.testing.assert_allclose(one.delay, other.delay, atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("damping", [0.2, 0.4, 2.0])
def test_a_slow_axis_under_steps_is_not_smoothed(damping: float, seed: int) -> None:
    """Knots 0.4 rad/s apart: straight lines between them made the delay 0.1 s too long below 0.7 rad/s."""
    truth = replace(STILL, gamma=(*STILL.gamma[:4], 4.0, damping, *STILL.gamma[6:]))
    found = frequency_response(flown(truth, steps(("z",), seed=seed), 60.0), "z")
    true = law_response(FIRST_ORDER_DELAY, point_of(truth, "z"), found.frequency)
    np.testing.assert_allclose(found.gain, np.abs(true), rtol=0.015)
    phase = found.phase + np.angle(true / found.response)
    np.testing.assert_allclose(found.delay, -phase / found.frequency, atol=0.05)


def test_a_heading_that_stays_takes_no_freedom_from_the_bands() -> None:
    """Its noise is no turn: with terms for one, bands of eight frequencies had too little freedom, and were lost."""
    noisy = replace(STILL, mocap_noise=(0.001, 0.001, 0.001, 0.0005))
    (window,) = windows_of(flown(noisy, steps(("x", "y")), 60.0), "x")
    assert not window.turned.any()
    assert not window.turning.any()


@pytest.mark.parametrize("closed", [pytest.param(False, marks=pytest.mark.slow), True])
def test_bands_hold_the_truth_and_the_law_that_was_flown_is_not_refuted(closed: bool) -> None:
    """Four flights here; the slow test has more."""
    hits, ps = counted(range(4), closed, ("z", "yaw"))
    assert 0.88 < hits.mean() <= 1
    assert np.mean(ps < 0.05) <= 0.2


@pytest.mark.slow
@pytest.mark.parametrize("closed", [False, True])
def test_bands_and_the_false_alarms_of_the_test_on_many_flights(closed: bool) -> None:
    hits, ps = counted(range(100), closed, ("z", "yaw"))
    assert 0.93 < hits.mean() < 0.97
    assert np.mean(ps < 0.05) < 0.09
    assert np.mean(ps < 0.01) < 0.03


def counted(seeds: range, closed: bool, axes: tuple[str, ...]) -> tuple[Array, Array]:
    """Whether the truth is in each band, and the p-value of each flight and axis."""
    hits, ps, truth = [], [], Truth()
    for seed in seeds:
        flight = flown(truth, many_sines(60.0), 60.0, 1000 + seed, controller=LOOP if closed else None)
        for axis in axes:
            bands, instrument, why = response_bands(flight, axis)
            found, point = response_of_bands(axis, bands, instrument, why), point_of(truth, axis)
            hits.append(inside(found, law_response(FIRST_ORDER_DELAY, point, found.frequency)).ravel())
            test = law_test(bands, FIRST_ORDER_DELAY, point)
            assert test is not None
            ps.append(test.p)
    return np.concatenate(hits), np.array(ps)


# The law against the response


@cache
def lagging() -> Flight:
    return flown_by("second_order", duration=60.0, seed=5, wind=0.05, noise=0.0005)


def test_another_law_is_refuted_whatever_its_coefficients() -> None:
    bands = response_bands(lagging(), "z")[0]
    wrong = law_test(bands, FIRST_ORDER_DELAY, Predictor(3.0, 1.2, 0.2))
    right = law_test(bands, STRUCTURES["second_order"], Predictor(3.0, 1.2, 0.12, {"lag": 0.3}))
    assert wrong is not None
    assert right is not None
    assert wrong.p < 1e-6
    assert right.p > 0.01
    assert wrong.statistic > 5 > right.statistic


def test_the_start_of_the_search_does_not_matter() -> None:
    bands = response_bands(lagging(), "z")[0]
    one = law_test(bands, STRUCTURES["second_order"], Predictor(3.0, 1.2, 0.12, {"lag": 0.3}))
    other = law_test(bands, STRUCTURES["second_order"], Predictor(1.5, 2.5, 0.0, {"lag": 0.15}))
    assert one is not None
    assert other is not None
    assert one.p == pytest.approx(other.p, rel=0.05)


def test_the_matched_distribution_has_the_mean_and_the_variance() -> None:
    from scipy.stats import f

    c, freedom = matched(1.2, 0.5, 10)
    assert c * f.mean(10, freedom) == pytest.approx(1.2)
    assert c**2 * f.var(10, freedom) == pytest.approx(0.5)


def test_a_model_beside_a_flight_of_another_law_is_a_finding_and_a_table() -> None:
    model = model_of({"z": (3.0, 1.2, 0.25)})
    (axes,) = response_test(model, [lagging()])
    found = list(findings_of_responses([axes]))
    assert [each.code for each in found] == ["response_refutes_law"]
    assert found[0].axis == "z"

    mapping = response_mapping(axes["z"])
    assert json.loads(json.dumps(mapping, allow_nan=False)) == mapping
    assert mapping["law_p"] < 1e-6
    assert len(mapping["gain_ci95"]) == len(mapping["frequency"]) == len(mapping["model_delay"])
    assert any("*" in cell for row in response_rows(axes["z"]) for cell in row)
    many, law = axes["z"].flight.frequency.size, axes["z"].law
    assert law is not None
    line = response_line(axes["z"])  # each figure says what it is one of: the p-value of all, the deviation of one
    assert line.startswith(
        f"all frequencies together: inconsistent with the law for any coefficients (p = {law.p:.3g}, "
    )
    assert f"; the worst of {many} is off by {law.worst_share:.1f} times its 95 % band, at " in line
    gain, delay = response_charts([axes])
    assert (gain.kind, delay.kind) == ("response_gain", "response_delay")
    assert {"measured", "band", "model"} <= {line.role for line in gain.lines}


@pytest.mark.parametrize(
    ("p", "severity", "verdict"),
    [(3e-4, "warning", "inconsistent"), (3e-3, "info", "inconsistent"), (0.03, None, "hardly consistent")],
)
def test_a_law_that_a_flight_rejects_is_a_finding_with_both_gains(p: float, severity: str | None, verdict: str) -> None:
    (axes,) = response_test(model_of({"z": (3.0, 1.2, 0.25)}), [lagging()])
    assert axes["z"].law is not None
    told = replace(axes["z"], law=replace(axes["z"].law, p=p))

    found = list(findings_of_responses([{"z": told}]))
    assert [one.severity for one in found] == [severity] * bool(severity)
    for one in found:
        assert re.search(
            r"at [\d.]+ rad/s, where the flight has gain [\d.]+ to [\d.]+ and .*the model [\d.]+", one.evidence
        )
        assert re.search(r"for commands that last about [\d.]+ s fit this flight together with those of", one.remedy)
    assert f": {verdict} with the law" in response_line(told)


def test_a_law_that_holds_with_other_numbers_than_the_models_says_so() -> None:
    """The test is of the law: without these words it reads as praise of a model whose delay is wrong throughout."""
    truth = Truth()
    flight = flown(truth, many_sines(60.0), 60.0, seed=1007)
    points = {axis: tuple(truth_of(truth, axis).values()) for axis in AXES}
    g, b, tau = points["z"]
    (axes,) = response_test(model_of({**points, "z": (g, b, tau + 0.05)}), [flight])  # type: ignore[dict-item]

    found = re.search(
        r"consistent with the law at other coefficients, as the model misses a band at (\d+) of (\d+) \(p = ",
        response_line(axes["z"]),
    )
    assert found
    assert int(found[1]) > 0.8 * int(found[2])
    (right,) = response_test(model_of(points), [flight])  # type: ignore[arg-type]
    assert ": consistent with the law (p = " in response_line(right["z"])


def test_a_model_that_is_right_lies_in_the_bands_and_its_own_band_is_around_it() -> None:
    truth = Truth()
    flight = flown(truth, many_sines(60.0), 60.0, seed=1007)
    model = model_of({axis: tuple(truth_of(truth, axis).values()) for axis in AXES})  # type: ignore[misc]
    (axes,) = response_test(model, [flight])
    assert list(findings_of_responses([axes])) == []
    z = axes["z"]
    assert inside(z.flight, law_response(FIRST_ORDER_DELAY, point_of(truth, "z"), z.flight.frequency)).mean() > 0.8
    assert (z.gain_band[:, 0] < z.model_gain).all()
    assert (z.model_gain < z.gain_band[:, 1]).all()
    assert (z.model_delay_band[:, 0] < z.model_delay).all()
    assert (z.model_delay < z.model_delay_band[:, 1]).all()


def test_a_models_band_covers_every_law_that_it_keeps() -> None:
    model, omega = model_of(error=0.02), np.array([0.5, 2.0, 6.0])
    alone, late = model_bands(model, "z", omega)
    point = model.axes["z"].predictor
    assert point is not None
    plain = weighed("first_order_delay", point, COEFFICIENTS, np.diag([1e-4] * 3), 0.6)
    slow = Predictor(1.1 * point.input, point.damping, 0.0, {"lag": 0.1})
    lagged = weighed("first_order_delay_lag", slow, (*COEFFICIENTS, "lag"), np.diag([1e-6] * 4), 0.4)
    both = replace(model, axes={**model.axes, "z": replace(model.axes["z"], laws=(plain, lagged))})

    band, half = model_bands(both, "z", omega)
    law = STRUCTURES["first_order_delay_lag"]
    gain = np.abs(law_response(law, slow, omega))
    off = law_phase(law, slow, omega) - law_phase(FIRST_ORDER_DELAY, point, omega)

    assert np.all((band[:, 0] < gain) & (gain < band[:, 1]))
    assert np.all((band[:, 0] <= alone[:, 0]) & (band[:, 1] >= alone[:, 1]))
    assert np.all(half >= np.maximum(late, np.abs(off) / omega))


def test_a_flight_without_a_response_says_why() -> None:
    windy = Truth(wind_sigma=(0.3, 0.3, 0.3, 0.3))
    flight = flown(windy, steps(amplitude=0.1), 60.0, seed=3, controller=Controller(2.0, 2.5))
    (axes,) = response_test(model_of(VEHICLE), [flight])
    assert "responds to its motion" in response_line(axes["z"])
    assert response_mapping(axes["z"])["law_p"] is None
    assert response_charts([{"z": axes["z"]}]) == ()


# A real autopilot


@pytest.fixture(scope="module")
def autopilot(real_flights: Path) -> Path:
    folder = real_flights / "arducopter-sitl"
    if not folder.is_dir():
        pytest.skip("the flights of the simulated autopilot are not there")
    return folder


@pytest.mark.parametrize(("name", "gains", "delays"), [("s01", 19, 20), ("s02", 15, 17), ("s06", 23, 24)])
def test_the_autopilots_sines_lie_in_the_bands(autopilot: Path, name: str, gains: int, delays: int) -> None:
    """Of 28 tones at 1 to 4.5 rad/s. What is missing is what a multisine does to an autopilot that limits jerk.

    The sines are known to 0.01 in gain and 5 ms, 10 ms below 2 rad/s; the clock of the poses, early by 5 to 6 ms in the
    mean, is put right by the arrivals when the log is read.
    """
    from scipy.interpolate import CubicSpline

    sines = json.loads((autopilot / "truth.json").read_text())["sine"]
    flight, hits = load_flight(LogSpan(str(autopilot / f"{name}.mcap"), (None, None))), np.zeros(2, int)
    assert "pose_clock_corrected" in {note.code for note in flight.notes}
    for axis in AXES:
        mine = sorted((s["w"], s["gain_from_pose"], s["delay_from_pose"]) for s in sines if s["axis"] == axis)
        w, gain, delay = np.array([(0.0, 1.0, 0.0), *mine]).T
        found = frequency_response(flight, axis)
        at = (found.frequency >= 1) & (found.frequency <= 4.5)
        omega = found.frequency[at]
        true = np.exp(CubicSpline(w, np.log(gain))(omega)), CubicSpline(w, w * delay)(omega) / omega
        known = 0.01, np.where(omega < 2, 0.01, 0.005)
        for k, (middle, band) in enumerate(((found.gain, found.gain_band), (found.delay, found.delay_band))):
            half = np.hypot(np.diff(band[at], axis=1)[:, 0] / 2, known[k])
            hits[k] += int(np.sum(np.abs(middle[at] - true[k]) <= half))
    assert hits[0] >= gains
    assert hits[1] >= delays


def test_a_noisy_phase_at_the_lowest_frequency_turns_no_delay_by_half_a_turn() -> None:
    omega = np.array([0.3, 0.6, 1.0, 1.6, 2.5, 4.0])
    law = 2.0 * np.exp(-0.2j * omega) / (1j * omega + 1.0)
    spoiled = law * np.exp(1j * np.array([-1.6, 0.0, 0.0, 0.0, 0.0, 0.0]))
    error = np.abs(law)[:, None] * np.array([1.0, 0.02, 0.02, 0.02, 0.02, 0.02])[:, None] * np.ones(2)
    told = FrequencyResponse("z", omega, spoiled, error, np.full(6, 2.0), np.ones(6), "command")
    np.testing.assert_allclose(told.delay[1:], -np.unwrap(np.angle(law))[1:] / omega[1:], atol=1e-9)


def test_what_keeps_a_flight_from_having_a_response_is_named() -> None:
    flight = flown(STILL, steps(("x", "yaw"), seed=1), 15.0)
    around = replace(flight, yaw=np.linspace(0.0, 4.0, flight.yaw.size))

    assert frequency_response(around, "x").why_none == "the heading turns by more than 60 deg from its mean"
    short = replace(flight, segments=(Segment(0.0, 9.0),))
    assert frequency_response(short, "x").why_none == "no 10 s without a hole in commands or poses"
