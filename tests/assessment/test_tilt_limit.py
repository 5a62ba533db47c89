"""A velocity loop at its tilt limit: told where the limit shows, and only there."""

from dataclasses import replace
from typing import cast

import pytest

from flights import fit_as_flown
from limited_flights import BOUND, POINTS, flown
from models import demo_card, model_of
from rotorfit.assessment.advice import findings_of_fit
from rotorfit.assessment.tilt_limit import findings_of_tilt
from rotorfit.core.card import Card
from rotorfit.core.finding import Finding
from rotorfit.core.flight_data import Flight
from rotorfit.core.model import Evidence
from rotorfit.core.results import Fit


def card(meaning: str = "velocity", full_scale: str = "speed", limits: str = "tilt = 0.34907\nspeed = 3.0") -> Card:
    asked = f'meaning = "{meaning}", full_scale = "{full_scale}"'
    return demo_card(limits, **{k: f'{{ from = "/cmd_vel:twist.linear.{k}", {asked} }}' for k in POINTS})


def found(flight: Flight, of: Card | None = None, **status: str) -> dict[str | None, Finding]:
    model = model_of(POINTS, of or card())
    axes = {name: replace(one, status={**one.status, **status}) for name, one in model.axes.items()}
    fit = cast("Fit", type("Fitted", (), {"model": replace(model, axes=axes), "flights": (flight,)}))
    return {finding.axis: finding for finding in findings_of_tilt(fit)}


def test_steps_that_ask_for_more_than_the_tilt_limit_gives_are_told_of_each_axis() -> None:
    told = found(flown(0.8, BOUND))

    assert {axis: one.severity for axis, one in told.items()} == {"x": "warning", "y": "warning"}
    assert "more acceleration than the 3.57 m/s^2 of the card's tilt limit, 20 deg" in told["x"].evidence
    assert "describe the limit, too" in told["x"].effect


def test_the_steps_that_are_proposed_stay_within_the_limit() -> None:
    remedy = found(flown(0.8, BOUND))["x"].remedy
    alone, together = (float(part.split()[0]) for part in remedy.split(" by ")[1:3])

    assert alone == pytest.approx(0.8 * BOUND / POINTS["x"][0], abs=0.006)
    assert found(flown(together / 2, BOUND)) == {}  # from one side of zero to the other


@pytest.mark.parametrize("wind", [0.0, 0.6])
def test_a_vehicle_that_tilts_further_than_its_card_says_is_not_accused(wind: float) -> None:
    assert found(flown(0.8, wind=wind)) == {}


def test_where_the_motion_does_not_show_whether_the_limit_acts_it_is_told_as_a_doubt() -> None:
    told = found(flown(0.6, BOUND, wind=0.6, duration=25.0))

    assert {one.severity for one in told.values()} == {"info"}
    assert told["x"].effect.startswith("if the vehicle obeys this limit, ")


def test_nothing_is_said_without_a_limit_a_velocity_loop_or_coefficients() -> None:
    flight = flown(0.8, BOUND)

    assert found(flight, card(limits="speed = 3.0\nyaw_rate = 1.0")) == {}
    assert found(flight, card("tilt", "tilt")) == {}
    assert found(flight, damping="not_identifiable") == {}
    assert set(found(flight, damping="refuted")) == {"x", "y"}
    assert found(flown(0.8, BOUND, duration=2.0)) == {}


def test_a_law_that_the_limit_refutes_is_to_be_fitted_to_smaller_steps_not_to_be_changed() -> None:
    fitted = fit_as_flown([replace(flown(0.8, BOUND), card=card())], axes=("x", "y"))
    doubt = Evidence("size", "small and large commands do not agree", 1e-6, {"input": 0.1})
    x = fitted.model.axes["x"]
    axes = {**fitted.model.axes, "x": replace(x, evidence=(doubt,), status=dict.fromkeys(x.status, "ok"))}
    told = {
        (one.code, one.axis): one for one in findings_of_fit(replace(fitted, model=replace(fitted.model, axes=axes)))
    }

    assert told["tilt_limit_reached", "x"].severity == "warning"
    assert told["law_doubted", "x"].remedy == told["tilt_limit_reached", "x"].remedy
