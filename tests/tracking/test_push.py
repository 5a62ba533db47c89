"""The size of a push: its interval holds it, however fast the autopilot learns it; and what only looks like a push."""

from dataclasses import replace

import numpy as np
import pytest

from rotorfit.estimation.likelihood.block_response import response
from rotorfit.estimation.likelihood.likelihood import whiten
from rotorfit.tracking.change_watch import STRONG
from rotorfit.tracking.push import odds_of_a_push, push_interval
from rotorfit.tracking.refits import GroupEstimate, refitted
from rotorfit.tracking.scores import EXPECTED, Scores, scores_of
from tracked_flights import LAW, alarms, known_flight

pytestmark = pytest.mark.flights

FLIGHTS, AGO = 20, 1.5
PUSH = -1.3
"""First acceleration of the push [m/s^2], and how long ago it came [s]."""


@pytest.fixture(scope="module")
def followed() -> GroupEstimate:
    return refitted(known_flight(), ("z",), LAW, 30.0)


@pytest.fixture(scope="module")
def scores(followed: GroupEstimate) -> Scores:
    """Those of z, 30 s."""
    return scores_of([(list(followed.estimates.items()), {})])[0]


def whitened(followed: GroupEstimate, begun: float, learns: float) -> np.ndarray:
    """The whitened position after the push, integrated step by step."""
    optimum = followed.estimates["z"].optimum
    (rec,), point = followed.estimates["z"].records, optimum.point
    damping, fine = float(np.exp(point.log_damping[0])), 1e-3
    t = np.arange(0.0, rec.block_time[-1] - begun + fine, fine)
    velocity, position = np.zeros(t.size), np.zeros(t.size)
    for k in range(1, t.size):
        velocity[k] = velocity[k - 1] + fine * (PUSH * np.exp(-t[k - 1] / learns) - damping * velocity[k - 1])
        position[k] = position[k - 1] + fine * velocity[k - 1]
    column = np.interp(rec.block_time - begun, t, position, left=0.0)
    shape = response(rec, point, 0, point.start)[0].shape
    return np.asarray(whiten(rec, column.reshape(shape)[:, None], point.levels)[0][:, 0].ravel())


@pytest.mark.parametrize("learns", [0.2, 0.7, 1.7])
def test_the_interval_holds_a_push_however_fast_it_is_learnt(
    followed: GroupEstimate, scores: Scores, learns: float
) -> None:
    rng, begun = np.random.default_rng(12), float(scores.time[-1]) - AGO
    pushed = whitened(followed, begun, learns)
    found = [
        push_interval(replace(scores, innovation=rng.standard_normal(pushed.size) + pushed), (begun - 0.2, begun + 0.2))
        for _ in range(FLIGHTS)
    ]

    assert sum(low <= PUSH <= high for low, high in found) >= 0.9 * FLIGHTS
    assert np.median([high for _, high in found]) < 0.4 * PUSH


@pytest.mark.parametrize("learns", [0.2, 0.7, 1.7])
def test_a_push_is_told_from_a_delay(followed: GroupEstimate, scores: Scores, learns: float) -> None:
    rng, begun = np.random.default_rng(13), float(scores.time[-1]) - AGO
    pushed = whitened(followed, begun, learns)
    later = 0.1 / EXPECTED["delay"] * scores.begun(begun, 0.1)[:, scores.names.index("z.delay")]
    noise = rng.standard_normal((FLIGHTS, pushed.size))
    odds = [
        [odds_of_a_push(replace(scores, innovation=one + change), (begun - 0.2, begun + 0.2)) for one in noise]
        for change in (pushed, later)
    ]

    assert min(odds[0]) > STRONG
    assert max(odds[1]) < -STRONG


def test_a_delay_in_still_air_that_looks_like_a_push_is_named_by_the_revision() -> None:
    first, revised = alarms("delay", "tello", loop="open", gusts=0.0)

    assert (first.cause, revised.cause, revised.axes) == ("thrust", "delay", ("x", "y", "z", "yaw"))
    assert first.confidence < 0.9 < revised.confidence
    assert "or it was no push" in first.why
    assert all(low <= 0.05 <= high for low, high in revised.change.values())


def test_a_payload_in_flight_has_the_size_of_its_first_push() -> None:
    """15 % more mass: 9.81 (1 / 1.15 - 1) m/s^2. Nothing else of z is said to have changed: it follows the push."""
    change = alarms("picked_up", "tello", seed=1, at=18.0)[-1].change

    assert change.keys() == {"z.trim"}
    low, high = change["z.trim"]
    assert low <= 9.81 * (1 / 1.15 - 1) <= high < 0.0
