"""Several models on the same flights: what may be subtracted from what, and what must be said beside it."""

from dataclasses import replace
from functools import cache

import pytest

from flights import CARD, fit_as_flown, flown, steps
from rotorfit.app.comparison import Comparison, compare_models
from rotorfit.app.workflows import cases_of_models
from rotorfit.assessment.case import Case
from rotorfit.assessment.evidence import evidence_of
from rotorfit.assessment.validation import to_mapping, validate, validate_chosen
from rotorfit.core.flight_data import Flight
from rotorfit.core.model import Model, unknown_axis
from rotorfit.core.results import Paired
from rotorfit.dynamics.other_limits import convert
from rotorfit.exports.validity import scores as validity_lines
from rotorfit.files.cards import card_from_mapping
from rotorfit.reporting.side_by_side import leads
from rotorfit.reporting.verdict import verdict_on
from rotorfit.simulation.paper_vehicle import Truth

pytestmark = pytest.mark.flights


@cache
def turning() -> Flight:
    return flown(Truth(), steps(seed=2), 12.0, 2)


@cache
def known() -> Model:
    return fit_as_flown([flown(Truth(), steps(seed=1), 20.0, 1)]).model


def without(*axes: str) -> Model:
    """The same coefficients, and nothing known of some axes."""
    return replace(known(), axes={**known().axes, **{axis: unknown_axis("not_excited") for axis in axes}})


def compared(*models: Model, flights: tuple[Flight, ...] = ()) -> Comparison:
    return compare_models([f"{n}.json" for n in range(len(models))], models, flights or (turning(),), horizons=(1.0,))


def difference(found: Comparison, axis: str, first: str, second: str) -> Paired:
    (test,) = (one for one in found.paired if (one.first, one.second) == (first, second))
    return test.axes[axis]["1"]["velocity"]


def test_axes_that_turn_are_not_tested_where_one_model_is_told_the_heading() -> None:
    found = compared(known(), without("yaw"))

    assert all(difference(found, axis, "model 2", "model 1").pooled is None for axis in ("x", "y"))
    assert difference(found, "z", "model 2", "model 1").pooled is not None
    (note,) = found.notes
    assert note.startswith("model 2: x and y are not tested against model 1 on ")
    assert note.endswith("model 1 predicts it, model 2 has no yaw and takes the recorded one")
    (note,) = compared(without("yaw"), known()).notes
    assert note.endswith("model 2 predicts it, model 1 has no yaw and takes the recorded one")


def test_where_the_heading_is_kept_they_are_tested() -> None:
    straight = flown(Truth(), steps(("x", "y"), seed=2), 12.0, 2)

    found = compared(known(), without("yaw"), flights=(straight,))
    assert difference(found, "x", "model 2", "model 1").pooled is not None
    assert found.notes == ()


def test_each_model_is_tested_against_its_own_baselines_whichever_comes_first() -> None:
    poor = replace(known(), paper=tuple(3 * value if value else value for value in known().paper))

    one, two = compared(known(), poor), compared(poor, known())
    for name in ("hold", "paper"):
        assert difference(one, "z", "model 1", name) == difference(two, "z", "model 2", name)
        assert difference(one, "z", "model 2", name) == difference(two, "z", "model 1", name)


def test_baselines_are_shown_of_the_first_model_that_knows_the_axis() -> None:
    found = compared(without("z"), known())

    (shown,) = found.baselines["paper"]
    assert shown.axes["z"] == found.validations[1].baselines["paper"][0].axes["z"]
    assert shown.axes["x"] == found.validations[0].baselines["paper"][0].axes["x"]


@pytest.mark.parametrize(("factor", "verdict"), [(1 + 1e-6, "no_difference_shown"), (1.3, "worse")])
def test_models_that_differ_by_less_than_a_search_leaves_are_the_same(factor: float, verdict: str) -> None:
    z = known().axes["z"]
    assert z.predictor is not None
    other = replace(z, predictor=replace(z.predictor, input=factor * z.predictor.input))

    flights = (flown(Truth(), steps(("z",), seed=2), 20.0, 2),)
    found = difference(
        compared(known(), replace(known(), axes={**known().axes, "z": other}), flights=flights),
        "z", "model 2", "model 1",
    ).pooled  # fmt: skip
    assert found is not None
    assert found.verdict == verdict
    assert found.rmse != 0


def test_cards_that_read_other_commands_from_a_log_are_told() -> None:
    slower = convert(known(), {"vertical_speed": 0.5})

    found = compared(known(), slower)
    assert found.notes == (
        "model 2 was converted: it is for flights under its new limits",
        "model 2: by its card a command of 1 on z asks for something else than by that of model 1, or under other "
        "limits: of one log only one of them is true",
    )


def test_the_report_says_likewise_that_an_axis_is_not_tested() -> None:
    cases, notes = cases_of_models(["all.json", "flat.json"], [known(), without("yaw")], [turning()])

    assert notes[-1].startswith("flat.json: x and y are not tested against all.json on ")
    told = {lead.axis: lead.reason for lead in leads(evidence_of(cases), 1.0)}
    assert told["x"] == "leads; not tested, for only one of the two is told where the vehicle turns"
    assert "not tested" not in told["z"]


def test_scores_of_a_converted_model_say_wherever_they_stand_that_the_limits_are_its_new_ones() -> None:
    """Nothing says under which limits a log without a card was flown."""
    slower = convert(known(), {"vertical_speed": 0.5})
    flight = replace(turning(), card=slower.card)
    found = validate_chosen(slower, [flight], assumed=True)

    (told,) = (one for one in found.findings if one.code == "converted")
    assert told.axis == "z"
    assert "limit of 0.5 m/s, not of 1.2 m/s" in told.evidence
    assert told in found.before_scores
    assert any("z: the model was converted" in line for line in validity_lines(to_mapping(found), ("x", "z")))
    assert not any("converted" in line for line in validity_lines(to_mapping(found), ("x",)))
    verdict = verdict_on(evidence_of([Case("slower.json", slower, (), found, (flight,))])[0])
    assert verdict.lights[2].word == "not proven"
    assert any(one.startswith("z: score the model on flights under its new limits") for one in verdict.advice)
    assert not any("noise" in one and "z" in one.partition(":")[0] for one in verdict.advice)


@pytest.mark.parametrize(("limits", "told"), [("new", False), ("old", True)])
def test_who_names_the_card_of_a_flight_says_under_which_limits_it_was_flown(limits: str, told: bool) -> None:
    slower = convert(known(), {"vertical_speed": 0.5})
    flight = replace(turning(), card=slower.card if limits == "new" else known().card)

    assert bool([one for one in validate(slower, [flight], (1.0,)).findings if one.code == "converted"]) == told


def test_each_model_is_pooled_over_the_flights_that_it_was_not_fitted_to_whichever_comes_first() -> None:
    flights = tuple(
        replace(flown(Truth(), steps(("z",), seed=n), 12.0, n), path=f"{n}.bag", sha256=str(n)) for n in (4, 5, 6)
    )
    first, second = (fit_as_flown([flight], axes=("z",)).model for flight in flights[:2])

    one, two = compared(first, second, flights=flights), compared(second, first, flights=flights)
    for name in ("hold", "paper"):
        assert difference(one, "z", "model 1", name) == difference(two, "z", "model 2", name)
    assert difference(one, "z", "model 1", "hold").pooled_flights == (1, 2)
    assert difference(one, "z", "model 2", "hold").pooled_flights == (0, 2)
    assert difference(one, "z", "model 2", "model 1").pooled_flights == (2,)
    assert [note for note in one.notes if "model 2 vs model 1 over 1 flight, " in note]
    assert [note for note in one.notes if "model 1 vs hold, model 1 vs paper over 2 flights, 5.bag, " in note]
    assert not [note for note in compared(first, first, flights=flights).notes if "not all are pooled" in note]


def test_an_axis_that_the_model_does_not_know_has_no_baseline_of_the_paper() -> None:
    (validation,) = compared(without("yaw")).validations

    assert validation.baselines["paper"][0].heading == validation.flights[0].heading == "measured"
    for name in ("paper", "coast"):
        assert validation.baselines[name][0].axes["yaw"].horizons["1"].n == 0
        assert difference(compared(without("yaw")), "x", "model 1", "paper").pooled is not None


def test_a_card_that_does_not_say_what_commands_mean_contradicts_none() -> None:
    silent = card_from_mapping({key: value for key, value in CARD.raw.items() if key != "limits"}, "silent")

    assert compared(known(), replace(known(), card=silent)).notes == ()
