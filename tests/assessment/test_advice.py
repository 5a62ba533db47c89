"""Findings: each of them where it belongs, with numbers in it, and none where all is well."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import pytest

from flights import fit_as_flown, flown, muddled, steps
from rotorfit.app.workflows import fit_logs
from rotorfit.assessment.advice import findings_of_fit
from rotorfit.assessment.coefficient_findings import too_early
from rotorfit.assessment.law_findings import law_findings, with_size
from rotorfit.assessment.summary import summary_of_model
from rotorfit.core.errors import ModelError
from rotorfit.core.finding import Finding
from rotorfit.core.flight_data import Segment
from rotorfit.core.laws import DELAY_RANGE
from rotorfit.core.model import Candidate, Combination, Evidence, Mode, Predictor, Weighed, predictor_of
from rotorfit.core.results import Fit
from rotorfit.estimation.fitting import fit
from rotorfit.estimation.likelihood import coefficients
from rotorfit.estimation.likelihood.blocks import Record
from rotorfit.estimation.likelihood.extra_parameters import structure_at
from rotorfit.estimation.likelihood.fisher_scoring import Optimum
from rotorfit.estimation.likelihood.law_selection import unidentifiable_candidate
from rotorfit.estimation.likelihood.profile import Profile
from rotorfit.files.log_span import parse_log
from rotorfit.planning.signals import two_sines
from rotorfit.simulation.paper_vehicle import GAMMA_B, Controller, Truth

NO_STALE = replace(Truth(), stale_share=0.0)


@cache
def well() -> Fit:
    """One axis, one minute, steps of a fifth of full scale: nothing to complain of."""
    return fit_as_flown([flown(NO_STALE, steps(("z",), seed=2), 60.0, 2)], axes=("z",))


def found(result: Fit) -> dict[tuple[str, str | None], Finding]:
    return {(finding.code, finding.axis): finding for finding in findings_of_fit(result)}


def changed(result: Fit, name: str = "z", **parts: object) -> Fit:
    """The fit with other facts about one axis."""
    axes = {**result.model.axes, name: replace(result.model.axes[name], **parts)}  # type: ignore[arg-type]
    return replace(result, model=replace(result.model, axes=axes))


def test_where_all_is_well_nothing_is_said() -> None:
    assert findings_of_fit(well()) == ()


def test_every_finding_is_whole_sentences_in_one_line_each() -> None:
    flight = flown(Truth(), steps(("x", "z"), seed=3), 12.0, 3)
    short = fit_as_flown([muddled(flight, "x")])

    findings = findings_of_fit(short)
    assert findings
    for finding in findings:
        for text in (finding.evidence, finding.effect, finding.remedy):
            assert text
            assert "\n" not in text
            assert "nan" not in text
            assert "None" not in text


@pytest.mark.parametrize(("lag", "first", "told"), [(0.5, 0.2, True), (0.5, 0.0, False), (0.2, 0.2, False)])
def test_a_long_lag_on_a_flight_that_begins_under_a_command_is_told(lag: float, first: float, told: bool) -> None:
    result = well()
    point = result.model.axes["z"].predictor
    assert point is not None
    (flight,) = result.flights
    command = flight.command.copy()
    command[:5, 2] = first
    lagged = replace(
        changed(result, structure="first_order_delay_lag", predictor=replace(point, extra={"lag": lag})),
        flights=(replace(flight, command=command),),
        estimates={},
    )

    assert (("begins_in_motion", "z") in found(lagged)) == told


def test_the_gravest_come_first() -> None:
    flight = flown(Truth(), partial(two_sines, axes=("x",)), 15.0, 3)
    slow = replace(Truth(), gamma=(GAMMA_B[0], 0.02, *GAMMA_B[2:]), delay=(0.25,) * 4)
    results = [fit([flight]), fit([flown(slow, partial(two_sines, axes=("x",)), 60.0, 1)], "paper")]

    for result in results:
        ranks = [("error", "warning", "info").index(f.severity) for f in findings_of_fit(result)]
        assert ranks == sorted(ranks)


# Statuses


def test_a_commanded_axis_that_explains_nothing_is_named_and_one_that_is_not_commanded_is_not() -> None:
    result = fit_as_flown([muddled(flown(Truth(), steps(("z", "yaw"), seed=1), 60.0, 1), "z")])

    assert ("not_excited", "z") in found(result)
    assert not any(code == "not_excited" and axis != "z" for code, axis in found(result))


def test_a_flight_too_short_is_named() -> None:
    assert ("too_short", "z") in found(fit_as_flown([flown(Truth(), steps(("z",)), 5.0)]))


def test_a_climb_that_did_not_end_is_an_error() -> None:
    diverged = changed(well(), predictor=None, status=dict.fromkeys(("input", "damping", "delay"), "diverged"))

    assert found(diverged)["diverged", "z"].severity == "error"


# Coefficients


def test_a_wrong_sign_is_told_with_the_remedy_for_the_card() -> None:
    flight = flown(NO_STALE, steps(("z",), seed=2), 40.0, 2)

    told = found(fit_as_flown([replace(flight, command=-flight.command)], axes=("z",)))["sign_flipped", "z"]
    assert told.severity == "warning"
    assert "scale = -1" in told.remedy
    assert "-2.4" in told.evidence or "-2.5" in told.evidence


def test_an_unstable_damping_of_the_papers_method_is_an_error_that_says_why() -> None:
    slow = replace(NO_STALE, gamma=(GAMMA_B[0], 0.05, *GAMMA_B[2:]), delay=(0.2,) * 4)
    flight = flown(slow, partial(two_sines, axes=("x",)), 60.0, 1)

    told = found(fit([flight], "paper", axes=("x",)))["damping_unstable", "x"]
    assert told.severity == "error"
    assert "delay" in told.effect
    assert "ml" in told.remedy
    beside = found(fit([flight], "ml", axes=("x",)))
    assert beside["paper_damping_negative", "x"].severity == "info"
    assert ("damping_unstable", "x") not in beside
    assert ("paper_damping_negative", "x") not in found(fit([flight], "svf", axes=("x",)))  # biased itself


def test_regressions_say_that_their_intervals_leave_out_their_bias() -> None:
    flight = flown(NO_STALE, steps(("z",), seed=2), 20.0, 2)

    told = {method: found(fit([flight], method, axes=("z",))) for method in ("paper", "iv")}
    code = "bias_not_in_interval", None
    assert told["paper"][code].severity == "warning"
    assert "omitted delay" in told["paper"][code].evidence
    assert told["iv"][code].severity == "info"
    assert "[reference]" in told["iv"][code].evidence
    assert code not in found(fit([flight], "ml", axes=("z",), structure="first_order_delay"))


def test_a_negative_delay_beyond_its_interval_is_about_clocks() -> None:
    flight = flown(replace(NO_STALE, delay=(0.0,) * 4), steps(("z",), seed=2), 40.0, 2)
    late = replace(flight, command_time=flight.command_time + 0.05, segments=(Segment(0.05, flight.segments[0].end),))

    told = found(fit_as_flown([late], axes=("z",)))["delay_negative", "z"]
    assert "clock" in told.effect
    assert ("delay_negative", "z") not in found(fit_as_flown([flight], axes=("z",)))


def test_a_negative_delay_within_one_clock_is_about_how_often_commands_are_logged(real_flights: Path) -> None:
    """An autopilot logs its set-points at 10 Hz; in a log that two computers stamp, it may be their clocks."""
    flight = flown(replace(NO_STALE, delay=(0.0,) * 4), steps(("z",), seed=2), 40.0, 2)
    seldom = replace(flight, command_time=flight.command_time[::5] + 0.05, command=flight.command[::5])
    log = replace(seldom, path="flight.ulg", segments=(Segment(0.05, flight.segments[0].end),))

    effect, remedy = too_early([log], 0.05)
    assert "not the clocks" in effect
    assert "logged every" in effect
    assert "ms in the mean" in effect
    assert "log every command" in remedy
    assert "do not explain it" in too_early([log], 0.6)[0]
    column = replace(log.card, command_time=log.card.pose_time)
    written, remedy = too_early([replace(log, path="flight.csv", card=column)], 0.6)
    assert "not the clocks" not in written
    assert "when it was sent" in remedy
    assert "clocks of commands and poses disagree" in too_early([replace(log, path="flight.mcap")], 0.05)[0]
    done = fit_logs([parse_log(f"{real_flights / 'px4-s500' / 'TestFlight1.ulg'}@0:30")], axes=("yaw",)).model
    (told,) = [one for one in done.findings if one.code == "delay_negative"]
    assert "not the clocks" in told.effect
    assert "49 ms in the mean" in told.effect


def test_commands_stamped_later_than_any_searched_delay_are_a_matter_of_clocks_not_of_excitation() -> None:
    """Two computers, 0.25 s apart: a frequent mistake. The finding must lead to it."""
    flight = flown(NO_STALE, steps(("z", "yaw"), seed=2), 30.0, 2)
    late = replace(flight, command_time=flight.command_time + 0.3, segments=(Segment(0.3, flight.segments[0].end),))

    told = findings_of_fit(fit([late], axes=("z", "yaw")))
    assert any("clock" in f"{f.evidence} {f.effect} {f.remedy}" for f in told)


def test_a_delay_at_the_end_of_its_range_is_an_error() -> None:
    point = well().model.axes["z"].predictor
    assert point is not None
    for bound in DELAY_RANGE:
        at_bound = changed(well(), predictor=Predictor(point.input, point.damping, bound))
        assert found(at_bound)["delay_at_bound", "z"].severity == "error"


@pytest.mark.parametrize(
    ("bound", "ends", "error"),
    [(1, (0.29, None), False), (1, (None, None), False), (1, (0.45, None), True), (0, (None, 0.2), False)],
)
@pytest.mark.parametrize("path", ["flight.csv", "flight.mcap"])
def test_a_bound_that_is_merely_the_best_of_a_flat_likelihood_proves_nothing_of_clocks(
    bound: int, ends: tuple[float | None, float | None], error: bool, path: str
) -> None:
    axis = well().model.axes["z"]
    assert axis.predictor is not None
    at_bound = changed(
        well(),
        predictor=Predictor(axis.predictor.input, axis.predictor.damping, DELAY_RANGE[bound]),
        status={**axis.status, "delay": "not_identifiable"},
        ci95={**axis.ci95, "delay": ends},
    )
    flight = at_bound.flights[0]
    card = replace(flight.card, command_time=flight.card.pose_time)
    one_clock = replace(flight, card=card if path == "flight.csv" else flight.card, path=path)

    told = found(replace(at_bound, flights=(one_clock,), estimates={}))
    assert (("delay_at_bound", "z") in told) == error
    if not error:
        flat = told["delay_not_identifiable", "z"]
        assert f"{DELAY_RANGE[bound]:.2f} s" in flat.evidence
        assert flat.severity == ("info" if path == "flight.csv" else "warning")
        assert ("clocks" in flat.remedy) == (path == "flight.mcap")


def test_what_is_not_identifiable_is_told_with_what_is_known_instead() -> None:
    result = fit_as_flown([flown(NO_STALE, partial(two_sines, axes=("z",), amplitude=0.5), 60.0, 3)], axes=("z",))
    axis = result.model.axes["z"]

    for name in ("damping", "delay"):
        assert ((f"{name}_not_identifiable", "z") in found(result)) == (axis.status[name] == "not_identifiable")
    assert ("damping_not_identifiable", "z") in found(result)


def test_of_a_servo_faster_than_its_poses_the_gain_and_lag_are_in_the_finding() -> None:
    fast = replace(
        NO_STALE,
        gamma=(*GAMMA_B[:4], 20.0, 20.0, *GAMMA_B[6:]),
        pose_rate=10.0,
        command_rate=10.0,
        mocap_noise=(0.05,) * 4,
        wind_sigma=(3.0,) * 4,
    )
    result = fit_as_flown([flown(fast, steps(("z",), 0.4, seed=3), 50.0, 3)], axes=("z",))

    told = found(result)["damping_not_identifiable", "z"]
    combinations = result.model.axes["z"].combinations
    assert f"{combinations['steady_gain'].value:.3g}" in told.effect
    assert f"{combinations['total_lag'].value:.3g}" in told.effect
    assert "faster" in told.remedy


# Modes


def test_a_likelier_mode_that_predicts_worse_is_told_with_both_numbers() -> None:
    (chosen,) = (mode for mode in well().model.axes["z"].modes if mode.chosen)
    assert chosen.prediction is not None
    rival = Mode(0.008, 90.0, 5.0, 0.0, 1, 2 * chosen.prediction, False)
    doubt = changed(well(), modes=(replace(chosen, log_likelihood=-61.0), rival))

    told = found(doubt)["likelihood_and_prediction_disagree", "z"]
    assert "61" in told.evidence
    assert "2.0" in told.evidence
    believed = changed(well(), modes=(chosen, replace(rival, log_likelihood=-61.0)))
    assert ("likelihood_and_prediction_disagree", "z") not in found(believed)


# Excitation


def test_little_time_is_told() -> None:
    told = found(fit_as_flown([flown(NO_STALE, steps(("z",), seed=2), 15.0, 2)], axes=("z",)))

    assert "15" in told["short_data", "z"].evidence


def test_a_gain_known_to_no_better_than_a_fifth_is_weakly_excited() -> None:
    axis = well().model.axes["z"]
    assert axis.input is not None
    weak = changed(well(), stderr={**axis.stderr, "input": 0.3 * axis.input})

    assert "30 %" in found(weak)["weak_excitation", "z"].evidence
    assert "fly larger" in found(weak)["weak_excitation", "z"].remedy
    limited = changed(weak, evidence=(Evidence("bound", "no more than 1 m/s^2", 1e-9, {}),))
    assert "too small to reach the limit" in found(limited)["weak_excitation", "z"].remedy
    traded = found(changed(weak, extra={"lag": 0.2}))
    assert ("weak_excitation", "z") not in traded
    assert "known to 30 % only, its steady gain to" in traded["parts_trade_off", "z"].evidence


def test_what_the_fit_says_better_is_not_repeated_and_what_only_the_flight_says_stays() -> None:
    short, stale = (Finding(code, "info", "1", "2", "3") for code in ("short_data", "stale_poses"))

    told = findings_of_fit(well(), (short, stale))
    assert told == (stale,)


def test_excitation_that_a_flight_doubts_is_not_doubted_where_the_fit_knows_the_axis_well() -> None:
    wind = Finding("wind_dominates", "warning", "1", "2", "3", "z")

    assert findings_of_fit(well(), (wind,)) == ()
    weak = changed(well(), stderr=dict.fromkeys(("input", "damping", "delay"), 9.0))
    assert wind in findings_of_fit(weak, (wind,))
    unknown = changed(well(), status={"input": "ok", "damping": "not_identifiable", "delay": "ok"})
    assert wind in findings_of_fit(unknown, (wind,))


def test_where_the_frame_is_wrong_the_sign_of_a_gain_is_not_told() -> None:
    flight = flown(NO_STALE, steps(("x",), seed=2), 40.0, 2)
    backwards = fit_as_flown([replace(flight, command=-flight.command)], axes=("x",))
    frame = Finding("yaw_offset", "error", "1", "2", "3")

    assert ("sign_flipped", "x") in found(backwards)
    assert {finding.code for finding in findings_of_fit(backwards, (frame,))} == {"yaw_offset"}


@pytest.mark.parametrize("method", ["ml", "paper"])
def test_findings_of_both_methods_are_made_without_error(method: str) -> None:
    result = fit([flown(Truth(), two_sines, 12.0, 4)], method, structure="first_order_delay")  # type: ignore[arg-type]

    assert all(isinstance(finding, Finding) for finding in findings_of_fit(result))


def test_a_test_that_widens_the_intervals_of_a_law_is_told_as_a_doubt() -> None:
    doubt = Evidence("speed", "fast and slow commands give different gains", 1e-4, {"input": 0.1}, False)
    told = found(changed(well(), evidence=(doubt,)))["law_doubted", "z"]

    assert told.severity == "info"
    assert "fast and slow commands give different gains (p = 0.0001)" in told.evidence


def test_a_law_is_not_doubted_before_the_stamps_of_rows() -> None:
    doubt = Evidence("time", "stretches of time do not agree, most about the delay", 1e-6, {"delay": 0.01}, False)
    doubted, rows = changed(well(), evidence=(doubt,)), Finding("commands_by_row", "info", "rows", "late", "stamp them")
    (told,) = (one for one in findings_of_fit(doubted, (rows,)) if one.code == "law_doubted")

    assert told.remedy.startswith("log commands by themselves, each with its own stamp, before you doubt the law")
    assert not found(doubted)["law_doubted", "z"].remedy.startswith("log")


def test_a_law_that_was_chosen_among_all_is_not_advised_again() -> None:
    doubt = Evidence("speed", "fast and slow commands give different gains", 1e-4, {"input": 0.1}, False)
    tried = Candidate("first_order_delay", 3, 0.0, 0.0, None, None, "", None, None, "the baseline", True)
    axis = well().model.axes["z"]

    for status in ({}, dict.fromkeys(axis.status, "refuted")):
        for candidates in ((), (tried,)):
            (told,) = law_findings("z", replace(axis, evidence=(doubt,), status=status, candidates=candidates))
            assert ("fit with --structure auto" in told.remedy) == (not candidates)


def test_no_structure_is_advised_where_none_has_a_lag_that_commands_pass_twice() -> None:
    twice = Evidence("twice", "a law under which commands pass the lag twice is likelier", 1e-4, {"total_lag": 0.1})
    axis = well().model.axes["z"]

    for status in ({}, dict.fromkeys(axis.status, "refuted")):
        (told,) = law_findings("z", replace(axis, evidence=(twice,), status=status))
        assert "--structure" not in told.remedy


def test_where_small_and_large_commands_disagree_smaller_ones_are_advised() -> None:
    size, speed = (Evidence(test, "they do not agree", 1e-4, {"input": 0.1}, False) for test in ("size", "speed"))
    axis = well().model.axes["z"]

    for status in ({}, dict.fromkeys(axis.status, "refuted")):
        for evidence in ((size, speed), (speed,)):
            (told,) = law_findings("z", replace(axis, evidence=evidence, status=status))
            assert ("smaller ones where large ones reach a limit" in told.remedy) == (size in evidence)
    assert with_size(replace(axis, evidence=(size,)), "track it").endswith("; track it")
    assert with_size(replace(axis, evidence=(speed,)), "track it") == "track it"


def test_a_law_that_was_asked_for_and_not_identifiable_was_not_chosen_among_all() -> None:
    doubt = Evidence("speed", "fast and slow commands give different gains", 1e-4, {"input": 0.1}, False)
    axis = replace(well().model.axes["z"], evidence=(doubt,), candidates=(unidentifiable_candidate("saturation"),))

    (told,) = law_findings("z", axis)
    assert "fit with --structure auto" in told.remedy


@pytest.mark.parametrize(("criterion", "told"), [(-370.0, True), (-60.0, False)])
def test_a_law_that_was_rejected_although_it_is_much_likelier_is_a_warning(criterion: float, told: bool) -> None:
    chosen = Candidate("first_order_lag", 3, 10.0, -20.0, 0.1, 0.5, "first_order_delay", None, None, "preferred", True)
    verdict = "rejected: it predicts worse"
    both = Candidate(
        "first_order_delay_lag", 4, 200.0, -20.0 + criterion, 0.1, 0.6, chosen.structure, None, None, verdict, False
    )
    findings = found(changed(well(), candidates=(chosen, both)))

    assert (("likelier_law_rejected", "z") in findings) == told
    if told:
        one = findings["likelier_law_rejected", "z"]
        assert one.severity == "warning"
        assert "the criterion is lower by 370" in one.evidence
        assert "first_order_delay_lag was rejected: it predicts worse" in one.evidence
        assert one.remedy.startswith("fit with --structure first_order_delay_lag, too")


def test_a_damping_that_hangs_on_an_open_delay_says_so() -> None:
    axis = well().model.axes["z"]
    ends = {**axis.ci95, "damping": (0.28, 0.34), "delay": (None, 0.2)}
    status = {**axis.status, "damping": "not_identifiable", "delay": "not_identifiable"}

    told = found(changed(well(), ci95=ends, status=status))["damping_not_identifiable", "z"]
    assert told.evidence.endswith("0.28 to 0.34 1/s, which does not hold where that of the delay is open")
    assert told.remedy == "fly faster changes of the command"


def test_an_instrument_that_the_motion_answers_is_a_warning_in_a_soft_loop_too_and_none_in_an_open_one() -> None:
    loops = (Controller(3.0, 3.0), Controller(1.0, 1.6), None)
    fits = [fit([flown(Truth(), steps(), 60.0, 7, controller=loop)], "iv", ("z",)) for loop in loops]
    told = [found(one).get(("instrument_not_valid", "z")) for one in fits]

    assert [one and one.severity for one in told] == ["warning", "warning", None]


@pytest.mark.parametrize(("delay", "seed"), [(0.25, 2), (0.35, 1)])
def test_a_law_without_delay_that_finds_nothing_or_the_opposite_is_not_the_fault_of_card_or_excitation(
    delay: float, seed: int
) -> None:
    """Without a delay the commands explain nothing (0.25 s) or have a negative gain (0.35 s); with it all is clear."""
    late = flown(replace(NO_STALE, delay=(delay,) * 4), steps(("x",), seed=seed), 20.0, seed)
    result = fit([late], axes=("x",), structure="first_order")

    axis, told = result.model.axes["x"], found(result)
    assert axis.input is None
    assert axis.status["input"] == axis.status["damping"] == "refuted"
    assert {"sign_flipped", "not_excited"}.isdisjoint(code for code, _ in told)
    assert "with a delay alone, which is likelier, the input is 3." in told["law_refuted", "x"].evidence
    assert "--structure" in told["law_refuted", "x"].remedy
    assert "the flights deny the law" in summary_of_model(result.model, ("x",))


def test_of_a_law_that_finds_nothing_the_sign_is_that_of_the_law_with_a_delay() -> None:
    """The command is turned, so that the law without delay would have a positive gain."""
    late = flown(replace(NO_STALE, delay=(0.35,) * 4), steps(("x",), seed=1), 20.0, 1)
    told = found(fit([replace(late, command=-late.command)], axes=("x",), structure="first_order"))

    assert told["sign_flipped", "x"].evidence.startswith("the input gain of x is -3.")
    assert ("law_refuted", "x") in told


def test_a_law_under_which_the_input_may_be_zero_is_not_told_as_an_idle_command(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As where slow sines need only the product of input and zero; with a delay alone the input is clear."""

    def profile(records: Sequence[Record], optimum: Optimum, index: int) -> Profile:
        found, extras = whole(records, optimum, index), structure_at(optimum, 0).extras
        return replace(found, ci95=(-0.1, 4.0)) if extras and index == optimum.point.place("input", 0) else found

    whole = coefficients.profile
    monkeypatch.setattr(coefficients, "profile", profile)
    flight = flown(NO_STALE, partial(two_sines, axes=("x",)), 20.0, 2)
    result = fit([flight], axes=("x",), structure="second_order_zero")

    axis, told = result.model.axes["x"], found(result)
    assert (axis.predictor, set(axis.status.values())) == (None, {"not_identifiable"})
    assert {"not_excited", "law_refuted"}.isdisjoint(code for code, _ in told)
    about = told["input_not_identifiable", "x"]
    assert about.severity == "warning"
    assert "under second_order_zero holds 0; with a delay alone the input is 3.7" in about.evidence
    assert about.remedy.startswith("fit without --structure")
    assert "do not tell the input of x under its law" in summary_of_model(result.model, ("x",))
    with pytest.raises(ModelError, match=r"\(not_identifiable\): the law .* does not tell its input; fit without"):
        predictor_of(result.model, "x")


def between_laws(result: Fit, **parts: object) -> Fit:
    """z under two laws that the data do not decide between, the likelier one of which tells gain and damping."""
    axis = result.model.axes["z"]
    point = Predictor(3.21, 3.19, 0.118)
    known, vague = ({"input": error, "damping": error, "delay": 0.002} for error in (0.04, 2.0))
    laws = (
        Weighed("first_order_delay", 0.79, 0.0, point, known, ()),
        Weighed("second_order_zero", 0.21, 2.7, replace(point, extra={"lag": 0.06, "zero": 0.09}), vague, ()),
    )
    unknown = {**axis.status, "input": "not_identifiable", "damping": "not_identifiable"}
    ends = {**axis.ci95, "input": (0.29, 3.29), "damping": (0.25, 3.31)}
    return changed(result, **{"input": None, "damping": None, "status": unknown, "ci95": ends, "laws": laws, **parts})


def test_what_only_another_law_leaves_open_names_the_law_that_tells_it() -> None:
    told = found(between_laws(well()))
    gain, damping = (told[f"{name}_not_identifiable", "z"] for name in ("input", "damping"))

    for one, value in ((gain, "3.21,"), (damping, "3.19 1/s,")):
        assert "(first_order_delay 79 %, second_order_zero 21 %)" in one.evidence
        assert one.remedy.startswith(f"fit with --structure first_order_delay, which gives {value}")
    assert gain.evidence.startswith("the 95 % interval of the input gain of z is 0.29 to 3.29")


def test_a_delay_that_two_clocks_hide_is_no_feedback_loop() -> None:
    axis = between_laws(well()).model.axes["z"]
    gain = axis.combinations["steady_gain"]
    clocked = between_laws(
        well(),
        delay=None,
        status={**axis.status, "delay": "not_identifiable"},
        ci95={**axis.ci95, "delay": (None, None)},
        combinations={"steady_gain": gain, "offset_plus_delay": Combination(-246.8, (-246.9, -246.7))},
    )
    told = found(clocked)

    assert "responds to its motion" not in told["input_not_identifiable", "z"].evidence
    assert told["input_not_identifiable", "z"].remedy.startswith("fit with --structure first_order_delay")
    assert told["damping_not_identifiable", "z"].effect == f"what is known of z is the steady gain {gain.value:.3g}"
    alone = found(changed(clocked, laws=()))
    assert alone["damping_not_identifiable", "z"].remedy == "fly faster changes of the command"
    assert "open" not in alone["damping_not_identifiable", "z"].evidence
    assert alone["input_not_identifiable", "z"].remedy == "fly faster changes of the command"
