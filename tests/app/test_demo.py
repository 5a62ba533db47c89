"""The demo: the truth comes back, the likelihood predicts best, and nothing is written over anybody's log."""

import json
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import rotorfit.app.demo as demo_module
from rotorfit.app.cli import main
from rotorfit.app.demo import Demo, demo, demo_mapping, recovered, scores
from rotorfit.app.terminal import show
from rotorfit.app.terminal.outlook import demo_view
from rotorfit.core.errors import LogError
from rotorfit.files.logs import read
from rotorfit.files.models import load, to_mapping
from rotorfit.files.plans import load_plan, plan_from_text, plan_text

pytestmark = pytest.mark.flights

FLIGHTS = ["train_xy", "train_z", "train_yaw", "validate_xy", "validate_z", "validate_yaw"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("demo") / "results"


@pytest.fixture(scope="module")
def result(folder: Path) -> Iterator[Demo]:
    """Of flights by the demo's plans that are shorter: a third as long to fit, a quarter for the proof."""
    shorter = {
        name: (design, axes, duration / (3 if name.startswith("train") else 4), high)
        for name, (design, axes, duration, high) in demo_module.FLIGHTS.items()
    }
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(demo_module, "FLIGHTS", shorter)
        yield demo(folder)


def plain(mapping: object) -> object:
    return json.loads(json.dumps(mapping, allow_nan=False))


def test_the_demo_writes_six_plans_six_logs_two_models_and_a_report_and_nothing_else(
    result: Demo, folder: Path
) -> None:
    flown = [f"{name}.{kind}" for kind in ("toml", "mcap") for name in FLIGHTS]

    assert [path.name for path in result.written] == [*flown, "model.json", "paper.json", "report.html"]
    assert sorted(folder.iterdir()) == sorted(result.written)
    assert plain(to_mapping(load(folder / "model.json"))) == plain(to_mapping(result.ml))
    assert load(folder / "paper.json").method == "paper"
    assert (folder / "report.html").read_bytes()[:15].lower() == b"<!doctype html>"


def test_every_log_was_flown_to_the_end_and_carries_its_plan(folder: Path) -> None:
    for name in FLIGHTS:
        log = read(folder / f"{name}.mcap")

        assert log.events[-1].text == "end: completed"
        assert plan_text(plan_from_text(log.attached["plan"], name)) == plan_text(load_plan(folder / f"{name}.toml"))


def test_only_the_training_flights_are_fitted_and_only_the_others_validate(result: Demo) -> None:
    assert [Path(flight.path).stem for flight in result.ml.flights] == FLIGHTS[:3]
    assert [flight.axes for flight in result.ml.flights] == [("x", "y"), ("z",), ("yaw",)]
    assert [Path(flight.path).stem for flight in result.validation.flights] == FLIGHTS[3:]


def test_the_likelihood_recovers_the_truth_within_its_own_errors(result: Demo) -> None:
    rows = recovered(result)

    assert [row.name for row in rows[:3]] == ["x.input", "x.damping", "x.delay"]
    assert len(rows) == 12
    errors = []
    for row in rows:
        axis, name = row.name.split(".")
        stderr = result.ml.axes[axis].stderr[name]
        assert row.ml is not None
        assert stderr is not None
        errors.append((row.ml - row.truth) / stderr)
    assert np.max(np.abs(errors)) < 4  # of 12, one in a thousand runs
    assert np.sqrt(np.mean(np.square(errors))) < 1.6  # chi-square of 12, likewise


def test_the_papers_damping_is_too_small_on_every_axis(result: Demo) -> None:
    dampings = [row for row in recovered(result) if row.name.endswith("damping")]

    assert len(dampings) == 4
    for row in dampings:
        assert row.paper is not None
        assert row.paper < 0.85 * row.truth


def test_the_likelihood_predicts_better_than_the_paper_and_both_better_than_holding(result: Demo) -> None:
    rows = scores(result)

    assert [row.axis for row in rows] == ["x", "y", "z", "yaw"]
    for row in rows:
        assert row.ml is not None
        assert row.paper is not None
        assert row.hold is not None
        assert row.ml < 0.7 * row.paper
        assert row.ml < row.hold / 4


@pytest.mark.slow
def test_a_second_run_keeps_the_logs_and_gives_the_same(result: Demo, folder: Path) -> None:
    before = {path: path.stat().st_mtime_ns for path in result.written}
    found = CliRunner().invoke(main, ["demo", str(folder), "--json"])

    assert (found.exit_code, found.stderr) == (0, "")
    assert json.loads(found.stdout) == plain(demo_mapping(result))
    after = {path: path.stat().st_mtime_ns for path in result.written}
    assert [path.stem for path in result.written if before[path] == after[path]] == FLIGHTS * 2


def test_the_table_shows_truth_and_estimates_side_by_side(result: Demo, capsys: pytest.CaptureFixture[str]) -> None:
    show(demo_view(result))
    found = capsys.readouterr().out

    rows = re.findall(r"^ *(?:x|y|z|yaw)? +(?:input|damping|delay) +[\d.]+ +[\d.]+ .* to ", found, re.MULTILINE)
    assert len(rows) == 12
    assert re.search(r"^\d+ of 12 intervals contain the truth", found, re.MULTILINE)
    assert re.search(r"^yaw +[\d.]+ +[\d.]+ +[\d.]+  ?validate_yaw\.mcap$", found, re.MULTILINE)
    assert all(str(path) in found for path in result.written)


@pytest.mark.parametrize("name", ["validate_yaw.mcap", "model.json", "report.html"])
def test_what_the_demo_has_not_written_is_not_overwritten(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text("somebody's own")

    with pytest.raises(LogError, match=f"{name}: exists and is no"):
        demo(tmp_path)
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {name: "somebody's own"}
