"""The summary of a fit: plain words that say no more than the statuses and findings do."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from rotorfit.assessment.summary import summary_of_model
from rotorfit.core.finding import Finding, Severity
from rotorfit.core.frames import AXES
from rotorfit.core.model import COEFFICIENTS, Axis, Combination, Model, Predictor, Source, unknown_axis
from rotorfit.files.cards import load_card


def axis(combinations: dict[str, Combination] | None = None, **status: str) -> Axis:
    """An axis with numbers, every coefficient of it known unless a status says otherwise."""
    return Axis(
        input=4.0,
        damping=0.2,
        delay=0.1,
        stderr=dict.fromkeys(COEFFICIENTS, 0.01),
        ci95=dict.fromkeys(COEFFICIENTS, (0.0, 1.0)),
        status=dict.fromkeys(COEFFICIENTS, "ok") | status,
        predictor=Predictor(4.0, 0.2, 0.1),
        combinations=combinations or {},
    )


def model(axes: dict[str, Axis], findings: Sequence[Finding] = (), method: str = "ml", flights: int = 1) -> Model:
    return Model(
        card=load_card("bebop2"),
        structure="first_order_delay",
        method=method,
        axes={name: axes.get(name, unknown_axis("not_excited")) for name in AXES},
        covariance_names=(),
        covariance=np.zeros((0, 0)),
        paper=(None,) * 8,
        findings=tuple(findings),
        flights=(Source("flight.bag", "0" * 64, (0.0, 30.0)),) * flights,
    )


def finding(severity: Severity, name: str | None) -> Finding:
    return Finding("code", severity, "evidence", "effect", "remedy", name)


def test_what_is_known_and_what_is_not_is_listed_by_axis() -> None:
    found = summary_of_model(model({"x": axis(), "y": axis()}))

    assert found.startswith(
        "Fitted to 1 flight of 30 s by maximum likelihood. Known: input gain, damping and delay of x and y."
    )
    assert "No numbers: no flight excites z or yaw." in found


def test_an_axis_whose_command_the_card_does_not_name_is_not_said_to_rest() -> None:
    known = model({"x": axis(), "y": axis()})
    card = replace(known.card, command={name: one for name, one in known.card.command.items() if name != "yaw"})

    found = summary_of_model(replace(known, card=card))
    assert "No numbers: no flight excites z; the card names no command for yaw." in found


def test_only_who_has_not_validated_is_asked_to() -> None:
    known = model({"x": axis()})

    assert summary_of_model(known).endswith(" Validate it on a flight that was not fitted.")
    assert "Validate" not in summary_of_model(known, validated=True)
    assert "Validate" not in summary_of_model(model({}))


def test_axes_that_were_not_asked_for_are_passed_over() -> None:
    found = summary_of_model(model({"x": axis()}, [finding("error", "z")]), axes=("x",))

    assert "No numbers" not in found
    assert "Do not use" not in found


def test_a_combination_that_is_known_stands_in_for_its_parts() -> None:
    parts = {"steady_gain": Combination(0.97, (0.95, 1.0)), "total_lag": Combination(0.15, (None, None))}

    found = summary_of_model(model({"z": axis(parts, damping="not_identifiable")}), axes=("z",))

    assert (
        "Known of z: input gain and delay; damping cannot be identified from these data, "
        "but steady gain 0.970 (0.950 to 1.000) is." in found
    )
    assert "total lag" not in found


def test_a_combination_of_an_axis_that_must_not_be_used_does_not_stand_in_for_its_parts() -> None:
    parts = {"steady_gain": Combination(1.5, (1.4, 1.6))}

    found = summary_of_model(
        model({"z": axis(parts, damping="not_identifiable")}, [finding("error", "z")]), axes=("z",)
    )

    assert "steady gain" not in found
    assert "Do not use z" in found


def test_a_time_whose_interval_begins_near_zero_is_told_and_a_gain_of_such_a_ratio_is_not() -> None:
    parts = {"steady_gain": Combination(1.0, (0.01, 5.0)), "total_lag": Combination(0.15, (0.01, 0.3))}

    found = summary_of_model(model({"z": axis(parts, damping="not_identifiable")}), axes=("z",))

    assert "but total lag 0.15 (0.01 to 0.30) is." in found


def test_a_combination_has_the_digits_that_its_interval_deserves() -> None:
    parts = {"offset_plus_delay": Combination(-1772699982.649, (-1772699982.71, -1772699982.6))}

    found = summary_of_model(model({"z": axis(parts, delay="not_identifiable")}), axes=("z",))

    assert "but offset plus delay -1772699982.649 (-1772699982.710 to -1772699982.600) is." in found


def test_a_time_known_to_no_better_than_itself_is_not_told() -> None:
    parts = {"steady_gain": Combination(0.97, (0.95, 1.0)), "total_lag": Combination(5.8, (-3.2, 14.6))}

    found = summary_of_model(model({"z": axis(parts, damping="not_identifiable")}), axes=("z",))

    assert "total lag" not in found


@pytest.mark.parametrize(
    ("status", "words"), [("too_short", "the flights are too short for x"), ("diverged", "x did not converge")]
)
def test_an_axis_without_numbers_says_why(status: str, words: str) -> None:
    found = summary_of_model(model({"x": unknown_axis(status)}), axes=("x",))

    assert words in found
    assert "was not fitted" not in found


def test_different_reasons_stand_in_one_sentence() -> None:
    found = summary_of_model(model({"x": axis(), "y": unknown_axis("diverged")}))

    assert "No numbers: no flight excites z or yaw; the estimation of y did not converge." in found


def test_several_flights_and_the_papers_method_are_named() -> None:
    found = summary_of_model(model({"x": axis(delay="not_identifiable")}, method="paper", flights=3), axes=("x",))

    assert found.startswith("Fitted to 3 flights, 90 s in all, by the paper's regression, without delay.")
    assert "Known: input gain and damping of x." in found


def test_errors_forbid_the_use_of_their_axis_and_warnings_are_counted() -> None:
    findings = [finding("error", "x"), finding("warning", "y"), finding("warning", None), finding("info", "y")]

    found = summary_of_model(model({"x": axis(), "y": axis()}, findings))

    assert "Do not use x before you have read the findings. 2 findings are warnings." in found


def test_an_error_of_the_whole_flight_forbids_every_axis_that_has_numbers() -> None:
    found = summary_of_model(model({"x": axis(), "z": axis()}, [finding("error", None)]))

    assert "Do not use x and z before you have read the findings." in found


def test_a_law_without_a_delay_does_not_make_it_known() -> None:
    undelayed = replace(axis(), structure="first_order", delay=0.0, predictor=Predictor(4.0, 0.2, 0.0))

    assert "Known of x: input gain and damping; its law has no delay." in summary_of_model(model({"x": undelayed}))


def test_axes_of_which_the_same_is_known_share_a_sentence() -> None:
    found = summary_of_model(model({"x": axis(), "y": axis(delay="refuted"), "z": axis(delay="refuted")}))

    assert found.count("Known of") == 1
    assert "Known of y and z: input gain and damping; delay is refuted: the flights deny the law." in found


def test_of_a_refuted_law_what_is_known_in_spite_of_it_is_told() -> None:
    narrow = {"steady_gain": Combination(0.9, (0.8, 1.0)), "total_lag": Combination(0.5, (0.4, 0.6))}
    found = summary_of_model(model({"x": axis(narrow, input="refuted", damping="refuted")}))

    assert (
        "input gain and damping are refuted: the flights deny the law; steady gain 0.90 (0.80 to 1.00) is known."
        in found
    )


def test_a_wrong_frame_of_the_plane_is_the_reason_and_spoils_nothing_else() -> None:
    exchanged = replace(finding("error", None), code="axes_exchanged")

    flown = replace(
        model({"z": axis(), "yaw": axis()}, [exchanged]), flights=(Source("a.bag", "0" * 64, (0.0, 30.0), axes=AXES),)
    )

    found = summary_of_model(flown)
    assert "No numbers: the card reads x and y in a wrong frame." in found
    assert "Do not use x and y before you have read the findings." in found
    still = replace(flown, flights=(replace(flown.flights[0], axes=("x", "z", "yaw")),))
    assert "No numbers: no flight excites y; the card reads x in a wrong frame." in summary_of_model(still)
