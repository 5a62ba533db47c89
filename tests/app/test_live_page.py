"""The live page in a real browser: whom it follows, what it says of numbers and bounds, and how charts are scaled."""

import time
from collections.abc import Iterator
from dataclasses import replace

import pytest
from playwright.sync_api import Browser, Page, expect
from test_studio_browser import CHROMIUM

from rotorfit.app.live.page_server import LivePage
from rotorfit.core.model import Interval
from rotorfit.core.tracked import QUANTITIES, Alarm, Tracked, TrackedAxis

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no chromium here: the live page is not tested in a browser")


@pytest.fixture
def live(browser: Browser) -> Iterator[tuple[LivePage, Page]]:
    """A page of a vehicle called sim,wind=1, and a browser that has opened it."""
    said: list[str] = []
    server = LivePage(0, "sim,wind=1", said.append)
    page = browser.new_page(viewport={"width": 1280, "height": 860})
    page.goto(said[0].split()[-1])
    yield server, page
    server.close()
    page.close()


def told(second: int, width: float) -> Tracked:
    """Input, lag and velocity are told, of the damping a bound, of the delay nothing."""
    values = dict.fromkeys(QUANTITIES) | {"input": 4.0, "lag": 0.12}
    ends: dict[str, Interval] = {"input": (4.0 - width, 4.0 + width), "damping": (None, 0.316), "lag": (0.1, None)}
    yaw = TrackedAxis("known", "known", values, ends, velocity=-0.116, gusts=0.0195)
    return Tracked(float(second), {"yaw": replace(yaw, wind=-0.000237, wind_ci95=(-0.164, 0.164))})


def test_the_page_names_whom_it_follows_and_says_numbers_with_units_and_bounds(live: tuple[LivePage, Page]) -> None:
    server, page = live
    expect(page).to_have_title("sim,wind=1 – rotorfit live")
    expect(page.locator("#vehicle")).to_have_text("sim,wind=1")

    server.state(told(1, 0.1), 0, 0)
    captions = page.locator("figcaption")
    expect(captions).to_have_text(
        [
            "input [rad/s²]4.00 (3.90 to 4.10)",
            "damping [1/s]below 0.316",
            "delay [s]unknown",
            "wind [rad/s²]0.00 (-0.16 to 0.16)",
        ]
    )
    expect(page.locator(".now")).to_have_text(
        "velocity -0.116 rad/s · gusts 0.0195 rad/s · not yet watched for changes"
    )
    expect(page.locator(".rest")).to_have_text("lag 0.120 s (above 0.100)")


def test_a_wild_second_flattens_no_chart_and_an_empty_one_has_no_scale(live: tuple[LivePage, Page]) -> None:
    server, page = live
    for second in range(1, 31):
        server.state(told(second, 0.1), 0, 0)
    server.state(told(31, 50.0), 0, 0)
    expect(page.locator("#time")).to_have_text("31 s")
    expect(page.locator("canvas")).to_have_count(4)

    low, high = page.evaluate("(({min, max}) => [min, max])(panels.get('yaw').parts.input.chart.scales.y)")
    assert 3.8 < low < 3.9
    assert 4.1 < high < 4.2
    assert page.evaluate("panels.get('yaw').parts.delay.chart.scales.y.max") is None


def test_gains_of_before_an_alarm_are_marked(live: tuple[LivePage, Page]) -> None:
    server, page = live
    gains = {"bandwidth": 2.0, "stiffness": 3.5, "rate_gain": 1.25}
    server.gains({"type": "gains", "time": 18.0, "axes": {"y": gains, "z": gains}, "why": {"y": "a", "z": "b"}}, 0)
    block = page.locator(".gains")
    expect(block.locator("div")).to_have_text("new gains for y, z, at 18.0 s")
    expect(block.locator("p").first).to_have_text("y: bandwidth 2.00 rad/s, stiffness 3.50 1/s², rate 1.25 1/s: a.")

    alarm = Alarm(20.5, ("y",), "payload", (19.9, 20.1), {}, 0.9, 1e-9, "because")
    server.state(replace(told(21, 0.1), alarms=(alarm,)), 0, 0)
    expect(block.locator("div")).to_have_text("new gains for y, z, at 18.0 s; of before the alarm: y")
    server.state(replace(told(22, 0.1), alarms=(replace(alarm, axes=("y", "z"), time=21.5, revises=20.5),)), 0, 0)
    expect(block.locator("div")).to_have_text("new gains for y, z, at 18.0 s; of before the alarm: y, z")
    expect(block).to_have_class("gains old")


def test_the_end_is_no_error(live: tuple[LivePage, Page]) -> None:
    server, page = live
    server.state(told(1, 0.1), 0, 0)
    expect(page.locator("#time")).to_have_text("1 s")
    time.sleep(0.2)
    server.close()

    expect(page.locator("#link")).to_have_text("ended")
    expect(page.locator("#link")).not_to_have_class("gone")
