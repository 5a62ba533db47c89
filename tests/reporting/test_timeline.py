"""The page about a tracked flight: what is known, what was raised, how to go on; whatever a log says is escaped."""

import base64
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_views import known_model

from flights import flown
from rotorfit.core.finding import Finding
from rotorfit.core.flight_data import Flight
from rotorfit.core.tracked import QUANTITIES, Air, Alarm, Regime, Track, Tracked, TrackedAxis
from rotorfit.reporting import write_timeline
from rotorfit.reporting.drawing import draw_chart
from rotorfit.reporting.panels import packed
from rotorfit.reporting.timeline import timeline_page
from rotorfit.reporting.views import Chart, Line
from rotorfit.tracking.flight_so_far import UNRECORDED

ALARM = Alarm(
    20.0, ("x", "y"), "limits", (17.5, 18.5),
    {"x.input": (0.78, 0.86), "y.input": (0.78, 0.86), "z.delay": (-0.02, 0.05)}, 0.97, 1e-9, "because <b>it</b> did",
)  # fmt: skip


def known(gain: float, wide: float) -> TrackedAxis:
    values = dict.fromkeys(QUANTITIES) | {"input": gain, "damping": 0.5, "delay": 0.15}
    ends = {"input": (gain - wide, gain + wide), "damping": (0.4, 0.6), "delay": (0.14, None)}
    return TrackedAxis("known", "known", values, ends, ends, "first_order_delay", 0.1, (0.0, 0.2))


@pytest.fixture(scope="module")
def flight() -> Flight:
    return replace(flown(duration=6.0), path="<script>.csv")


@pytest.fixture(scope="module")
def track() -> Track:
    """Known from 8 s on; at 18 s the gain falls, which is told at 20 s; yaw is never moved."""
    states = []
    for second in range(5, 41):
        axis = known(3.0 if second < 20 else 2.4, 400.0 if second < 10 else 2.0 / second)
        unmoved = TrackedAxis("not_excited", "not excited: no command moves it")
        axes = {"x": axis if second > 7 else TrackedAxis(), "y": axis if second > 7 else TrackedAxis(), "yaw": unmoved}
        states.append(Tracked(float(second), axes, (ALARM,) if second == 20 else (), int(second >= 20)))
    return Track(tuple(states), (Regime(0.0, 18.0, None), Regime(18.0, 40.0, None, ALARM)))


def test_the_page_says_what_is_known_and_what_changed(track: Track, flight: Flight) -> None:
    page = timeline_page(track, flight)

    assert "x and y are known; one alarm, at 20.00 s: limits." in page
    assert "input gain of x and y 0.78 to 0.86 times what it was; delay of z by −20 to +50 ms" in page
    assert "17.5 to 18.5 s" in page
    assert "97 % of the evidence" in page
    assert re.search(r'<td class="number strong">2\.400</td><td class="number">2\.350 to 2\.450</td>', page)
    assert "Too short, or too little commanded" in page


def test_the_page_says_what_is_wrong_with_the_data(track: Track, flight: Flight) -> None:
    off = Finding("yaw_offset", "warning", "x acts 30 degrees off", "too small", "turn the heading")
    last = replace(track.states[-1], findings=(off,))

    assert "x acts 30 degrees off; turn the heading" in timeline_page(replace(track, states=(last,)), flight)


def test_the_mean_wind_is_told_where_it_is_known(track: Track, flight: Flight) -> None:
    air = Air(3.0, (2.8, 3.2), -0.5, (-0.6, -0.4))
    windy = replace(track, states=(*track.states[:-1], replace(track.states[-1], air=air)))

    said = "3.00 m/s (2.80 to 3.20) towards −29° (−34 to −23°) from the world&#39;s x, counter-clockwise."
    assert said in timeline_page(windy, flight)
    assert "Mean wind" not in timeline_page(track, flight)

    still = replace(air, speed=0.01, speed_ci95=(0.0, 0.031))
    calm = replace(track, states=(*track.states[:-1], replace(track.states[-1], air=still)))
    assert "Mean wind of at most the last 40 s: below 0.03" in timeline_page(calm, flight)
    assert "towards" not in timeline_page(calm, flight)


def test_nothing_of_a_log_or_an_alarm_is_html_and_nothing_is_fetched(track: Track, flight: Flight) -> None:
    page = timeline_page(track, flight)

    assert "<script>.csv" not in page
    assert "Because &lt;b&gt;it&lt;/b&gt; did." in page
    assert not re.findall(r'(?:src|href)="(?!#)', page)


def test_charts_are_scaled_to_what_is_known_and_carry_alarms_and_regimes(track: Track, flight: Flight) -> None:
    page = timeline_page(track, flight)
    found = re.search(r'<script type="application/json" id="series">(.*?)</script>', page)
    assert found
    charts = json.loads(found[1])[0]["charts"]

    assert len(charts) == 2 * 4  # input, damping, delay and wind of the axes that commands moved
    low, high = charts[0]["range"]
    assert 1.5 < low < 2.4
    assert 3.0 < high < 4.0
    assert charts[0]["moments"] == [20.0]
    assert charts[0]["apart"] == [[18.0, 40.0]]
    assert [line["role"] for line in charts[0]["lines"]] == ["model", "end", "end"]
    assert page.count('class="moment"') == len(charts)


def test_the_lines_to_type_name_the_last_model_that_there_is(track: Track, flight: Flight) -> None:
    page = timeline_page(track, flight, [Path("a b-1.json"), None])

    assert "rotorfit validate &#39;a b-1.json&#39; NEXT-FLIGHT.csv" in page
    assert "There is no model to go on with" in timeline_page(track, flight)


def test_a_page_says_which_seconds_were_no_longer_remembered(track: Track, flight: Flight) -> None:
    first = replace(track.regimes[0], model=known_model(), data=(2.0, 17.5), remembered=25.0)
    page = timeline_page(replace(track, regimes=(first, track.regimes[1])), flight)

    assert "Seconds before 25.0 were no longer remembered at the end: model from 2.0 to 17.5 s." in page
    assert "fitted to all of the flight that is remembered" in page
    assert "that no alarm names are fitted to the whole flight" in timeline_page(track, flight)
    gone = replace(first, model=None, data=None)
    page = timeline_page(replace(track, regimes=(gone,)), flight)
    assert "Seconds before 25.0 were no longer remembered at the end: no model." in page
    assert "Too short, or" not in page


def test_a_flight_is_tracked_again_as_it_was(track: Track, flight: Flight) -> None:
    again = ["a.csv@2:9", "--card", "my.toml", "--structure", "first_order"]
    regimes = tuple(replace(one, model=known_model()) for one in track.regimes)
    page = timeline_page(replace(track, regimes=regimes), flight, (), again)
    assert "rotorfit track a.csv@2:9 --card my.toml --structure first_order -o model.json" in page
    assert "rotorfit plan --after" in page
    assert 'x: input gain <span class="muted">[m/s² per command]</span>' in page

    world = replace(flight, card=replace(flight.card, command_frame="world"))
    assert "rotorfit plan" not in timeline_page(replace(track, regimes=regimes), world, (), again)


def test_a_live_flight_that_was_not_recorded_is_not_named_as_a_log(track: Track, flight: Flight) -> None:
    page = timeline_page(track, replace(flight, path=UNRECORDED))

    assert "next time add -o model.json or --record flight.mcap" in page
    assert "rotorfit track" not in page


def test_a_flight_that_told_nothing_has_a_page_all_the_same(flight: Flight, tmp_path: Path) -> None:
    nothing = Track((Tracked(3.0, {"x": TrackedAxis()}),), (Regime(0.0, 3.0, None),))

    assert write_timeline(nothing, flight, tmp_path / "track.html") is None
    page = (tmp_path / "track.html").read_text(encoding="utf-8")
    assert "x is not known yet; no alarm." in page
    assert "Watched for changes: x never." in page
    assert "Nothing was identified at any time." in page
    assert write_timeline(nothing, flight, tmp_path / "track.html") is None  # the same page: nothing to keep


def test_a_chart_says_from_when_a_value_was_told_or_that_it_was_told_once(flight: Flight) -> None:
    states = [
        Tracked(float(second), {"x": known(3.0, 0.1) if second > 7 else TrackedAxis(), "y": TrackedAxis()}, ())
        for second in range(5, 21)
    ]
    states[-2] = replace(states[-2], axes={"x": known(3.0, 0.1), "y": known(2.0, 0.1)})
    page = timeline_page(Track(tuple(states), (Regime(0.0, 20.0, None),)), flight)

    assert "From 8 s on; at 20 s 3 m/s² per command." in page
    assert "Only at 19 s: 2 m/s² per command." in page


def test_a_value_that_is_told_once_is_seen() -> None:
    """A line of one point is nothing: it becomes a dash of four units."""
    lone = Line("x", "model", np.array([1.0, np.nan, 2.0, np.nan]))
    chart = Chart("timeline", "x", "x", "t", "y", np.arange(4.0), (lone,), "", "", y_range=(0.0, 3.0))

    path = draw_chart(chart, 300, 200).paths[0][1]
    assert path.count("m") == path.count("l16 0") == 2


def test_an_end_beyond_what_a_page_can_hold_is_drawn_at_its_edge_and_a_hole_stays_one() -> None:
    sent = np.frombuffer(base64.b64decode(packed(np.array([1e300, -1e300, np.nan, 2.5]))), "<f4")

    assert sent[0] == -sent[1] == np.finfo(np.float32).max
    assert np.isnan(sent[2])
    assert sent[3] == 2.5
