"""The page and the figures: content, escaping, self-containment, every combination of what is known."""

import base64
import json
import re
import shlex
import tomllib
from dataclasses import replace
from html.parser import HTMLParser
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

from rotorfit.card_file import builtin_cards
from rotorfit.evidence import Score
from rotorfit.finding import Finding
from rotorfit.flight import Flight, Note
from rotorfit.frames import AXES
from rotorfit.model import Axis, Model, unknown_axis
from rotorfit.report import write_figures, write_report
from rotorfit.report.drawing import drawn, log_ticks, ticks
from rotorfit.report.reproduce import card_text, recipe_of
from rotorfit.report.verdict import figure, verdict_of
from rotorfit.report.words import rounded
from rotorfit.validation import Validation, validate
from rotorfit.views import Chart, Line, flight_view
from test_views import flown, known_axis, known_model

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


def written(
    tmp_path: Path,
    model: Model,
    training: tuple[Flight, ...] = (),
    validation: Validation = NO_VALIDATION,
    flights: tuple[Flight, ...] = (),
) -> str:
    path = tmp_path / "report.html"
    write_report(model, training, validation, flights, path)
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

    assert "To plan 1 s ahead, use it for x, y and yaw, with care for z." in text
    assert re.search(r"1 s ahead the x velocity is off by [\d.]+ cm/s, [\d.]+ times better than holding", text)
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
    assert re.search(r"validation\.bag x paper 1 s −[\d.]+ ± [\d.]+ cm/s (better|no difference shown|too short)", text)
    assert re.search(r"validation\.bag z white \(p = [\d.]+\) \d+, 30 free of them", text)
    assert 'name = "rotorfit demo quadrotor"' in text


def test_the_sections_come_in_the_order_of_the_argument(html: str) -> None:
    ids = [attributes["id"] for tag, attributes in Page(html).elements if tag == "section"]

    wanted = "verdict coefficients validation horizon delay residuals findings repairs reproduce"
    assert ids == wanted.split()


def test_every_chart_has_a_text_alternative_and_every_anchor_a_place(html: str) -> None:
    page = Page(html)
    ids = [attributes["id"] for _, attributes in page.elements if "id" in attributes]

    assert len(ids) == len(set(ids))
    assert not page.open
    anchors = {a["href"][1:] for tag, a in page.elements if tag == "a" and a["href"]}
    assert anchors <= set(ids)
    pictures = [a for tag, a in page.elements if tag == "svg" and a.get("class") == "chart"]
    assert len(pictures) == 2 * 8 + 8 + 4 + 2 * 4
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

    view = flight_view(known_model(), flight, "validation", with_paper=True)
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


def test_a_path_that_is_no_text_is_written_all_the_same(tmp_path: Path, flight: Flight) -> None:
    lost = replace(flight, path="flight\udcff.bag")

    assert "flight?.bag" in written(tmp_path, known_model(flights=(lost,)), (lost,))


def test_the_same_input_gives_the_same_page(html: str, training: Flight, flight: Flight, tmp_path: Path) -> None:
    model = replace(known_model(flights=(training,)), findings=(WARNING,))

    assert written(tmp_path, model, (training,), validate(model, [flight]), (flight,)) == html


def test_ten_minutes_of_four_axes_stay_below_two_megabytes(tmp_path: Path) -> None:
    flights = (flown(600.0),)

    size = len(written(tmp_path, known_model(flights=flights), flights))
    assert 0.5e6 < size < 2e6


SUBSETS = [subset for size in range(5) for subset in combinations(AXES, size)]


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
    assert ("No validation flight is at hand" in page.text) == (not with_validation)
    assert ("fitted to are not at hand" in page.text) == (not with_training)
    assert ("There are no residuals" in page.text) == (not with_training and not with_validation)
    assert page.count("details", **{"class": "flight"}) == with_training + with_validation
    assert "training.bag" in page.text


def test_scores_without_their_flights_still_give_the_verdict(training: Flight, flight: Flight, tmp_path: Path) -> None:
    model = known_model(flights=(training,))

    text = Page(written(tmp_path, model, (), validate(model, [flight]), ())).text
    assert "To plan 1 s ahead, use it for x, y, z and yaw." in text


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


def score(axis: str, model: float | None, hold: float = 0.2, horizon: float = 1.0) -> Score:
    errors = {"model": model, "hold": hold, "paper": 0.1}
    return Score(axis, horizon, errors, errors, 40)


@pytest.mark.parametrize(
    ("error", "findings", "colour"),
    [
        (0.05, (), "green"),
        (0.15, (), "yellow"),
        (0.19, (), "red"),
        (0.5, (), "red"),
        (None, (), "yellow"),
        (0.05, (ERROR,), "red"),
        (None, (ERROR,), "red"),
        (0.05, (replace(WARNING, axis="x"),), "yellow"),
        (0.05, (WARNING,), "green"),
        (0.05, (replace(ERROR, axis=None),), "red"),
        (0.05, (replace(WARNING, axis=None),), "yellow"),
    ],
)
def test_the_light_follows_from_the_gain_over_holding_and_from_findings(
    error: float | None, findings: tuple[Finding, ...], colour: str
) -> None:
    light = verdict_of(replace(known_model(), findings=findings), [score("x", error)]).lights[0]

    assert light.colour == colour
    assert bool(light.reasons) == (colour != "green")


def test_the_light_is_unlit_where_there_is_no_model_and_red_where_it_diverged() -> None:
    model = known_model(("x",))
    model = replace(model, axes={**model.axes, "yaw": unknown_axis("diverged")})

    verdict = verdict_of(model, [score("x", 0.05), score("yaw", None)])
    assert [light.colour for light in verdict.lights] == ["green", "grey", "grey", "red"]
    assert verdict.headline == "To plan 1 s ahead, use it for x, not for yaw. There is no model of y and z."


def test_the_verdict_says_how_far_off_in_units_for_people() -> None:
    scores = [score("x", 0.027, 0.1053), score("x", 0.19, 1.9, 5.0), score("yaw", 0.01, 0.1)]

    x, *_, yaw = verdict_of(known_model(), scores).lights
    assert x.sentences[0] == "1 s ahead the x velocity is off by 2.7 cm/s, 3.9 times better than holding the velocity."
    assert "5 s ahead the position is off by 19 cm, 10 times better than holding the velocity." in x.sentences
    assert "A command acts after 0.15 s." in x.sentences
    assert yaw.error == "0.57 deg/s"


def test_the_verdict_takes_the_horizon_nearest_to_a_second() -> None:
    verdict = verdict_of(known_model(), [score("x", 0.05, horizon=h) for h in (0.2, 0.8, 3.0)])

    assert verdict.horizon == 0.8
    assert verdict.headline.startswith("To plan 0.8 s ahead, use it for x, with care for y, z and yaw")


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

    picture = drawn(chart, 456, 146)
    assert (picture.inner_width, picture.inner_height) == (400, 100)
    assert picture.paths == (("model", "m0 400l400-400m800 0l400 400"),)


# Figures


def test_figures_are_written_as_png_and_pdf(training: Flight, flight: Flight, tmp_path: Path) -> None:
    model = known_model(flights=(training,))

    files = write_figures(model, [training], validate(model, [flight]), [flight], tmp_path / "new" / "figures")
    assert [file.name for file in files] == [
        f"{name}.{kind}"
        for name in ("acceleration", "velocity", "horizon", "delay", "residuals")
        for kind in ("png", "pdf")
    ]
    for file in files:
        assert file.read_bytes().startswith(b"\x89PNG" if file.suffix == ".png" else b"%PDF")
        assert file.stat().st_size > 5_000


def test_figures_without_content_are_left_out(training: Flight, tmp_path: Path) -> None:
    alone = write_figures(known_model(("x",)), [training], NO_VALIDATION, [], tmp_path)
    nothing = write_figures(known_model(()), [training], NO_VALIDATION, [], tmp_path)

    assert {file.stem for file in alone} == {"acceleration", "velocity", "delay", "residuals"}
    assert nothing == []
