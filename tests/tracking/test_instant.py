"""The instant of a change: its interval holds it, for a shift of coefficients and for a push that fades."""

from dataclasses import replace

import numpy as np
import pytest

from rotorfit.tracking.instant import changed_when
from rotorfit.tracking.refits import refitted
from rotorfit.tracking.scores import LASTS, Scores, scores_of
from tracked_flights import LAW, alarms, known_flight

pytestmark = pytest.mark.flights

FLIGHTS = 40


@pytest.fixture(scope="module")
def scores() -> Scores:
    """Those of z, 30 s."""
    followed = refitted(known_flight(), ("z",), LAW, 30.0)
    return scores_of([(list(followed.estimates.items()), {})])[0]


def held(scores: Scores, ago: float, shift: np.ndarray) -> tuple[int, float]:
    """How many of `FLIGHTS` intervals hold an instant some time ago [s], and their median width [s]."""
    rng, begun = np.random.default_rng(11), float(scores.time[-1]) - ago
    found = []
    for _ in range(FLIGHTS):
        innovation = rng.standard_normal(scores.time.size) + shift
        low, high = changed_when(replace(scores, innovation=innovation), begun - 3.0)[1]
        found.append((low <= begun <= high, high - low))
    return sum(one for one, _ in found), float(np.median([width for _, width in found]))


def test_the_interval_holds_the_instant_at_which_a_coefficient_moved(scores: Scores) -> None:
    begun = float(scores.time[-1]) - 6.0
    moved = scores.tested[:, scores.names.index("z.input")] * (scores.time >= begun)
    (count, wide), (again, narrow) = held(scores, 6.0, 0.5 * moved), held(scores, 6.0, 5.0 * moved)

    assert min(count, again) >= 0.85 * FLIGHTS
    assert narrow < wide


@pytest.mark.parametrize("ago", [0.6, 2.5])
def test_the_interval_holds_the_instant_of_a_push_that_fades(scores: Scores, ago: float) -> None:
    """Soon after it, and when much of it has faded."""
    shape = scores.jolts[int(np.searchsorted(scores.time, scores.time[-1] - LASTS)) :, 0]
    first = int(np.searchsorted(scores.time, scores.time[-1] - ago))
    push = np.zeros(scores.time.size)
    push[first:] = 10.0 * shape[: push.size - first] / np.linalg.norm(shape)
    count, width = held(scores, ago, push)

    assert count >= 0.85 * FLIGHTS
    assert width < 1.0


def test_a_payload_that_comes_just_as_watching_begins_is_dated_and_its_vehicle_learnt_after_it() -> None:
    """The jolt is half of all that a short flight has told of z: a regime that contained it would learn from it."""
    alarm = alarms("picked_up", "tello", seed=1, at=18.0)[-1]

    assert alarm.cause == "payload"
    assert alarm.since[0] <= 18.0 <= alarm.since[1]
    assert alarm.since[1] - alarm.since[0] < 1.0
