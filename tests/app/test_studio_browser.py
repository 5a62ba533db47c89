"""The studio in a real browser: from a dropped log to a downloaded model; a bad file, two windows, a killed fit."""

import base64
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from playwright.sync_api import Browser, BrowserContext, Page, Route, expect

from rotorfit.files.models import load
from studio_room import bag

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no chromium here: the studio is not tested in a browser")
FLAGS = [
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
]  # fmt: skip
expect.set_options(timeout=20_000)
SOON, WORK = 20_000, 300_000
"""How long to wait for the page, and for a fit [ms]."""

DROP = """([name, base64]) => {
  const bytes = Uint8Array.from(atob(base64), c => c.charCodeAt(0)), data = new DataTransfer();
  data.items.add(new File([bytes], name));
  for (const kind of ["dragover", "drop"])
    document.body.dispatchEvent(new DragEvent(kind, {dataTransfer: data, bubbles: true, cancelable: true}));
}"""


@contextmanager
def started(workspace: Path) -> Iterator[str]:
    """Address of a studio in a process of its own."""
    command = [sys.executable, "-m", "rotorfit", "studio", str(workspace), "--json"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        said = ""
        while not said.rstrip().endswith("}"):
            line = process.stdout.readline()
            assert line, "the studio did not start"
            said += line
        yield json.loads(said)["address"]
        process.send_signal(signal.SIGINT)
        assert process.wait(20) == 0


@pytest.fixture
def address(tmp_path: Path) -> Iterator[str]:
    """Of a studio of its own."""
    with started(tmp_path / "workspace") as one:
        yield one


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Address of a studio for tests that leave no log in it."""
    with started(tmp_path_factory.mktemp("shared") / "workspace") as one:
        yield one


@pytest.fixture
def context(browser: Browser) -> Iterator[BrowserContext]:
    context = browser.new_context(viewport={"width": 1280, "height": 860})
    context.set_default_timeout(SOON)
    yield context
    context.close()


def opened(context: BrowserContext, address: str) -> Page:
    """The page, with its complaints: errors and breaches of its policy, but no refusals of the server."""
    page = context.new_page()
    complaints: list[str] = []
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.on(
        "console",
        lambda line: (
            None if line.type != "error" or "Failed to load resource" in line.text else complaints.append(line.text)
        ),
    )
    page.on("dialog", lambda dialog: (complaints.append("a dialog"), dialog.dismiss()))
    page.goto(address)
    expect(page.locator("html[data-ready]")).to_have_count(1)
    page.complaints = complaints  # type: ignore[attr-defined]
    return page


def drop(page: Page, name: str, content: bytes) -> None:
    page.evaluate(DROP, [name, base64.b64encode(content).decode()])


def step(page: Page, name: str) -> None:
    page.get_by_role("navigation").get_by_text(name).click()


class Held:
    """Requests of a page that wait for the test to say what becomes of them, in their order."""

    def __init__(self, page: Page, pattern: str) -> None:
        self._page, self._pattern = page, pattern
        self._waiting: list[Route] = []
        page.route(pattern, lambda route: self._waiting.append(route))

    def next(self) -> Route:
        end = time.monotonic() + SOON / 1000
        while not self._waiting:
            assert time.monotonic() < end, f"no request for {self._pattern}"
            self._page.wait_for_timeout(20)
        return self._waiting.pop(0)

    def release(self) -> None:
        """Those that wait, and those to come, go their way."""
        self._page.unroute(self._pattern)
        while self._waiting:
            self._waiting.pop(0).continue_()


def test_from_drop_to_download_and_over_a_reload(context: BrowserContext, address: str, tmp_path: Path) -> None:
    page = opened(context, address)
    assert "token" not in page.url

    drop(page, "flight.bag", bag(1))
    drop(page, "proof.bag", bag(2))
    expect(page.locator("#logs .cards li")).to_have_count(2)
    expect(page.locator("#logs .plot canvas").first).to_be_visible()
    expect(page.locator("#log-detail .scroll table")).to_contain_text("Hz")

    step(page, "Card")
    text = page.get_by_label("The card as TOML")
    expect(text).to_have_value(re.compile("command"))
    expect(page.locator("#card .plot canvas")).to_have_count(4)
    told = page.locator("#card .told").first
    expect(told).to_have_text("✓ + leads forward")
    page.get_by_label("Turn the sign of command x").click()
    expect(text).to_have_value(re.compile(r"scale = -1"))
    expect(told).to_have_text("+ leads backward: turn the sign")
    told.get_by_role("button").click()
    expect(told).to_have_text("✓ + leads forward")
    expect(text).not_to_have_value(re.compile(r"scale = -1"))

    step(page, "Ranges")
    block = page.locator("#ranges article").first
    expect(block).to_contain_text("x velocity [m/s], left; command [share of the tilt limit], right")
    plot = block.locator(".u-over")
    box = plot.bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + 0.1 * box["width"], box["y"] + 50)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.95 * box["width"], box["y"] + 60, steps=5)
    page.mouse.up()
    start = block.get_by_label("From in seconds")
    expect(start).not_to_have_value("")
    assert 1.5 < float(start.input_value()) < 2.5
    start.fill("1")
    start.press("Enter")
    expect(page.locator("#ranges article").first.get_by_label("From in seconds")).to_have_value("1")

    step(page, "Fit")
    for axis in ("z", "yaw"):
        page.get_by_role("checkbox", name=axis).uncheck()
    page.get_by_label("Structure").select_option("first_order_delay")
    page.get_by_role("button", name="Fit", exact=True).click()
    expect(page.locator("#fit .progress")).to_be_visible()
    expect(page.locator("#result .question")).to_contain_text("looks 1 s ahead", timeout=WORK)
    expect(page.locator("#result .coefficients")).to_contain_text("input gain")
    expect(page.locator("#result .flight canvas")).to_have_count(2)

    with page.expect_download() as download:
        page.get_by_text("Download model").click()
    download.value.save_as(tmp_path / "model.json")
    model = load(tmp_path / "model.json")
    assert model.axes["x"].status["input"] == "ok"
    assert model.flights[0].span[0] == pytest.approx(1.0, abs=0.05)
    with page.expect_download() as download:
        page.get_by_role("button", name="Export").click()
    assert download.value.suggested_filename == "model_1.py"
    with page.expect_popup() as popup:
        page.get_by_text("Open the report").click()
    expect(popup.value.locator("h1")).to_be_visible()
    assert (
        popup.value.evaluate("() => { try { return document.cookie } catch (error) { return error.name } }")
        == "SecurityError"
    )

    stale = page.locator("#fit > .notice")
    expect(stale).to_be_hidden()
    for scale, words in ((-1, "Fit 1: card changed since."), (1, "")):
        step(page, "Card")
        page.get_by_label("Turn the sign of command x").click()
        expect(page.get_by_label("Turn the sign of command x")).to_have_attribute(
            "aria-pressed", str(scale < 0).lower()
        )
        step(page, "Fit")
        expect(stale).to_be_visible(visible=bool(words))
        if words:
            expect(stale).to_contain_text(words)
    expect(page.locator("#fit .fits")).to_contain_text("training: 1 s to")

    page.reload()
    expect(page.locator("#result .question")).to_contain_text("looks 1 s ahead")
    page.get_by_label("For", exact=True).select_option("gazebo")
    page.get_by_role("button", name="Export").click()
    expect(page.locator("#notices .error")).to_contain_text("z and yaw are left out")
    step(page, "Compare")
    expect(page.locator("#notices .error")).to_have_count(0)
    page.get_by_role("button", name="Compare", exact=True).click()
    expect(page.locator("#compare .pair summary").first).to_contain_text("fit 1 against", timeout=WORK)
    expect(page.locator("#compare .pair").first).to_contain_text("cm/s")
    page.set_viewport_size({"width": 390, "height": 844})
    expect(page.locator("#compare .hint").first).to_be_visible()
    for name in ("Logs", "Card", "Ranges", "Fit", "Compare"):
        step(page, name)
        expect(page.locator(f"#{name.lower()} h1")).to_be_visible()
        expect(page.locator("#steps .words").filter(has_text=name)).to_be_in_viewport(ratio=1)
        assert page.evaluate("document.documentElement.scrollWidth") == 390, name
    step(page, "Ranges")
    expect(page.locator("#ranges article").first.get_by_label("From in seconds")).to_have_value("1")
    assert page.complaints == []  # type: ignore[attr-defined]


def test_a_number_that_is_refused_does_not_stay_in_its_box(context: BrowserContext, shared: str) -> None:
    page = opened(context, shared)
    drop(page, "flight.bag", bag(1))
    expect(page.locator("#logs .cards li")).to_have_count(1)
    step(page, "Card")
    expect(page.get_by_label("The card as TOML")).to_have_value(re.compile("command"))
    step(page, "Ranges")
    start = page.get_by_label("From in seconds")
    for seconds in ("200", "300"):
        start.fill(seconds)
        start.press("Enter")
        expect(page.locator("#notices .error").last).to_contain_text(f"the range {seconds} s to end holds nothing")
        expect(start).to_have_value("")
    step(page, "Logs")
    page.get_by_label("Remove flight.bag").click()
    expect(page.locator("#logs .cards li")).to_have_count(0)
    assert page.complaints == []  # type: ignore[attr-defined]


def test_a_bad_file_and_a_wicked_name_do_no_harm(context: BrowserContext, shared: str) -> None:
    page = opened(context, shared)
    wicked = '<img src=x onerror="alert(1)">.bag'

    drop(page, "holiday.jpg", b"\xff\xd8\xff\xe0 no log at all")
    expect(page.locator("#logs .refused")).to_contain_text("holiday.jpg was not added: of no known format")
    drop(page, wicked, bag(1))
    expect(page.locator("#logs .cards .title")).to_have_text(wicked)
    expect(page.locator("#log-detail h2").first).to_have_text(wicked)
    for name in ("Card", "Ranges", "Fit", "Compare"):
        step(page, name)
        expect(page.locator(f"#{name.lower()} h1")).to_be_visible()
    assert page.locator("img").count() == 0
    page.goto(page.url.partition("#")[0] + "#logs")
    page.get_by_label("Dismiss").first.click()
    expect(page.locator("#logs .refused")).to_have_count(0)
    page.get_by_label(f"Remove {wicked}").click()
    expect(page.locator("#logs .cards li")).to_have_count(0)
    assert page.complaints == []  # type: ignore[attr-defined]


def test_two_windows_see_the_same_and_neither_loses_what_was_typed(context: BrowserContext, address: str) -> None:
    one, other = opened(context, address), opened(context, address)
    drop(one, "flight.bag", bag(1))
    expect(other.locator("#logs .cards .title")).to_have_text("flight.bag")
    for page in (one, other):
        step(page, "Card")
        expect(page.get_by_label("The card as TOML")).to_have_value(re.compile("command"))

    one.get_by_label("tilt", exact=True).fill("11")
    one.get_by_label("tilt", exact=True).press("Enter")
    expect(other.get_by_label("The card as TOML")).to_have_value(re.compile(r"value = 11"))
    expect(other.get_by_label("tilt", exact=True)).to_have_value("11")

    text, theirs = (page.get_by_label("The card as TOML") for page in (other, one))
    offer = other.get_by_role("button", name="Put my text in its place")

    def changed_by_one(value: str) -> None:
        one.get_by_label("tilt", exact=True).fill(value)
        one.get_by_label("tilt", exact=True).press("Enter")
        expect(theirs).to_have_value(re.compile(f"value = {value}"))

    # the polls fail before the refusal and after it: the text stays, until the other one can be shown
    polls = Held(other, "**/api/session*")
    polls.next().abort()
    changed_by_one("12")
    mine = text.input_value() + "\n# first\n"
    with other.expect_response(lambda response: response.url.endswith("/api/card")) as refused:
        text.fill(mine)
    assert refused.value.status == 409
    for _ in range(2):
        polls.next().abort()
    assert text.input_value() == mine
    polls.release()
    expect(offer).to_be_visible()
    expect(text).to_have_value(re.compile(r"value = 12"))
    offer.click()
    expect(theirs).to_have_value(re.compile("# first"))
    expect(text).to_have_value(re.compile("# first"))

    # a poll succeeds while the text is on its way to the refusal; put in its place, it is refused once more
    changes = Held(other, "**/api/card")
    text.press_sequentially("\n# second")
    on_its_way = changes.next()
    changed_by_one("13")
    expect(other.get_by_label("tilt", exact=True)).to_have_value("13")
    text.press_sequentially(", and more")
    on_its_way.continue_()
    expect(text).to_have_value(re.compile(r"value = 13"))
    offer.click()
    on_its_way = changes.next()
    changed_by_one("14")
    on_its_way.continue_()
    expect(text).to_have_value(re.compile(r"value = 14"))
    offer.click()

    # neither the change nor, the next time, its answer gets through: the page goes on trying
    changes.next().abort()
    changes.next().fetch()  # done, and nobody hears of it
    changes.release()
    expect(theirs).to_have_value(re.compile("# second, and more"))
    expect(text).to_have_value(re.compile("# second, and more"))
    expect(offer).to_have_count(0)

    # a value that is half typed in the table
    other.get_by_label("tilt", exact=True).fill("1")
    changed_by_one("15")
    expect(text).to_have_value(re.compile(r"value = 15"))
    expect(other.get_by_label("tilt", exact=True)).to_have_value("1")
    other.get_by_label("tilt", exact=True).press("6")
    other.get_by_label("tilt", exact=True).press("Enter")
    expect(theirs).to_have_value(re.compile(r"value = 16"))
    for page in (one, other):
        assert page.complaints == []  # type: ignore[attr-defined]


def test_a_fit_that_is_killed_or_cancelled_leaves_the_page_usable(context: BrowserContext, address: str) -> None:
    page = opened(context, address)
    drop(page, "flight.bag", bag(1))
    expect(page.locator("#logs .cards li")).to_have_count(1)
    step(page, "Fit")
    fit = page.get_by_role("button", name="Fit", exact=True)

    fit.click()
    expect(page.locator("#fit .progress")).to_be_visible()
    running = page.evaluate("async () => (await (await fetch('/api/session')).json()).running")
    os.kill(running["pid"], signal.SIGKILL)
    expect(page.locator("#result")).to_contain_text("killed from outside (signal 9)")
    expect(fit).to_be_enabled()

    fit.click()
    page.get_by_role("button", name="Cancel").click()
    expect(page.locator("#fit .fits")).to_contain_text("cancelled")
    expect(fit).to_be_enabled()
    assert page.complaints == []  # type: ignore[attr-defined]


def test_without_the_key_the_browser_is_told_where_it_is(context: BrowserContext, shared: str) -> None:
    page = context.new_page()
    answer = page.goto(shared.partition("?")[0])

    assert answer is not None
    assert answer.status == 401
    expect(page.locator("body")).to_contain_text("open the address that `rotorfit studio` printed")


def test_a_vehicle_is_followed_on_the_page_and_becomes_a_log(context: BrowserContext, address: str) -> None:
    page = opened(context, address)
    step(page, "Live")
    page.get_by_role("button", name="Follow").click()
    view = page.frame_locator("iframe.live")
    expect(view.locator("#time")).to_have_text(re.compile(r"^\d+ s$"), timeout=WORK)
    expect(view.locator(".axis canvas").first).to_be_visible()
    expect(page.locator("#live")).to_contain_text("the simulated pilot")

    page.get_by_role("button", name="End").click()
    expect(view.locator("#link")).to_have_text("ended", timeout=WORK)
    expect(page.locator("#live")).to_contain_text("what was heard is the log live-1.mcap")
    step(page, "Logs")
    expect(page.locator("#logs .cards li")).to_have_count(1)
    assert page.complaints == []  # type: ignore[attr-defined]
