"""The page and the figures: content, escaping, self-containment, every combination of what is known."""

import base64
import json
import re
import shlex
import sys
import tomllib
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from test_views import flown, known_axis, known_model

from rotorfit.app.cli import main
from rotorfit.app.web.wire import result_mapping
from rotorfit.assessment.case import Case
from rotorfit.assessment.evidence import evidence_of, motion_of_flight
from rotorfit.assessment.rows import HorizonErrors
from rotorfit.assessment.validation import validate
from rotorfit.core.finding import Finding
from rotorfit.core.flight_data import Flight, Note
from rotorfit.core.frames import AXES
from rotorfit.core.model import Axis, Candidate, Model, unknown_axis
from rotorfit.core.residuals import ResidualTests
from rotorfit.core.results import CURVE, Difference, Paired, PairedTest, Validation
from rotorfit.estimation.grouping import without_held_axes
from rotorfit.files.cards import builtin_cards
from rotorfit.reporting import write_figures, write_report
from rotorfit.reporting.drawing import draw_chart, log_ticks, peaks, ticks
from rotorfit.reporting.next_steps import Step, next_steps, wanted_chart
from rotorfit.reporting.reproduce import card_text, recipe_of
from rotorfit.reporting.side_by_side import coefficients_side_by_side, flights_side_by_side, leads
from rotorfit.reporting.tables import paired_rows, score_rows
from rotorfit.reporting.targets import beside_target
from rotorfit.reporting.verdict import Light, Verdict, better, uses_of, verdict_of, verdict_on
from rotorfit.reporting.views import Chart, Line, flight_view, overlaid
from rotorfit.reporting.words import figure, rounded

pytestmark = pytest.mark.flights

NO_VALIDATION = Validation((), {"hold": (), "paper": ()})
HOSTILE = "</script><script>alert(1)</script>\"'><img src=x onerror=alert(1)>{{ 7 * 7 }}"
WARNING = Finding("weak_excitation", "warning", "the gain of z is known to 26 % only", "z is wide", "fly larger", "z")
ERROR = Finding("delay_at_bound", "error", "the delay ends at its bound", "x is useless", "check the clocks", "x")
VOID = {"meta", "link", "br", "img", "input", "path", "circle", "rect", "col", "hr"}


class Page(HTMLParser):
    """What a browser would see: elements with their attributes, the text, and whether every element is closed."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []
        self.texts: list[str] = []
        self.feed(html)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        if tag not in VOID:
            assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if not self.open or self.open[-1] not in ("script", "style"):
            self.texts.append(data)

    @property
    def text(self) -> str:
        return re.sub(r"\s+", " ", " ".join(self.texts))

    def count(self, tag: str, **attributes: str) -> int:
        return sum(t == tag and attributes.items() <= a.items() for t, a in self.elements)


COMPUTED = {
    "predict_flight", "free_run_prediction", "residuals", "residual_tests_of_flight", "correlograms",
    "paired_test", "axis_pieces", "plane_pieces", "whiten_fused", "axis_response", "horizontal_response",
    "motion_response", "lagged_axis_response", "predict", "record", "local_polynomial", "motion_from_flight",
    "coefficient_rows", "scores_of", "physics_rows",
}  # fmt: skip
"""Filters, predictions, tests and derivatives: what takes a flight to compute."""


def written(
    tmp_path: Path,
    model: Model,
    training: tuple[Flight, ...] = (),
    validation: Validation = NO_VALIDATION,
    flights: tuple[Flight, ...] = (),
) -> str:
    path = tmp_path / "report.html"
    write_report(evidence_of([Case("model.json", model, training, validation, flights)]), path)
    return path.read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def training() -> Flight:
    return replace(
        flown(12.0, path="training.bag", seed=3), notes=(Note("stale_poses", "85 of 1440 poses repeat", 85),)
    )


@pytest.fixture(scope="module")
def flight() -> Flight:
    return flown(12.0, path="validation.bag", seed=4)


@pytest.fixture(scope="module")
def html(training: Flight, flight: Flight, tmp_path_factory: pytest.TempPathFactory) -> str:
    model = replace(known_model(flights=(training,)), findings=(WARNING,))
    folder = tmp_path_factory.mktemp("report")
    return written(folder, model, (training,), validate(model, [flight]), (flight,))


# The page


def test_the_page_says_verdict_coefficients_findings_repairs_and_how_to_reproduce(html: str, flight: Flight) -> None:
    text = Page(html).text

    assert "Can I use this model for a controller that looks 1 s ahead (MPC)?" in text
    assert re.search(
        r"Over the first second: off by [\d.]+ cm/s, and [\d.]+ cm at the end, [\d.]+ times better than holding", text
    )
    assert "3.698" in text
    assert "3.658 to 3.738" in text
    assert "m/s² per full tilt" in text
    assert "weak excitation" in text
    assert WARNING.remedy in text
    assert "85 of 1440 poses repeat" in text
    assert "training.bag" in text
    assert flight.sha256 in text
    assert "rotorfit validate model.json validation.bag@0:" in text
    assert "numba" in text
    assert "Is the difference from the baselines real?" in text
    assert re.search(
        r"validation\.bag x paper 1 s −[\d.]+ \(−[\d.]+ to [−+][\d.]+\) cm/s (better|no difference shown|too short)",
        text,
    )
    assert re.search(r"validation\.bag z white \(p = [\d.]+\) \d+, 30 free of them", text)
    assert 'name = "rotorfit demo quadrotor"' in text


def test_the_sections_come_in_the_order_of_the_argument(html: str) -> None:
    ids = [attributes["id"] for tag, attributes in Page(html).elements if tag == "section"]

    wanted = "verdict validation delay horizon response residuals next coefficients findings repairs reproduce"
    assert ids == wanted.split()


def test_every_chart_has_a_text_alternative_and_every_anchor_a_place(html: str) -> None:
    page = Page(html)
    ids = [attributes["id"] for _, attributes in page.elements if "id" in attributes]

    assert len(ids) == len(set(ids))
    assert not page.open
    anchors = {a["href"][1:] for tag, a in page.elements if tag == "a" and a["href"]}
    assert anchors <= set(ids)
    pictures = [a for tag, a in page.elements if tag == "svg" and a.get("class") == "chart"]
    assert len(pictures) == 2 * 8 + 8 + 4 + 2 * 4 + 1 + 2 * 2  # the last: gain and delay over frequency, of x and z
    assert all(a["role"] == "img" and len(a["aria-label"] or "") > 30 for a in pictures)


def test_the_page_asks_nothing_of_the_network(html: str) -> None:
    page = Page(html)

    assert not re.search(r"https?://|//cdn|@import|url\(|\bfetch\(|XMLHttpRequest|WebSocket|importScripts", html)
    assert not {tag for tag, _ in page.elements} & {"link", "img", "iframe", "object", "embed", "base", "form"}
    assert not any("src" in attributes for _, attributes in page.elements)
    assert all(str(a["href"]).startswith("#") for _, a in page.elements if "href" in a)
    policy = next(a["content"] for _, a in page.elements if a.get("http-equiv") == "Content-Security-Policy")
    assert str(policy).startswith("default-src 'none'")


def test_the_plot_library_brings_its_licence(html: str) -> None:
    assert "Copyright (c) 2022 Leon Sorokin" in html
    assert "The above copyright notice and this permission notice shall be included" in html


def test_the_charts_that_zoom_hold_the_series_of_the_views(html: str, flight: Flight) -> None:
    script = re.search(r'<script type="application/json" id="series">(.*?)</script>', html, re.S)
    assert script is not None
    first = json.loads(script[1])[0]

    view = flight_view(motion_of_flight(known_model(), flight, True), "validation")
    assert np.array_equal(np.frombuffer(base64.b64decode(first["t"]), "<f4"), view.charts[0].x.astype("<f4"))
    chart = next(c for c in view.charts if (c.kind, c.axis) == ("velocity", "x"))
    assert [line["role"] for line in first["charts"][0]["lines"]] == ["measured", "paper", "model"]
    for line, own in zip(first["charts"][0]["lines"], chart.lines, strict=True):
        packed = np.frombuffer(base64.b64decode(line["y"]), "<f4")
        assert np.array_equal(packed, own.y.astype("<f4"), equal_nan=True)


def test_hostile_names_stay_text(training: Flight, flight: Flight, tmp_path: Path) -> None:
    bad, worse = (
        replace(training, path=HOSTILE),
        replace(flight, path=f"/tmp/{HOSTILE}", notes=(Note("a", HOSTILE, 1),)),
    )
    model = known_model(flights=(bad,))
    card = replace(model.card, name=HOSTILE, raw={**model.card.raw, "name": HOSTILE})
    finding = Finding(HOSTILE, "info", HOSTILE, HOSTILE, HOSTILE)
    model = replace(model, card=card, findings=(finding,))

    html = written(tmp_path, model, (bad,), validate(model, [worse]), (worse,))
    page = Page(html)
    assert page.count("script") == 3
    assert page.count("img") == 0
    assert not any(name.startswith("on") for _, attributes in page.elements for name in attributes)
    assert not page.open
    assert "<script>alert" not in html
    assert page.text.count(HOSTILE) >= 8


def test_what_is_found_of_several_axes_is_said_once(training: Flight, tmp_path: Path) -> None:
    alike = [replace(WARNING, axis=axis, evidence=f"the gain of {axis} is not known", effect="") for axis in "xyz"]
    page = Page(written(tmp_path, replace(known_model(), findings=tuple(alike)), (training,)))

    assert page.text.count("the gain of x, y and z is not known") == 1
    assert "the gain of y is not known" not in page.text


def test_a_path_that_is_no_text_is_written_all_the_same(tmp_path: Path, flight: Flight) -> None:
    lost = replace(flight, path="flight\udcff.bag")

    assert "flight?.bag" in written(tmp_path, known_model(flights=(lost,)), (lost,))


def test_the_same_input_gives_the_same_page(html: str, training: Flight, flight: Flight, tmp_path: Path) -> None:
    model = replace(known_model(flights=(training,)), findings=(WARNING,))

    assert written(tmp_path, model, (training,), validate(model, [flight]), (flight,)) == html


def test_minutes_of_four_axes_stay_below_two_megabytes(tmp_path: Path) -> None:
    """Of what is longer no more is drawn, as the next test shows."""
    flights = (flown(180.0),)
    assert flights[0].pose_time.size / 180 == pytest.approx(120, rel=0.1)  # what is stale counts once

    size = len(written(tmp_path, known_model(), (), NO_VALIDATION, flights).encode())
    assert 0.5e6 < size < 2e6


def test_the_drawing_of_a_long_flight_keeps_every_peak_in_its_place_and_every_hole() -> None:
    y = np.sin(np.arange(72_000) / 900)
    y[40_001], y[50_000:50_500] = 7.0, np.nan

    kept = peaks(y, 60)
    assert kept.size <= 2 * 60 + 3
    assert {0, 40_001, 50_000, 71_999} <= set(kept.tolist())
    for part in np.array_split(np.arange(72_000), 60):
        mine = y[kept[np.isin(kept, part)]]
        assert (np.nanmin(mine), np.nanmax(mine)) == (np.nanmin(y[part]), np.nanmax(y[part]))


SUBSETS = ((), ("x",), ("yaw",), ("x", "z"), ("y", "z", "yaw"), AXES)


@pytest.mark.parametrize("axes", SUBSETS, ids=["+".join(subset) or "none" for subset in SUBSETS])
def test_every_combination_of_known_axes_renders(
    axes: tuple[str, ...], training: Flight, flight: Flight, tmp_path: Path
) -> None:
    status = ("not_excited", "too_short", "diverged")[len(axes) % 3]
    model = known_model(axes, status, (training,))

    html = written(tmp_path, model, (training,), validate(model, [flight]), (flight,))
    page = Page(html)
    assert not page.open
    assert ("There is no model yet" in page.text) == (not axes and status != "diverged")
    assert page.count("figure", **{"class": "panel motion"}) == 4 * len(axes)
    assert "nan" not in page.text.lower().split()


@pytest.mark.parametrize("with_training", [True, False])
@pytest.mark.parametrize("with_validation", [True, False])
def test_the_page_does_without_flights(
    with_training: bool, with_validation: bool, training: Flight, flight: Flight, tmp_path: Path
) -> None:
    model = known_model(flights=(training,))
    scores = validate(model, [flight]) if with_validation else NO_VALIDATION

    html = written(tmp_path, model, (training,) * with_training, scores, (flight,) * with_validation)
    page = Page(html)
    assert not page.open
    assert ("no validation flight is at hand" in page.text) == (not with_validation)
    assert ("fitted to are not at hand" in page.text) == (not with_training)
    assert ("There are no residuals" in page.text) == (not with_training and not with_validation)
    assert page.count("details", **{"class": "flight"}) == with_training + with_validation
    assert "training.bag" in page.text


def test_scores_without_their_flights_still_give_the_verdict(training: Flight, flight: Flight, tmp_path: Path) -> None:
    model = known_model(flights=(training,))

    text = Page(written(tmp_path, model, (), validate(model, [flight]), ())).text
    assert re.search(r"(Yes|With care)[^.]*\. As a whole: (yes|with care)", text)


def test_a_model_of_the_papers_method_says_that_it_knows_no_delay(
    training: Flight, flight: Flight, tmp_path: Path
) -> None:
    def without_delay(axis: Axis) -> Axis:
        return replace(
            axis,
            delay=None,
            stderr={**axis.stderr, "delay": None},
            ci95={**axis.ci95, "delay": (None, None)},
            status={**axis.status, "delay": "not_identifiable"},
            combinations={},
            modes=(),
            profile=(),
        )

    model = known_model(flights=(training,))
    model = replace(model, method="paper", axes={name: without_delay(axis) for name, axis in model.axes.items()})
    text = Page(written(tmp_path, model, (training,), validate(model, [flight]), (flight,))).text

    assert "The paper's method knows no delay: there is nothing to show." in text
    assert "it predicts as if commands acted at once" in text


def test_open_intervals_and_missing_numbers_are_words(training: Flight, tmp_path: Path) -> None:
    axis = known_axis("z")
    vague = replace(
        axis,
        damping=None,
        stderr={**axis.stderr, "damping": None},
        ci95={**axis.ci95, "damping": (3.1, None)},
        status={**axis.status, "damping": "not_identifiable"},
    )
    model = known_model(flights=(training,))
    model = replace(model, axes={**model.axes, "z": vague}, paper=(None,) * 8)

    text = Page(written(tmp_path, model, (training,))).text
    assert "3.10 to open" in text
    assert "not identifiable" in text


# The verdict


def score(axis: str, model: float | None, hold: float = 0.2, horizon: float = 1.0, n: int = 40) -> HorizonErrors:
    errors = {"model": model, "hold": hold, "paper": 0.1}
    return HorizonErrors(axis, horizon, errors, errors, n)


def against_hold(word: str = "better", axes: tuple[str, ...] = AXES) -> tuple[PairedTest, ...]:
    """The model against holding the velocity, with one verdict everywhere."""
    pooled = Difference(40, -0.1, 0.01, 9.0, 0.001, -0.01, 0.001, word)  # type: ignore[arg-type]
    both = {what: Paired((pooled,), pooled, None) for what in ("velocity", "position")}
    horizons = {f"{h:g}": both for h in (0.5, 1.0, 2.0, 5.0)}
    return (PairedTest("model", "hold", dict.fromkeys(axes, horizons)),)  # type: ignore[arg-type]


def residual(white_p: float = 0.5, command_p: float | None = 0.5) -> ResidualTests:
    return ResidualTests(
        n=900, lags=30, ljung_box=30.0, ljung_box_p=white_p, white_p=white_p, command_freedom=5, command_p=command_p,
        command_peak=1.0, command_peak_lag=0.2, variance_ratio=1.0, variance_ci95=(0.9, 1.1), optimism={},
        white=white_p >= 0.05, follows_command=None if command_p is None else command_p < 0.05,
    )  # fmt: skip


def test_residuals_of_another_size_than_in_the_fit_are_not_clean_though_no_test_fails() -> None:
    for ratio, colour in ((66.0, "yellow"), (0.1, "yellow"), (3.0, "green"), (0.4, "green")):
        light = light_of(0.05, tests=replace(residual(), variance_ratio=ratio, variance_ci95=(0.0, 2 * ratio)))
        assert light.lamps[2].colour == light.colour == colour, ratio
        assert (f"{ratio:g} times" in light.lamps[2].text) == (colour == "yellow")


def test_a_delay_below_zero_is_never_green_whether_a_finding_tells_of_it_or_not() -> None:
    model = known_model()
    early = replace(model.axes["x"], delay=-0.02, ci95={**model.axes["x"].ci95, "delay": (-0.07, 0.03)})
    scores = [score("x", 0.05, horizon=h) for h in (0.5, 1.0, 2.0, 5.0)]
    one = replace(model, axes={**model.axes, "x": early}, findings=())
    light = verdict_of(one, scores, against_hold(), [{"x": residual()}]).lights[0]

    assert light.lamps[1].colour == "yellow"
    assert "no vehicle answers before its command" in light.lamps[1].text
    assert any("before it is sent" in text for text in light.sentences)


def light_of(
    error: float | None, findings: tuple[Finding, ...] = (), word: str = "better", tests: ResidualTests | None = None
) -> Light:
    model = replace(vague_model(), findings=findings)
    scores = [score("x", error, horizon=h) for h in (0.5, 1.0, 2.0, 5.0)]
    return verdict_of(model, scores, against_hold(word), [{"x": tests or residual()}]).lights[0]


@pytest.mark.parametrize(
    ("error", "findings", "colour"),
    [
        (0.05, (), "green"),
        (0.15, (), "yellow"),
        (0.19, (), "red"),
        (0.5, (), "red"),
        (None, (), "open"),
        (0.05, (ERROR,), "red"),
        (None, (ERROR,), "red"),
        (0.05, (replace(WARNING, axis="x"),), "yellow"),
        (0.05, (WARNING,), "green"),
        (0.05, (replace(ERROR, axis=None),), "red"),
        (0.05, (replace(WARNING, axis=None),), "yellow"),
    ],
)
def test_the_light_is_the_worst_of_its_lamps(error: float | None, findings: tuple[Finding, ...], colour: str) -> None:
    light = light_of(error, findings)

    assert light.colour == colour
    assert (colour == "green") == all(lamp.colour == "green" for lamp in light.lamps)


@pytest.mark.parametrize(
    ("white_p", "command_p", "colour", "word"),
    [
        (0.5, 0.5, "green", "clean"),
        (0.051, None, "green", "clean"),
        (0.026, 0.5, "yellow", "in doubt"),
        (0.5, 0.026, "yellow", "in doubt"),
        (0.002, 0.5, "yellow", "not clean"),
        (0.5, 1e-9, "yellow", "not clean"),
    ],
)
def test_no_light_is_green_beside_a_test_that_fails(
    white_p: float, command_p: float | None, colour: str, word: str
) -> None:
    light = light_of(0.05, tests=residual(white_p, command_p))

    lamp = light.lamps[2]
    assert (lamp.question, lamp.colour, lamp.word) == ("residuals", colour, word)
    assert light.colour == colour
    assert ("p = 0.026" in lamp.text) == (word == "in doubt")


@pytest.mark.parametrize(
    ("word", "answer"),
    [("better", "yes"), ("no_difference_shown", "limited"), ("too_short", "limited"), ("worse", "no")],
)
def test_ten_times_better_is_proven_only_where_the_paired_test_says_that_it_is_no_chance(
    word: str, answer: str
) -> None:
    (use,) = uses_of([score("x", 0.02)], against_hold(word), ("x",), (1.0,))[:1]

    assert use.answer == answer
    assert use.times == pytest.approx(10.0)
    assert bool(use.reason) == (answer != "yes")


def test_both_velocity_and_position_must_be_twice_as_good() -> None:
    errors = {"model": 0.01, "hold": 0.2}
    good, bad = (
        HorizonErrors("x", 1.0, errors, errors, 40),
        HorizonErrors("x", 1.0, errors, {"model": 0.15, "hold": 0.2}, 40),
    )

    answers = [uses_of([each], against_hold(), ("x",), (1.0,))[0].answer for each in (good, bad)]
    assert answers == ["yes", "limited"]


def test_without_a_paired_test_nothing_is_proven() -> None:
    assert uses_of([score("x", 0.01)], (), ("x",), (1.0,))[0].answer == "limited"


def test_the_reach_ends_before_the_first_horizon_that_is_not_proven() -> None:
    scores = [score("x", error, horizon=h) for h, error in ((0.5, 0.01), (1.0, 0.02), (2.0, 0.15), (5.0, 0.02))]
    light = verdict_of(known_model(), scores, against_hold(), [{"x": residual()}]).lights[0]

    assert light.word == "usable up to 1 s"


def test_the_model_as_a_whole_is_as_good_as_its_weakest_axis() -> None:
    errors = {"x": 0.01, "y": 0.02, "z": 0.09, "yaw": 0.03}
    scores = [score(axis, error, horizon=h) for axis, error in errors.items() for h in (0.5, 1.0, 2.0, 5.0)]
    tests = [dict.fromkeys(AXES, residual())]

    verdict = verdict_of(vague_model(), scores, against_hold(), tests)
    assert verdict.headline == "Yes, for every axis."
    assert verdict.whole == (
        "As a whole: yes. The predictions are proven up to 5 s; over the first second the weakest axis is z, off by "
        "9.0 cm/s, and 9.0 cm at the end, 2.2 times better than holding the velocity."
    )
    assert [use.axis for use in verdict.weakest] == ["z"] * 4


def test_a_doubt_about_one_axis_is_named_for_the_whole() -> None:
    scores = [score(axis, 0.01, horizon=h) for axis in AXES for h in (0.5, 1.0, 2.0, 5.0)]
    tests = [{**dict.fromkeys(AXES, residual()), "y": residual(1e-6), "yaw": residual(command_p=1e-6)}]

    verdict = verdict_of(vague_model(), scores, against_hold(), tests)
    assert verdict.headline == "Yes for x and z; with care for y and yaw."
    assert verdict.whole.startswith("As a whole: with care, because of the residuals of y and yaw.")


@pytest.mark.parametrize(
    ("severity", "colour", "word"),
    [("info", "green", "known"), ("warning", "yellow", "known, with a warning"), ("error", "red", "unusable")],
)
@pytest.mark.parametrize("code", ["residuals_not_white", "weak_excitation"])
def test_coefficients_are_green_only_where_no_finding_warns_of_them(
    code: str, severity: str, colour: str, word: str
) -> None:
    light = light_of(0.05, (Finding(code, severity, "why", "intervals of x are optimistic", "widen them", "x"),))  # type: ignore[arg-type]

    assert (light.lamps[1].colour, light.lamps[1].word) == (colour, word)
    assert light.colour == colour


def test_a_yes_names_the_coefficients_that_miss_the_targets_the_page_has() -> None:
    scores = [score(axis, 0.01) for axis in AXES]
    model = vague_model()
    wide = replace(model.axes["y"], stderr={**model.axes["y"].stderr, "delay": 0.01})
    vague = replace(model, axes={**model.axes, "y": wide})

    def verdict(of: Model) -> Verdict:
        return verdict_of(of, scores, against_hold(), [dict.fromkeys(AXES, residual())])

    told = verdict(vague)
    assert told.headline == "Yes, for every axis. Known too little for the fastest controller: delay of y."
    assert told.lights[1].lamps[1].word == "known, short of targets"
    assert told.lights[1].lamps[1].text.endswith("exceed the targets: delay 2.0 times.")
    assert "too little" not in verdict(model).headline
    assert "too little" not in verdict(replace(vague, method="oe")).headline  # the page has no targets then
    assert (
        "too little" not in verdict(replace(vague, findings=(Finding("few", "warning", "a", "b", "c", "y"),))).headline
    )


def test_times_better_means_the_smaller_of_both_factors_at_every_horizon() -> None:
    velocity, position = {"model": 0.01, "hold": 0.2, "paper": 0.1}, {"model": 0.01, "hold": 6.35, "paper": 0.1}
    scores = [HorizonErrors("x", h, velocity, position, 40) for h in (0.5, 1.0, 2.0, 5.0)]
    verdict = verdict_of(known_model(), scores, against_hold(), [{"x": residual()}])

    said = [text for text in verdict.lights[0].sentences if "holding the velocity" in text]
    assert [text.partition(":")[0] for text in said] == ["Over the first second", "Over the first 5 s"]
    assert all("20 times better" in text for text in said)
    assert {use.times for use in verdict.uses if use.axis == "x"} == {20.0}


@pytest.mark.parametrize(
    ("tests", "asked"),
    [
        (residual(0.026), "another flight"),
        (replace(residual(1e-9), optimism={"input": 1.29, "damping": 1.1}), "half widths of its intervals by 1.29"),
        (residual(1e-9), "its intervals hold"),
        (residual(command_p=1e-9), "like that of these flights only"),
        (replace(residual(), variance_ratio=9.0, variance_ci95=(8.0, 10.0)), "by 3.0"),
        (replace(residual(), variance_ratio=0.04, variance_ci95=(0.03, 0.05)), "less here than in the fit"),
        (replace(residual(1e-9), variance_ratio=9.0, variance_ci95=(8.0, 10.0)), "of its noise by 3.0"),
    ],
)
def test_every_doubt_says_beside_the_headline_what_to_do(tests: ResidualTests, asked: str) -> None:
    scores = [score(axis, 0.01, horizon=h) for axis in AXES for h in (0.5, 1.0, 2.0, 5.0)]
    clean = dict.fromkeys(AXES, residual())

    verdict = verdict_of(known_model(), scores, against_hold(), [{**clean, "y": tests, "yaw": tests}])
    (advice,) = verdict.advice
    assert advice.startswith("y and yaw: use it")
    assert asked in advice
    assert verdict_of(known_model(), scores, against_hold(), [clean]).advice == ()
    (proof,) = verdict_of(known_model(), scores, against_hold("too_short"), [clean]).advice
    assert proof.startswith("x, y, z and yaw: use it where")


def held_flight(axis: str, share: float) -> Flight:
    """A flight whose commands of one axis are a share of what they would be."""
    flight = flown(12.0, path="held.bag", seed=6)
    command = flight.command.copy()
    command[:, AXES.index(axis)] *= share
    return replace(flight, command=command, sha256="c" * 64)


@pytest.mark.parametrize(("share", "kept"), [(0.05, False), (0.5, True)])
def test_an_axis_that_is_held_beside_the_training_flights_is_not_proven_and_never_red(
    training: Flight, share: float, kept: bool
) -> None:
    (flight,) = without_held_axes([held_flight("z", share)], (training,))
    model = known_model(flights=(training,))
    cases = [Case(name, model, (training,), validate(model, [flight], CURVE), (flight,)) for name in ("a", "b")]
    evidences = evidence_of(cases)
    light = verdict_of(model, evidences[0].scores, cases[0].validation.paired, cases[0].validation.residuals).lights[2]

    assert ("z" in flight.axes) == kept
    assert ("z" in [lead.axis for lead in leads(evidences, 1.0)]) == kept
    if not kept:
        assert (light.colour, light.word, light.error) == ("open", "not proven", None)
        assert light.lamps[0].text == "No flight that was not fitted moves this axis."


def test_without_validation_flights_nothing_is_proven() -> None:
    verdict = verdict_of(known_model(), [])

    assert verdict.headline == "Not proven, for every axis."
    assert verdict.whole.startswith("As a whole: not proven.")
    assert {light.word for light in verdict.lights} == {"not proven"}
    assert {use.answer for use in verdict.uses} == {"unproven"}


def test_a_flight_of_the_fit_proves_nothing_and_every_place_says_so(training: Flight, flight: Flight) -> None:
    """Its residuals, too: that they are smaller than in the fit would be said of the fit itself."""
    model = known_model(flights=(training,))
    part, other = replace(training, path="part.bag"), replace(flight, path="fresh.bag")
    odd = replace(residual(1e-6), variance_ratio=0.04)
    spent = replace(validate(model, [part]), residuals=(dict.fromkeys(AXES, odd),))
    verdict = verdict_on(evidence_of([Case("model.json", model, (training,), spent, (part,))])[0])
    lamps = {lamp.question: lamp for lamp in verdict.lights[0].lamps}
    assert "overlaps the training" in lamps["predictions"].text
    assert "What overlaps the training does not count." in verdict.whole
    assert (lamps["residuals"].word, lamps["residuals"].colour) == ("not tested", "grey")

    both = validate(model, [part, other])
    rows = [row[0] for row in (*score_rows(both), *paired_rows(both))]
    assert set(rows) == {"part.bag (fitted)", "fresh.bag", "all that were not fitted"}
    (one,) = evidence_of([Case("model.json", model, (training,), both, (part, other))])
    chart = flights_side_by_side([one.case], ["model"], 1.0)[0]
    assert [row.name for row in chart.rows] == ["part.bag (fitted)", "fresh.bag"]
    assert "over one flight that was not fitted" in chart.summary
    assert [shown["role"] for shown in result_mapping(one)["flights"]] == ["training", "validation", "training"]


def test_a_flight_that_was_misread_neither_proves_a_model_nor_condemns_it() -> None:
    wrong = Finding("card_differs", "error", "z moves too fast (f.csv)", "no judgement", "compare units", "z")
    scores = [score(axis, 3.0 if axis == "z" else 0.01) for axis in AXES]

    verdict = verdict_of(known_model(), scores, against_hold(), misread=[wrong])

    assert [light.colour for light in verdict.lights] == ["green", "green", "open", "green"]
    assert verdict.whole == (
        "As a whole: not proven. The flights were or may be misread in what concerns z: see the findings."
    )
    unusable = replace(known_model(), findings=(Finding("sign_flipped", "error", "a", "b", "c", "y"),))
    assert verdict_of(unusable, scores, against_hold(), misread=[wrong]).whole == (
        "As a whole: no, because of the coefficients of y. What concerns z may be misread, too: see the findings."
    )
    assert "z: compare units." in verdict.advice
    steps = next_steps(case_of(known_model()), verdict)
    assert [(step.what, step.command) for step in steps[:1]] == [("Compare units.", "")]
    assert not any("keep that flight out" in step.what for step in steps)


def test_the_light_is_unlit_where_there_is_no_model_and_red_where_it_diverged() -> None:
    model = known_model(("x",))
    exact = vague_model().axes["x"]
    model = replace(model, axes={**model.axes, "x": exact, "yaw": unknown_axis("diverged")})

    verdict = verdict_of(model, [score("x", 0.05), score("yaw", None)], against_hold())
    assert [light.colour for light in verdict.lights] == ["green", "grey", "grey", "red"]
    assert verdict.headline == "Yes for x; no for yaw. There is no model of y and z."
    assert verdict.whole == "As a whole: no. There is no model of y, z and yaw, which can be commanded."


def test_the_verdict_says_how_far_off_in_units_for_people() -> None:
    scores = [score("x", 0.027, 0.1053), score("x", 0.19, 1.9, 5.0), score("yaw", 0.01, 0.1)]

    x, *_, yaw = verdict_of(known_model(), scores, against_hold(), speeds={"x": 0.5, "yaw": 0.5}).lights
    held = "times better than holding the velocity."
    assert x.sentences[0] == f"Over the first second: off by 2.7 cm/s, and 2.7 cm at the end, 3.9 {held}"
    assert x.sentences[1] == f"Over the first 5 s: off by 19 cm/s, and 19 cm at the end, 10 {held}"
    assert "Tested at up to 0.50 m/s." in x.sentences
    assert "The motion answers a command after 0.15 s (0.14 to 0.16 s)." in x.sentences
    assert yaw.error == "0.57 deg/s"
    assert "Tested at up to 29 deg/s." in yaw.sentences


# What to fly next


def case_of(model: Model, **parts: object) -> Case:
    return Case("my model.json", model, **parts)  # type: ignore[arg-type]


def test_an_axis_without_a_model_and_one_without_proof_are_to_be_flown() -> None:
    model = known_model(("x", "y"))
    steps = next_steps(case_of(model), verdict_of(model, [score("x", 0.01)], against_hold()))

    lines = [shlex.split(step.command) for step in steps if step.command]
    assert [line[line.index("--axes") + 1] for line in lines[:2]] == ["z,yaw", "y"]
    assert all(line[:4] == ["rotorfit", "plan", "--after", "my model.json"] for line in lines[:2])


def test_the_lines_to_type_are_those_that_the_command_line_knows() -> None:
    model = known_model(("x", "y"))
    steps = next_steps(case_of(model), verdict_of(model, [score("x", 0.01)], against_hold()))

    lines = [shlex.split(step.command) for step in steps if step.command]
    assert len(lines) >= 2
    for _, verb, *rest in lines:
        main.commands[verb].make_context(verb, rest)


def test_a_finding_that_forbids_use_becomes_a_step_and_residuals_ask_for_a_richer_law(training: Flight) -> None:
    model = replace(known_model(flights=(training,)), findings=(ERROR,))
    scores = [score(axis, 0.01) for axis in AXES]
    steps = next_steps(case_of(model), verdict_of(model, scores, against_hold(), [{"z": residual(1e-6)}]))

    told = " ".join(f"{step.what} {step.command}" for step in steps)
    assert "Check the clocks." in told
    assert "--structure auto -o richer.json" in told


def vague_model(**vague: str) -> Model:
    """A model whose errors meet the targets, but for one coefficient of an axis, given by its status."""
    model = known_model()
    axes = {
        name: replace(
            axis,
            stderr=dict.fromkeys(axis.stderr, 1e-6),
            ci95={
                key: (value - 2e-6, value + 2e-6) for key in axis.stderr if (value := getattr(axis, key)) is not None
            },
        )
        for name, axis in model.axes.items()
    }
    for axis, status in vague.items():
        one = axes[axis]
        axes[axis] = replace(
            one, delay=None, stderr={**one.stderr, "delay": None}, status={**one.status, "delay": status}
        )
    return replace(model, axes=axes)


def test_accuracy_beside_the_target_is_the_models_own_and_what_is_not_known_misses_it() -> None:
    """The likelihood's errors under the first-order law alone are ten times smaller than those of some models."""
    wide = replace(known_axis("x"), stderr={"input": 0.2, "damping": None, "delay": 0.004})
    model = vague_model(y="refuted")
    chart = wanted_chart(case_of(replace(model, axes={**model.axes, "x": wide})))

    assert chart is not None
    shares = {row.name: row.dots[0][1] for row in chart.rows}
    assert wide.input is not None
    assert wide.damping is not None
    assert shares["x input gain"] == pytest.approx(0.2 / (0.02 * wide.input))
    assert shares["x damping"] == pytest.approx(0.04 / (2 * 1.96) / (0.05 * wide.damping), rel=1e-3)
    assert shares["x delay"] == pytest.approx(0.8, rel=0.03)
    assert shares["y delay"] is None
    assert chart.summary == ("3 of 12 coefficients miss the target: x input gain, x damping, y delay (not known).")


def test_a_delay_that_the_law_does_without_is_no_coefficient_to_learn() -> None:
    assert set(beside_target(replace(known_axis("x"), structure="first_order"))) == {"input", "damping"}


def test_delays_that_only_stamps_leave_unknown_ask_for_stamps_and_no_flight() -> None:
    model = vague_model()
    axes = {n: replace(one, ci95={**one.ci95, "delay": (0.13, 0.17)}) for n, one in model.axes.items()}
    (flown,) = steps_of(replace(model, axes=axes))
    assert flown.command
    rows = Finding("commands_by_row", "info", "each row holds a command and a pose", "too short", "log commands apart")
    (step,) = steps_of(replace(model, axes=axes, findings=(rows,)))
    assert (step.what, step.command) == ("Log commands apart.", "")


def steps_of(model: Model, *tests: dict[str, ResidualTests]) -> tuple[Step, ...]:
    """What to do with a model that is proven on every axis."""
    scores = [score(axis, 0.01) for axis in AXES]
    return next_steps(case_of(model), verdict_of(model, scores, against_hold(), tests))


def test_a_flight_is_asked_for_where_a_coefficient_misses_its_target_and_only_there() -> None:
    assert [step.what for step in steps_of(vague_model())] == ["Nothing has to be flown for this."]
    (step,) = steps_of(vague_model(z="refuted"))
    assert step.what == "Fly z once more, and fit with it."
    assert step.why == "The delay of z is not known: the flights deny the law that it belongs to."
    assert "--axes z --room" in step.command


def test_axes_that_the_fit_left_out_are_to_be_fitted_and_not_to_be_flown(training: Flight) -> None:
    model = known_model(("x", "y"), "not_fitted", (training,))
    first = next_steps(case_of(model), verdict := verdict_of(model, [score("x", 0.01)], against_hold()))[0]

    assert first.what == "Fit z and yaw, too."
    assert "--axes" not in first.command
    assert shlex.split(first.command)[1] == "fit"
    assert verdict.whole.endswith("There is no model of z and yaw, which can be commanded: the fit left out z and yaw.")


TRIED = Candidate("first_order_delay", 3, 0.0, 0.0, None, None, "", None, None, "", True)


def test_a_richer_law_is_fitted_as_the_model_was_and_only_where_none_was_tried(training: Flight) -> None:
    unclean = {"z": residual(1e-6, 1e-6)}
    model = replace(known_model(("x", "y", "z"), "not_fitted", (training,)), method="robust", prior={})
    line = shlex.split(next(step for step in steps_of(model, unclean) if "richer" in step.what).command)
    assert " ".join(line[3:]) == (
        "--card card.toml --method robust --structure auto --axes x,y,z --prior -o richer.json"
    )

    axes = {name: replace(axis, candidates=(TRIED,)) for name, axis in known_model().axes.items()}
    for done in (replace(known_model(), axes=axes), replace(known_model(), method="iv")):
        verdict = verdict_of(done, [score("z", 0.01)], against_hold(), [unclean])
        assert not any("richer" in step.what for step in next_steps(case_of(done), verdict))
        assert not any("richer" in text for text in verdict.advice)


def test_flights_that_cannot_be_planned_have_no_line_and_several_plans_have_files_of_their_own() -> None:
    model = known_model(("x", "y"))
    verdict = verdict_of(model, [score("x", 0.01)], against_hold())
    world = replace(model, card=replace(model.card, command_frame="world"))

    lines = [step.command for step in next_steps(case_of(model), verdict) if step.command]
    assert len({line.rpartition(" -o ")[2] for line in lines}) == len(lines) >= 2
    assert not any("rotorfit plan" in step.command for step in next_steps(case_of(world), verdict))
    assert "cannot be planned" in next_steps(case_of(world), verdict)[0].why


# Several models, several flights


@pytest.fixture(scope="module")
def compared(training: Flight, flight: Flight) -> tuple[Case, ...]:
    """A right model and one that answers half as strongly, on the same two flights."""
    right = known_model(flights=(training,))
    halves = {}
    for name, axis in right.axes.items():
        assert axis.predictor is not None
        halves[name] = replace(axis, predictor=replace(axis.predictor, input=0.5 * axis.predictor.input))
    flights = (flight, replace(flown(12.0, path="another.bag", seed=5), sha256="b" * 64))
    return tuple(
        Case(path, model, (training,), validate(model, flights, CURVE), flights)
        for path, model in (("right.json", right), ("half.json", replace(right, axes=halves)))
    )


@pytest.fixture(scope="module")
def side_by_side(compared: tuple[Case, ...], tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("compared") / "report.html"
    write_report(evidence_of(compared), path)
    return path.read_text(encoding="utf-8")


def test_pages_and_figures_as_png_and_pdf_are_written_and_nothing_is_computed_while_they_are_drawn(
    training: Flight, flight: Flight, compared: tuple[Case, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    model = known_model(("x",), flights=(training,))
    (one,) = evidence_of([Case("model.json", model, (training,), validate(model, [flight], CURVE), (flight,))])
    (unproven,) = evidence_of([Case("model.json", model, (training,))])
    several = evidence_of(compared)

    def computed(*_: object, **__: object) -> None:
        raise AssertionError("computed while it was drawn")

    for module in [module for name, module in sys.modules.items() if name.startswith("rotorfit.")]:
        for name in COMPUTED & set(vars(module)):
            monkeypatch.setattr(module, name, computed)

    for evidences in ([one], [unproven], several):
        write_report(evidences, tmp_path / "report.html")
    assert result_mapping(one)["flights"]
    files = write_figures(one, tmp_path / "new" / "figures")
    assert [file.name for file in files] == [
        f"{name}.{kind}"
        for name in ("acceleration", "velocity", "horizon", "delay", "residuals")
        for kind in ("png", "pdf")
    ]
    for file in files:
        assert file.read_bytes().startswith(b"\x89PNG" if file.suffix == ".png" else b"%PDF")
        assert file.stat().st_size > 5_000


def test_a_comparison_names_the_model_that_predicts_best(side_by_side: str) -> None:
    page = Page(side_by_side)

    assert not page.open
    assert "Which model can I use" in page.text
    for axis in AXES:
        assert re.search(rf"{axis} [\d.]+ \S+ [\d.]+ \S+ right leads", page.text)
    assert page.count("div", **{"class": "lights"}) == 2


def test_a_comparison_draws_both_models_over_what_was_measured(side_by_side: str) -> None:
    script = re.search(r'<script type="application/json" id="series">(.*?)</script>', side_by_side, re.S)
    assert script is not None

    for flight in json.loads(script[1]):
        for chart in flight["charts"]:
            assert [line["role"] for line in chart["lines"]] == ["measured", "model-1", "model-2"]
            assert [line["name"] for line in chart["lines"]] == ["measured", "right", "half"]


def test_the_lead_of_a_model_over_itself_is_chance(compared: tuple[Case, ...]) -> None:
    twice = (compared[0], replace(compared[0], path="copy.json"))

    told = leads(evidence_of(twice), 1.0)
    assert [lead.axis for lead in told] == list(AXES)
    assert all("chance" in lead.reason and "no chance" not in lead.reason for lead in told)


def test_flights_side_by_side_show_the_error_of_each(compared: tuple[Case, ...]) -> None:
    charts = flights_side_by_side(compared, ("right", "half"), 1.0)

    assert [chart.title.partition(":")[0] for chart in charts] == list(AXES)
    for number, row in enumerate(charts[0].rows):
        found = compared[1].validation.flights[number].axes["x"].horizons["1"].velocity_rmse
        assert row.dots[1] == ("model-2", pytest.approx(100 * found))


def test_the_coefficients_of_models_stand_side_by_side_with_their_intervals(compared: tuple[Case, ...]) -> None:
    charts = coefficients_side_by_side(evidence_of(compared), ("right", "half"))

    assert len(charts) == 12
    delay = next(chart for chart in charts if chart.title == "x: delay")
    assert [(row.low, row.high) for row in delay.rows] == [(0.142, 0.158)] * 2


def test_lines_on_other_stamps_are_laid_over_each_other_unchanged() -> None:
    def profile(x: list[float], y: list[float]) -> Chart:
        return Chart(
            "profile", "x", "t", "delay [s]", "", np.array(x), (Line("p", "model", np.array(y)),), "", "s",
            y_range=(min(y), 1.0),
        )  # fmt: skip

    (chart,) = overlaid([[profile([0.0, 1.0], [0.0, 2.0])], [profile([0.5, 1.5], [1.0, -1.0])]], ["a", "b"])
    assert list(chart.x) == [0.0, 0.5, 1.0, 1.5]
    assert np.array_equal(chart.lines[0].y, [0.0, 1.0, 2.0, np.nan], equal_nan=True)
    assert np.array_equal(chart.lines[1].y, [np.nan, 1.0, 0.0, -1.0], equal_nan=True)
    assert chart.y_range == (-1.0, 1.0)


# For everybody


def test_every_word_that_is_explained_has_its_definition_and_every_number_in_a_table_too(
    html: str, side_by_side: str
) -> None:
    for page in (Page(html), Page(side_by_side)):
        defined = {str(a["id"]) for _, a in page.elements if "popover" in a}
        asked = {str(a["popovertarget"]) for _, a in page.elements if "popovertarget" in a}
        told = {f"def-{a['data-def']}" for _, a in page.elements if "data-def" in a}
        numbers = [a for tag, a in page.elements if tag == "td" and "number" in (a.get("class") or "").split()]

        assert (asked | told) <= defined
        assert len(numbers) > 100
        assert all("data-def" in a or a.get("data-tip") for a in numbers)
        assert not any(a.get("title") for _, a in page.elements)


def test_everything_that_reacts_to_the_pointer_reacts_to_the_keyboard(html: str) -> None:
    page = Page(html)

    explained = [(tag, a) for tag, a in page.elements if "term" in (a.get("class") or "").split()]
    assert {tag for tag, _ in explained} == {"button"}
    assert all(a["aria-describedby"] == a["popovertarget"] for _, a in explained)
    assert all(a.get("tabindex") == "0" for tag, a in page.elements if tag == "svg" and "data-along" in a)
    assert all(a.get("tabindex") == "0" for tag, a in page.elements if a.get("class") == "scroll")
    assert page.elements[[tag for tag, _ in page.elements].index("a")][1]["class"] == "skip"


def themes() -> dict[str, dict[str, str]]:
    """Colours of the page by theme: what each sets anew over the light one."""
    css = (Path(__file__).parents[2] / "src/rotorfit/reporting/templates/page.css").read_text(encoding="utf-8")
    blocks = [
        dict(re.findall(r"--([\w-]+): (#[0-9a-f]{6})", block)) for block in re.findall(r":root \{(.*?)\}", css, re.S)
    ]
    return {name: {**blocks[0], **block} for name, block in zip(("light", "dark", "print"), blocks, strict=True)}


def contrast(one: str, other: str) -> float:
    """Source: WCAG 2.2, definitions of contrast ratio and relative luminance."""

    def luminance(colour: str) -> float:
        parts = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255
        linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
        return float(linear @ [0.2126, 0.7152, 0.0722])

    high, low = sorted((luminance(one), luminance(other)), reverse=True)
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize("theme", ["light", "dark", "print"])
def test_text_has_a_contrast_of_four_and_a_half_and_lines_of_three(theme: str) -> None:
    colour = themes()[theme]
    text = [(word, ground) for word in ("ink", "muted", "accent") for ground in ("card", "ground")]
    text += [(word, "card") for word in ("green", "yellow", "red", "grey")]
    text += [(word, f"{word}-ground") for word in ("green", "yellow", "red", "grey")]
    text += [(word, f"{ground}-ground") for word in ("ink", "muted") for ground in ("green", "yellow", "red", "grey")]
    lines = ["measured", "model", "paper", "hold", "vague", *(f"model-{k}" for k in range(1, 7))]

    pairs = {(a, b): contrast(colour[a], colour[b]) for a, b in text}
    assert {pair: found for pair, found in pairs.items() if found < 4.5} == {}
    drawn_on_card = {name: contrast(colour[name], colour["card"]) for name in lines}
    assert {name: found for name, found in drawn_on_card.items() if found < 3} == {}


# What it is made of


@pytest.mark.parametrize(
    ("value", "text"),
    [(184.4, "184"), (10.4, "10"), (9.96, "10.0"), (2.66, "2.7"), (0.9216, "0.92"), (0.0123, "0.012")],
)
def test_figures_for_people_have_two_digits_and_no_exponent(value: float, text: str) -> None:
    assert figure(value) == text


@pytest.mark.parametrize(
    ("value", "scale", "text"),
    [
        (3.69948, 0.0216, "3.699"),
        (-0.184, 0.04, "−0.184"),
        (57.09, 17.5, "57"),
        (None, 0.1, "—"),
        (0.0, None, "0"),
        (7.25, None, "7.25"),
        (1234.5, 260.0, "1230"),
    ],
)
def test_numbers_have_the_digits_that_their_uncertainty_deserves(
    value: float | None, scale: float | None, text: str
) -> None:
    assert rounded(value, scale) == text


def test_every_built_in_card_survives_being_written_and_read() -> None:
    for card in builtin_cards().values():
        assert tomllib.loads(card_text(card.raw)) == card.raw


def test_awkward_text_in_a_card_survives_being_written_and_read() -> None:
    raw = {"name": 'a "b" \\ \n ü \x7f ]', "pose": {"x": "T:a.b[0]", "odd key": {"value": 10, "unit": "deg"}, "z": 1.5}}

    assert tomllib.loads(card_text(raw)) == raw


def test_commands_can_be_pasted_into_a_shell_whatever_the_name_of_the_log(flight: Flight) -> None:
    odd = replace(flight, path="my flight; rm -rf '$HOME'.bag", span=(0.5, 11.25))

    recipe = recipe_of(known_model(flights=(odd,)), [odd])
    words = [shlex.split(command) for command in recipe.commands]
    assert all(f"{odd.path}@0.5:11.25" in line for line in words)
    assert [line[1] for line in words] == ["fit", "validate", "report"]
    assert [log.role for log in recipe.logs] == ["training", "validation"]


@pytest.mark.parametrize(
    ("method", "axes", "words"),
    [
        ("iv", {"z": "not_excited", "yaw": "not_excited"}, ["--method", "iv"]),
        ("iv", {"z": "ok", "yaw": "not_fitted"}, ["--method", "iv", "--axes", "x,y,z"]),
        ("ml", {"z": "not_excited", "yaw": "not_excited"}, ["--axes", "x,y"]),
    ],
)
def test_the_fit_is_reproduced_with_the_axes_and_the_tables_that_were_asked_for(
    flight: Flight, method: str, axes: dict[str, str], words: list[str]
) -> None:
    model = replace(known_model(flights=(flight,)), method=method, leave_one_out={})
    unknown = {axis: replace(unknown_axis(status)) for axis, status in axes.items() if status != "ok"}
    line = shlex.split(recipe_of(replace(model, axes={**model.axes, **unknown}), ()).commands[0])

    assert " ".join(words) in " ".join(line)
    assert ("--axes" in line) == ("--axes" in words)
    assert "--leave-one-out" in line


@pytest.mark.parametrize(("low", "high"), [(-0.1, 0.6), (0.0, 200.0), (-1e-4, 3e-4), (-7.0, 1500.0)])
def test_ticks_are_round_and_inside(low: float, high: float) -> None:
    values = [value for value, _ in ticks(low, high, 5)]

    step = values[1] - values[0]
    assert 2 <= len(values) <= 6
    assert low - 1e-9 <= values[0] < values[-1] <= high + 1e-9
    assert np.allclose(np.diff(values), step)
    assert f"{step:.0e}"[0] in "125"
    assert [float(text.replace("−", "-")) for _, text in ticks(low, high, 5)] == pytest.approx(values)


def test_ticks_of_a_logarithmic_scale_are_powers_or_parts_of_them() -> None:
    assert [text for _, text in log_ticks(0.4, 60.0, 4)] == ["1", "3", "10", "30"]
    assert [text for _, text in log_ticks(1.5, 9.0, 6)] == ["2", "5"]


def test_a_drawn_line_breaks_at_nan_and_lands_where_it_should() -> None:
    y = np.array([0.0, 1.0, np.nan, 1.0, 0.0])
    chart = Chart(
        "velocity", "x", "t", "time [s]", "m/s", np.arange(5.0), (Line("v", "model", y),), "", "", y_range=(0.0, 1.0)
    )

    picture = draw_chart(chart, 456, 146)
    assert (picture.inner_width, picture.inner_height) == (400, 100)
    assert picture.paths == (("model", "m0 400l400-400m800 0l400 400"),)


# Figures


def test_figures_without_content_are_left_out(
    training: Flight, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Figure, "savefig", lambda *_, **__: None)
    cases = [Case("model.json", known_model(axes), (training,)) for axes in (("x",), ())]
    alone, nothing = (write_figures(*evidence_of([case]), tmp_path) for case in cases)

    assert {file.stem for file in alone} == {"acceleration", "velocity", "delay", "residuals"}
    assert nothing == []


@pytest.mark.parametrize(
    ("times", "said"),
    [(2.24, "2.2 times better than"), (1.04, "equal to"), (0.97, "equal to"), (0.9, "1.1 times worse than")],
)
def test_a_factor_that_rounds_to_one_is_called_equal(times: float, said: str) -> None:
    assert better(times) == f", {said} holding the velocity"
