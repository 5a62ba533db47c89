"""What the last seconds say of the air: risen gusts are heard on all axes, a payload is none; brakes say nothing."""

from dataclasses import replace

import numpy as np
import pytest

from rotorfit.core.flight_data import Segment
from rotorfit.tracking.refits import applied, refitted
from rotorfit.tracking.replayed import until
from rotorfit.tracking.scores import BRAKES, TILTING, Scores, Sticks, scores_of, sticks_of
from tracked_flights import LAW, changing, known_flight

pytestmark = pytest.mark.flights

LEARNT = 20.0
"""When it changes [s]."""

AT = np.array([12.0])


def scored(cause: str, after: float) -> dict[str, Scores]:
    """Scores of a flight of the room some time after its change, under what was learnt before, by axis."""
    room = changing()
    flight = room.changing_flight(2, room.Scenario(cause, gusts=0.3, duration=LEARNT + after, time=LEARNT)).flight
    groups = [refitted(until(flight, LEARNT), axes, LAW, LEARNT) for axes in (("x", "y"), ("z",), ("yaw",))]
    parts = [(list(applied(one, flight).estimates.items()), {}) for one in groups]
    return {one.names[0].partition(".")[0]: one for one in scores_of(parts)}


def test_gusts_that_have_risen_are_heard_on_all_axes() -> None:
    found = scored("wind", 10.0)

    assert found["z"].gusts >= 2  # four times as much power or more; it is sixteen times as much
    assert found["yaw"].gusts >= 2
    assert len(found["z"].under_gusts) >= found["z"].gusts
    late = found["z"].time > LEARNT + 5.0
    strong = found["z"].under_gusts[found["z"].gusts - 1]
    assert np.mean(strong.innovation[late] ** 2) < 1.5 < np.mean(found["z"].innovation[late] ** 2)


@pytest.mark.parametrize("cause", ["picked_up", "propeller"])
def test_a_payload_or_a_weak_propeller_is_no_gust(cause: str) -> None:
    assert {axis: one.gusts for axis, one in scored(cause, 1.0).items()} == {"x": 0, "z": 0, "yaw": 0}


@pytest.mark.parametrize(("sticks", "lasts"), [(Sticks(let_go=AT), BRAKES), (Sticks(steep=AT), TILTING)])
def test_nothing_is_asked_of_the_height_while_a_vehicle_brakes_or_tilts(sticks: Sticks, lasts: float) -> None:
    flight = known_flight()
    one = list(refitted(flight, ("z",), LAW, 30.0).estimates.items())
    (before,), (after,) = scores_of([(one, {})]), scores_of([(one, {})], sticks)
    silent = (after.time >= AT[0]) & (after.time < AT[0] + lasts)

    assert not after.rows[silent].any()
    assert np.array_equal(after.rows[~silent], before.rows[~silent])


def test_an_answer_that_begins_while_the_vehicle_brakes_tells_nothing_of_x_and_y() -> None:
    """Answers begin with their stick: at 3 s, with nothing before it, and at 7.5 s, half a second after a let-go."""
    answers = [(3.0, 6.5), (7.5, 11.0)]
    parts = replace(known_flight(), segments=tuple(Segment(*span) for span in answers))
    sticks = Sticks(let_go=np.array([2.5, 7.0]), steep=np.array([9.0]))
    (scores,) = scores_of([(list(refitted(parts, ("x",), LAW, 30.0).estimates.items()), {})], sticks)
    told = scores.rows.any(axis=1)

    assert told[scores.time < 6.5].all()
    assert not told[(scores.time > 7.5) & (scores.time < 7.0 + BRAKES)].any()
    assert told[scores.time > 7.0 + BRAKES].all()


def test_an_answer_may_differ_from_the_law_by_what_no_pilot_would_notice() -> None:
    one = list(refitted(known_flight(), ("z",), LAW, 30.0).estimates.items())
    (scores,) = scores_of([(one, {"z": {"delay": 0.1}})])

    assert dict(zip(scores.names, scores.doubt * scores.scale, strict=True)) == pytest.approx(
        {"z.input": 0.015, "z.damping": 0.0, "z.delay": 0.1, "z.trim": 0.015}
    )


def test_sticks_are_let_go_where_both_become_zero() -> None:
    command = np.array(
        [[0, 0, 1, 0], [1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1], [0, 0, 0, 0], [1, 1, 0, 0], [0, 0, 0, 0]]
    )
    flight = known_flight()
    part = replace(flight, command_time=np.arange(7.0), command=command.astype(float))

    assert sticks_of(part, []).let_go.tolist() == [3.0, 6.0]


def test_commands_are_steep_where_they_change_the_acceleration_of_both_axes_at_once() -> None:
    """Within a tenth of a second, whatever the rate of commands; slower ones are not steep, however large."""
    flight = known_flight()
    estimates = refitted(flight, ("x", "y"), LAW, 30.0).estimates
    unit = 1.0 / np.array([one.optimum.point.gain[one.place] for one in estimates.values()])  # 1 m/s^2
    rise = np.concatenate([np.linspace(0.0, 1.3, 6), np.full(10, 1.3), np.linspace(1.3, 0.0, 40)])
    command = np.zeros((rise.size, 4))
    command[:, :2] = rise[:, None] * unit
    part = replace(flight, command_time=0.02 * np.arange(rise.size), command=command)

    both = sticks_of(part, [(list(estimates.items()), {})]).steep
    assert (both[0], both[-1]) == pytest.approx((0.1, 0.12))
    assert not sticks_of(part, [([("x", estimates["x"])], {})]).steep.size
