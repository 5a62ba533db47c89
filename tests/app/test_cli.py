"""The command line: what each verb prints, writes and returns; nothing heavy before it is needed."""

import json
import os
import pty
import re
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from functools import cache, partial
from pathlib import Path

import click
import pytest
import tomli_w
from click.testing import CliRunner, Result

from files.version_0_1.numbers_of import FOLDER
from models import VEHICLE, model_of
from rotorfit.app.cli import main
from rotorfit.files.cards import card_from_mapping, load_card
from rotorfit.files.logs import FORMATS
from rotorfit.files.models import load, save, to_mapping
from rotorfit.planning.signals import two_sines
from rotorfit.simulation.paper_vehicle import Truth, simulate_flight, write_bag
from rotorfit.simulation.vehicle import load_vehicle
from rotorfit.version import __version__

pytestmark = pytest.mark.flights

VERBS = [
    "demo",
    "info",
    "fit",
    "ladder",
    "validate",
    "compare",
    "report",
    "convert",
    "tune",
    "export",
    "plan",
    "fly",
    "track",
    "cards",
    "formats",
    "studio",
]
ANSI = re.compile(r"\x1b\[[0-9;?]*[a-zA-Z]")


def run(*arguments: object) -> Result:
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


def done(*arguments: object) -> str:
    """Standard output of a verb that must succeed in silence."""
    result = run(*arguments)
    assert result.exit_code == 0, result.output
    assert result.stderr == ""
    return result.stdout


told = cache(done)
"""The same, once for all tests that ask the same of a verb which writes nothing."""


def from_json(text: str) -> dict:
    def refuse(constant: str) -> None:
        raise AssertionError(f"{constant} is not JSON")

    found: dict = json.loads(text, parse_constant=refuse)
    return found


def json_of(*arguments: object) -> dict:
    return from_json(done(*arguments, "--json"))


LAW = ("--structure", "first_order_delay")
"""What 30 s of two slow sines can tell."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two flights that move x and y, and models by both methods from the first."""
    folder = tmp_path_factory.mktemp("flights")
    for name, seed in (("first", 7), ("second", 8)):
        commands = partial(two_sines, axes=("x", "y"))
        write_bag(simulate_flight(Truth(), commands, 30.0, seed), folder / f"{name}.bag")
    done("fit", folder / "first.bag", *LAW, "-o", folder / "ml.json")
    done("fit", folder / "first.bag", "--method", "paper", "-o", folder / "paper.json")
    return folder


# Help


def test_the_verbs_are_listed_in_the_order_of_the_work_each_with_help() -> None:
    found = done("--help")

    assert re.findall(r"^  (\w+)  ", found.partition("Commands:")[2], re.MULTILINE) == VERBS
    for verb in VERBS:
        assert main.commands[verb].help
        assert "--json" in done(verb, "--help")


def test_every_option_has_help() -> None:
    bare = [
        (verb, parameter.name)
        for verb, command in main.commands.items()
        for parameter in command.params
        if isinstance(parameter, click.Option) and not parameter.help
    ]

    assert bare == []


def test_the_version_is_the_packages() -> None:
    assert done("--version") == f"rotorfit {__version__}\n"


def imported_by(*lines: list[str], stderr: int = subprocess.PIPE) -> tuple[str, set[str]]:
    """What a fresh process prints and has imported after these command lines, which must all have printed something."""
    code = (
        "import sys\nfrom rotorfit.app.cli import main\n"
        f"for line in {lines!r}:\n  try: main(line)\n  except SystemExit as end: assert end.code == 0\n"
        "print('imported:', *(name for name in sys.modules if name.count('.') < 2))"
    )
    found = subprocess.run(
        [sys.executable, "-c", code],
        stdout=subprocess.PIPE, stderr=stderr, text=True, check=True, env={**os.environ, "TERM": "xterm"},
    )  # fmt: skip
    shown, _, names = found.stdout.rpartition("imported:")
    assert shown
    return shown, set(names.split())


def test_help_imports_nothing_heavy() -> None:
    _, names = imported_by(["--help"], *([verb, "--help"] for verb in VERBS))

    assert "click" in names
    assert not names & {"numpy", "numba", "scipy", "polars", "rosbags", "matplotlib", "rich"}


def test_linear_algebra_has_one_thread_unless_the_user_says_otherwise(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    monkeypatch.setenv("OMP_NUM_THREADS", "3")

    done("cards")

    assert (os.environ["OPENBLAS_NUM_THREADS"], os.environ["OMP_NUM_THREADS"]) == ("1", "3")


def test_lists_of_what_is_known_do_not_wait_for_the_compiler() -> None:
    assert "numba" not in imported_by(["cards"], ["formats"])[1]


def _drained(terminal: int) -> bytes:
    """All that was written to a pseudo-terminal whose other end is closed; one read gives 4096 bytes at the most."""
    parts = []
    try:
        while part := os.read(terminal, 1 << 16):
            parts.append(part)
    except OSError:  # the other end is closed and nothing is left
        pass
    return b"".join(parts)


@pytest.fixture(scope="module")
def fresh() -> tuple[str, str, set[str]]:
    """A fit in a process of its own: its output, what a terminal showed beside it, what was imported."""
    words = [str(FOLDER / "flight.csv"), "--card", str(FOLDER / "card.toml"), "--axes", "z", *LAW, "--json"]
    reader, writer = pty.openpty()
    with ThreadPoolExecutor(1) as pool:  # a terminal that nobody reads is full after 4 kB, and what writes to it waits
        draining = pool.submit(_drained, reader)
        try:
            shown, names = imported_by(["fit", *words], stderr=writer)
        finally:
            os.close(writer)
        said = ANSI.sub("", draining.result().decode(errors="replace"))
    os.close(reader)
    return shown, said, names


def test_a_fit_imports_of_scipy_what_it_uses(fresh: tuple[str, str, set[str]]) -> None:
    _, _, names = fresh

    assert "scipy.special" in names
    assert not names & {f"scipy.{part}" for part in ("interpolate", "ndimage", "optimize", "signal", "stats")}


# Fit


def test_the_json_of_a_fit_is_the_model_file(folder: Path, tmp_path: Path) -> None:
    output = tmp_path / "model.json"
    found = json_of("fit", folder / "first.bag", "--axes", "x", *LAW, "-o", output)

    assert found == json.loads(output.read_text())
    assert found == json.loads(json.dumps(to_mapping(load(output))))
    assert found["axes"]["x"]["status"] == {"input": "ok", "damping": "ok", "delay": "ok"}
    assert found["axes"]["y"]["predictor"] is None


def test_a_fit_writes_nothing_unless_it_is_asked_to(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)

    before = sorted(folder.iterdir())
    found = done("fit", folder / "first.bag", "--axes", "x", *LAW)

    assert "Nothing was written" in found
    assert sorted(folder.iterdir()) == before
    assert list(tmp_path.iterdir()) == []


def test_a_fit_shows_coefficients_intervals_search_repairs_and_findings(folder: Path) -> None:
    model = load(folder / "ml.json")
    found = told("fit", folder / "first.bag", *LAW)

    for name in ("damping", "delay", "steady gain", "total lag"):
        assert len(re.findall(rf"^ +{name} +[\d.]+ +[\d.]+ to [\d.]+ +[\d.]+ to [\d.]+ ", found, re.MULTILINE)) == 2
    assert re.search(r"^x +input +3\.\d+ +3\.\d+ to 3\.\d+ +3\.\d+ to 3\.\d+ m/s\^2 +[\d.]+ +ok$", found, re.MULTILINE)
    assert re.search(r"^z +input +- +-.* not_excited$", found, re.MULTILINE)
    assert re.search(
        r"^  - (x, y: no other delay was found|[xy]: other delays fit almost as well: 0\.\d+ s \()", found, re.M
    )
    assert "No numbers: no flight excites z or yaw." in found
    for note in model.flights[0].notes:
        assert note.text in found
    assert model.findings
    for finding in model.findings:
        assert f"{finding.severity} {finding.code}: {finding.evidence}" in found
        assert f"Effect: {finding.effect}." in found
        assert f"Try: {finding.remedy}." in found


def test_axes_that_were_not_asked_for_are_not_spoken_of(folder: Path) -> None:
    found = done("fit", folder / "first.bag", "--axes", "x", *LAW)

    assert re.findall(r"^(\w+) +input ", found, re.MULTILINE) == ["x"]
    assert "yaw" not in found


def test_the_papers_method_is_named_and_gives_no_delay(folder: Path) -> None:
    found = done("fit", folder / "first.bag", "--method", "paper")

    assert "by the paper's regression, without delay" in found
    assert re.search(r"^ +delay +- +- +s +not_identifiable$", found, re.MULTILINE)


def test_a_span_behind_the_log_is_the_same_as_the_option(folder: Path) -> None:
    log = folder / "first.bag"

    by_option = json_of("fit", log, "--method", "paper", "--span", "5:20")
    behind = json_of("fit", f"{log}@5:20", "--method", "paper")

    assert by_option == behind
    assert behind["flights"][0]["span"] == [5.0, 20.0]


def test_a_span_behind_the_log_wins_over_the_option(folder: Path) -> None:
    logs = f"{folder / 'first.bag'}@5:20", folder / "second.bag"

    found = json_of("fit", *logs, "--method", "paper", "--span", "10:")

    assert [flight["span"][0] for flight in found["flights"]] == [5.0, 10.0]


def test_an_earlier_model_may_be_written_over(folder: Path, tmp_path: Path) -> None:
    output = tmp_path / "model.json"
    output.write_bytes((folder / "ml.json").read_bytes())

    result = run("fit", folder / "first.bag", "--method", "paper", "-o", output)

    assert result.exit_code == 0
    assert result.stderr.splitlines() == [f"Note: the earlier model.json is kept as {output}~."]
    assert load(output).method == "paper"
    assert (tmp_path / "model.json~").read_bytes() == (folder / "ml.json").read_bytes()


def test_leaving_out_one_flight_shows_every_flight_and_the_spread_and_is_kept(folder: Path, tmp_path: Path) -> None:
    logs, output = (folder / "first.bag", folder / "second.bag"), tmp_path / "model.json"
    found = done("fit", *logs, "--axes", "x", *LAW, "--leave-one-out", "-o", output)

    proof = found.partition("Leave one out")[2]
    assert all(f"{log.name}, 0.00 to" in proof for log in logs)
    assert "No proof" not in proof
    assert re.search(r"^x +vs hold +-[\d.]+ \(-[\d.]+ to -[\d.]+\) +better ", proof, re.MULTILINE)
    assert re.search(r"^ +damping +[\d.]+ +[\d.]+ +[\d.]+ +[\d.]+$", proof, re.MULTILINE)
    kept = json.loads(output.read_text())["leave_one_out"]
    assert [Path(flight["path"]).name for flight in kept["flights"]] == ["first.bag", "second.bag"]
    assert kept == to_mapping(load(output))["leave_one_out"]
    assert json.loads((folder / "ml.json").read_text())["leave_one_out"] is None


def test_one_log_cannot_be_left_out_but_its_parts_can(folder: Path) -> None:
    log = folder / "first.bag"
    refused = run("fit", log, "--leave-one-out")

    assert (refused.exit_code, refused.stdout) == (1, "")
    assert re.fullmatch(r"Error: one flight cannot be left out .*LOG@:60 LOG@60:\n", refused.stderr)
    parts = json_of("fit", f"{log}@:15", f"{log}@15:", "--method", "paper", "--axes", "x", "--leave-one-out")
    assert [flight["fitted"] for flight in parts["leave_one_out"]["flights"]] == [False, False]


# Validate and compare


def proof(folder: Path) -> tuple[object, ...]:
    """The model on the flight that was not fitted, at more horizons than the table has by itself."""
    return "validate", folder / "ml.json", folder / "second.bag", "--horizons", "0.2,0.5,1,2,3,5"


def test_a_flight_that_the_model_was_fitted_to_is_told_before_its_scores(folder: Path) -> None:
    lines = done("validate", folder / "ml.json", folder / "first.bag", "--horizons", "0.5").splitlines()

    assert lines[1].strip() == "the model was fitted to it: proves nothing. Give a flight that was not fitted."


def test_scores_stand_beside_the_baselines_at_the_horizons_asked_for(folder: Path) -> None:
    found = from_json(told(*proof(folder), "--json"))

    assert list(found) == ["flights", "baselines", "paired", "residuals", "frequency_response", "bands", "findings"]
    assert list(found["baselines"]) == ["hold", "paper", "coast"]
    (flight,) = found["flights"]
    assert list(flight["axes"]["x"]["horizons"]) == ["0.2", "0.5", "1", "2", "3", "5"]
    errors = {
        name: each["axes"]["x"]["horizons"]["1"]["velocity_rmse"]
        for name, each in {"model": flight, **{n: b["flights"][0] for n, b in found["baselines"].items()}}.items()
    }
    assert errors["model"] < errors["hold"] / 5
    assert flight["axes"]["z"]["horizons"]["1"] == {"velocity_rmse": None, "position_rmse": None, "n": 0}


def test_scores_are_printed_for_every_horizon_however_many(folder: Path) -> None:
    found = told(*proof(folder))

    found = found.partition("Is the difference")[0]
    assert re.findall(r"v ([\d.]+) s", found) == ["0.2", "0.5", "1", "2", "3", "5"]
    assert found.count("hold") == 5  # x and y, each in two tables, and the legend
    assert "Not shown: z, yaw" in found


def test_models_are_told_from_logs_by_content(folder: Path, tmp_path: Path) -> None:
    disguised = tmp_path / "model.bag"
    disguised.write_bytes((folder / "paper.json").read_bytes())

    found = json_of("compare", folder / "second.bag", disguised, f"{folder / 'first.bag'}@10:", folder / "ml.json")

    assert [model["path"] for model in found["models"]] == [str(disguised), str(folder / "ml.json")]
    assert [Path(flight["path"]).name for flight in found["models"][1]["flights"]] == ["second.bag", "first.bag"]
    assert [flight["span"][0] for flight in found["models"][0]["flights"]] == [0.0, 10.0]


@pytest.mark.slow
def test_a_comparison_agrees_with_each_models_own_validation(folder: Path) -> None:
    models, log = (folder / "ml.json", folder / "paper.json"), folder / "second.bag"
    found = json_of("compare", *models, log)
    alone = [json_of("validate", model, log) for model in models]

    assert [model["flights"] for model in found["models"]] == [each["flights"] for each in alone]
    assert found["baselines"] == alone[0]["baselines"]


def test_compared_models_are_shown_side_by_side_with_their_files(folder: Path) -> None:
    found = told("compare", folder / "ml.json", folder / "paper.json", folder / "second.bag")

    assert f"model 2: {folder / 'paper.json'}" in found
    assert re.findall(r"^(?:x| ) +(model 1|model 2|hold|paper|coast) .*%$", found, re.MULTILINE)[:5] == [
        "model 1",
        "model 2",
        "hold",
        "paper",
        "coast",
    ]


def test_every_pair_of_models_and_baselines_is_tested(folder: Path) -> None:
    models, log = (folder / "ml.json", folder / "paper.json"), folder / "second.bag"
    found = json_of("compare", *models, log)

    pairs = [(test["first"], test["second"]) for test in found["paired"]]
    assert pairs == [
        ("model 1", "hold"), ("model 1", "paper"), ("model 2", "model 1"), ("model 2", "hold"), ("model 2", "paper"),
    ]  # fmt: skip
    against = found["paired"][2]["axes"]["x"]["1"]["velocity"]
    errors = [each["flights"][0]["axes"]["x"]["horizons"]["1"]["velocity_rmse"] for each in found["models"]]
    assert against["pooled"]["rmse"] == pytest.approx(errors[1] - errors[0], rel=1e-3)
    assert against["flights"][0]["rmse"] == against["pooled"]["rmse"]
    assert found["paired"][3]["axes"]["x"]["1"]["velocity"]["pooled"]["verdict"] == "better"
    assert found["paired"][0]["axes"]["z"]["1"]["velocity"]["flights"] == [None]
    text = told("compare", *models, log)
    assert re.search(r"2 vs 1 +\+[\d.]+ \([-+][\d.]+ to \+[\d.]+\) +(worse|none shown)", text)


@pytest.mark.slow
def test_a_model_beside_itself_is_not_told_apart(folder: Path) -> None:
    found = json_of("compare", folder / "ml.json", folder / "ml.json", folder / "second.bag")

    itself = next(test for test in found["paired"] if test["second"] == "model 1")["axes"]["x"]["1"]["velocity"]
    assert (itself["pooled"]["rmse"], itself["pooled"]["verdict"]) == (0.0, "no_difference_shown")


def test_a_flight_that_was_fitted_is_compared_but_proves_nothing(folder: Path) -> None:
    found = json_of("compare", folder / "ml.json", folder / "first.bag", folder / "second.bag")

    x = found["paired"][0]["axes"]["x"]["1"]["velocity"]
    assert x["flights"][0] is not None
    assert x["pooled"]["n"] == x["flights"][1]["n"]


def test_a_model_that_reads_other_motion_from_the_logs_is_not_paired(folder: Path, tmp_path: Path) -> None:
    raw = json.loads((folder / "ml.json").read_text())
    raw["card"]["frame"] = "NED"
    other = tmp_path / "ned.json"
    other.write_text(json.dumps(raw))

    found = json_of("compare", folder / "ml.json", other, folder / "second.bag")
    assert "model 1" not in {test["second"] for test in found["paired"]}
    assert found["notes"][0].startswith("model 2: its card reads other motion")


def test_what_the_residuals_say_is_printed_axis_by_axis_and_in_the_json(folder: Path) -> None:
    text, found = told(*proof(folder)), from_json(told(*proof(folder), "--json"))

    assert re.findall(r"^  - (\w): (?:not )?white \(p = ", text, re.MULTILINE) == ["x", "y"]
    axes = found["residuals"][0]["axes"]
    assert list(axes) == ["x", "y"]
    assert axes["x"]["lags"] == 30
    assert 0.5 < axes["x"]["variance_ratio"] < 2.0
    assert set(axes["x"]["optimism"]) == {"input", "damping", "delay"}


def test_a_model_whose_answer_is_wrong_gets_findings_from_validate(folder: Path, tmp_path: Path) -> None:
    raw = json.loads((folder / "ml.json").read_text())
    raw["axes"]["x"]["predictor"]["delay"] += 0.1
    wrong = tmp_path / "wrong.json"
    wrong.write_text(json.dumps(raw))

    found = done("validate", wrong, folder / "second.bag")
    assert re.search(r"warning residuals_follow_command: .*\bx\b", found)
    page = tmp_path / "report.html"
    done("report", wrong, folder / "second.bag", "-o", page)
    assert "residuals follow command" in page.read_text()


# Report


@pytest.mark.slow
def test_figures_are_written_where_they_were_asked_for(folder: Path, tmp_path: Path) -> None:
    output, figures = tmp_path / "report.html", tmp_path / "figures"

    found = json_of("report", folder / "ml.json", folder / "second.bag", "-o", output, "--figures", figures)

    assert found["figures"]
    assert sorted(found["figures"]) == sorted(str(path) for path in figures.iterdir())


def test_a_report_reads_its_logs_by_the_card_given(folder: Path, tmp_path: Path) -> None:
    own, page = load(folder / "ml.json").card, tmp_path / "report.html"
    renamed = {**own.raw, "name": "the card given", "command": {**own.raw["command"], "x": "no such column"}}
    (tmp_path / "c.toml").write_text(tomli_w.dumps(renamed))

    refused = run("report", folder / "ml.json", folder / "second.bag", "-o", page, "--card", tmp_path / "c.toml")

    assert refused.exit_code == 1
    assert "no such column" in refused.stderr
    assert not page.exists()


def test_a_report_may_be_written_again_without_a_training_log_that_has_changed_or_is_missing(
    folder: Path, tmp_path: Path
) -> None:
    log, model, page = tmp_path / "flight.bag", tmp_path / "model.json", tmp_path / "report.html"
    log.write_bytes((folder / "first.bag").read_bytes())
    done("fit", log, "--axes", "x", *LAW, "-o", model)
    log.write_bytes((folder / "second.bag").read_bytes())

    found = json_of("report", model, folder / "second.bag", "-o", page)
    log.unlink()
    missing = json_of("report", model, folder / "second.bag", "-o", page)

    assert (found["report"], found["figures"]) == (str(page), [])
    assert page.read_bytes()[:15].lower() == b"<!doctype html>"
    assert found["notes"] == [f"training flight left out: {log} is not the file that the model was fitted to"]
    assert missing["notes"] == [f"training flight left out: {log}: no such file; check the path"]


# Info, cards, formats


def test_info_shows_tables_rates_clocks_cards_and_excitation(folder: Path) -> None:
    found = done("info", folder / "first.bag")

    assert re.search(
        r"/cmd_vel: 1500 samples in 29\.9\d s at 50\.?\d* Hz, jitter .* ms, no gaps, by header.stamp", found
    )
    assert "pose.orientation.w" in found
    assert "Built-in cards that fit: rotorfit-demo" in found
    assert re.search(r"stale poses: [\d.]+ %; the fresh ones come at 1\d\d\.?\d* Hz", found)
    assert "clocks: the poses start" in found
    assert "recorder: pose stamps are logged" in found
    assert re.search(r"^  x +100 % ", found, re.MULTILINE)
    assert re.search(r"poses repeat the pose before", found)


def test_info_of_a_part_of_a_log_shows_that_part(folder: Path) -> None:
    found = done("info", f"{folder / 'first.bag'}@5:12")

    assert "7.00 s of flight in 1 segment: 5.00 to 12.00 s" in found


def test_info_of_a_log_without_a_card_says_how_to_go_on(tmp_path: Path) -> None:
    log = tmp_path / "own.csv"
    log.write_text("t,u\n" + "\n".join(f"{k / 10},{k}" for k in range(50)))

    found = done("info", log)

    assert "Built-in cards that fit: none" in found
    assert f"draft one with `rotorfit info {log} --draft-card FILE`" in found
    drafted = done("info", log, "--draft-card", tmp_path / "card.toml")
    assert f"without a command: none was found in {log}, and without one nothing can be fitted" in drafted
    assert "then rotorfit fit" not in drafted


def test_info_of_an_incomplete_draft_says_what_to_fill_in_before_a_fit(tmp_path: Path) -> None:
    log, card = tmp_path / "own.csv", tmp_path / "card.toml"
    log.write_text("t,cmd_x,x,y,yaw\n" + "\n".join(f"{k / 10},{k % 7},{k},{k},0" for k in range(50)))

    drafted = done("info", log, "--draft-card", card)

    assert "fill in [pose] z, [command] y, z, yaw (if the log has them) in the lines marked EDIT, check" in drafted
    assert f"then rotorfit fit {log}" in drafted


def test_a_drafted_card_fits_the_log(folder: Path, tmp_path: Path) -> None:
    card = tmp_path / "card.toml"
    found = json_of("info", folder / "first.bag", "--draft-card", card)

    assert found["draft_card"] == str(card)
    assert load_card(str(card)).name == load_card("rotorfit-demo").name
    by_card = json_of("fit", folder / "first.bag", "--method", "paper", "--card", card)
    assert by_card["gamma"] == json.loads((folder / "paper.json").read_text())["gamma"]


def test_a_draft_into_a_folder_that_is_not_there_says_so(folder: Path, tmp_path: Path) -> None:
    result = run("info", folder / "first.bag", "--draft-card", tmp_path / "no" / "card.toml", "--fresh")

    assert result.exit_code == 1
    assert f"there is no folder {tmp_path / 'no'}; make it first" in result.stderr


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("tune ml.json --peak 0.5", "a largest peak of the sensitivity of 0.5: give 1.2 to 3"),
        ("tune ml.json --rate 0", "a rate of 0 commands a second: give 5 to 500 commands a second"),
        ("tune ml.json --latency 2", "a latency of 2 s: give 0 to 0.5 s"),
        ("plan --card bebop2 --seed x", "x is not a whole number from 0 to"),
        ("export ml.json --to numpy --dt 0.01 -o a.py", "--dt is for --to c and --round-delay: a file of numpy is for"),
    ],
)
def test_a_value_that_cannot_be_used_is_told_with_its_range(
    folder: Path, words: str, told: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)

    result = run(*words.split())

    assert result.exit_code != 0
    assert told in result.stderr.replace("\n", " ")


def test_a_horizon_given_twice_is_scored_once(folder: Path) -> None:
    found = json_of("validate", folder / "ml.json", folder / "second.bag", "--horizons", "1,1,2")

    assert list(found["flights"][0]["axes"]["x"]["horizons"]) == ["1", "2"]


def test_info_of_several_logs_holds_one_entry_each(folder: Path) -> None:
    found = json_of("info", folder / "first.bag", folder / "second.bag")

    assert [Path(log["path"]).name for log in found["logs"]] == ["first.bag", "second.bag"]
    assert found["logs"][0]["flight"]["axes"][0]["axis"] == "x"


def test_built_in_cards_are_listed_and_printed() -> None:
    listed = done("cards")

    assert "bebop2: Parrot Bebop 2, bebop_autonomy and Vicon" in listed
    assert "/bebop/cmd_vel: log_time, linear.x" in listed
    assert "[command]" in done("cards", "bebop2")
    assert json_of("cards")["cards"]["bebop2"] == json_of("cards", "bebop2")


def test_every_format_is_listed_in_words() -> None:
    found = json_of("formats")["formats"]

    assert list(found) == list(FORMATS)
    assert all(words in done("formats") for words in found.values())


# Terminal and pipe


def test_nothing_is_wider_than_the_terminal_and_no_number_is_cut(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TTY_COMPATIBLE", "1")
    monkeypatch.setenv("COLUMNS", "80")
    log, model = folder / "first.bag", folder / "ml.json"
    monkeypatch.chdir(folder)
    for arguments in (
        ["fit", log.name, *LAW],
        ["validate", model.name, log.name],
        ["compare", model.name, model.name, log.name],
        ["info", log.name],
        ["cards"],
        ["formats"],
    ):
        lines = ANSI.sub("", done(*arguments)).splitlines()

        assert max(map(len, lines)) <= 80, arguments
        assert not any("…" in line for line in lines), arguments


def test_a_pipe_gets_whole_lines_without_colours_and_trailing_blanks(folder: Path) -> None:
    found = told("fit", folder / "first.bag", *LAW)

    assert "\x1b" not in found
    assert not any(line != line.rstrip() for line in found.splitlines())
    notes = load(folder / "ml.json").flights[0].notes
    assert f"  - {notes[0].text}" in found.splitlines()


def test_progress_is_shown_on_a_terminal_beside_clean_json(fresh: tuple[str, str, set[str]]) -> None:
    shown, said, _ = fresh

    assert from_json(shown)["format"] == "rotorfit-model"
    assert "likelihood of z" in said


# Real flights


@pytest.mark.slow
def test_a_real_flight_is_fitted_and_proved_from_the_command_line(real_flights: Path, tmp_path: Path) -> None:
    log, model = real_flights / "bebop2-wsu" / "Training_CT_TestDay_X.mat", tmp_path / "model.json"

    fitted = json_of("fit", log, "--span", ":84", "--axes", "x", "-o", model)
    scores = json_of("validate", model, log, "--span", "84:")

    assert fitted["axes"]["x"]["status"]["input"] == "ok"
    x = {"model": scores["flights"][0], "hold": scores["baselines"]["hold"]["flights"][0]}
    errors = {name: each["axes"]["x"]["horizons"]["1"]["velocity_rmse"] for name, each in x.items()}
    assert errors["model"] < errors["hold"]


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (("--try", "bebop2,wnd=1"), "--try bebop2,wnd=1: 'wnd=1' is not one of wind=NUMBER"),
        (("--try", "nobody"), "no vehicle 'nobody'"),
        (("--try", "tello"), "a command on x asks for tilt by the model's card, for velocity by the vehicle's"),
        (("--axes", "x,yaw", "--try", "bebop2"), "none for y and z: not in --axes"),
    ],
)
def test_what_no_trial_can_fly_is_refused_before_anything_is_tuned(
    words: tuple[str, ...], why: str, tmp_path: Path
) -> None:
    save(model_of(card=card_from_mapping(load_vehicle("bebop2").card(), "bebop2")), tmp_path / "m.json")

    refused = run("tune", tmp_path / "m.json", *words, "-o", tmp_path / "gains.toml")

    assert refused.exit_code == 1
    assert why in refused.stderr.replace("\n", " ")
    assert "--link" not in refused.stderr
    assert "plan" not in refused.stderr
    assert not (tmp_path / "gains.toml").exists()


def test_gains_that_no_trial_can_fly_are_shown_with_the_reason(tmp_path: Path) -> None:
    card = card_from_mapping(load_vehicle("bebop2").card(), "bebop2")
    save(model_of({"x": VEHICLE["x"]}, card), tmp_path / "m.json")

    refused = run("tune", tmp_path / "m.json", "--try", "bebop2", "-o", tmp_path / "gains.toml")
    as_json = run("tune", tmp_path / "m.json", "--try", "bebop2", "--json")

    why = "the model has no numbers (not_excited)"
    assert (refused.exit_code, as_json.exit_code) == (1, 1)
    assert "bandwidth" in refused.stdout
    assert f"Gains written to {tmp_path / 'gains.toml'}" in refused.stdout.replace("\n", "")
    assert why in refused.stderr.replace("\n", " ")
    assert from_json(as_json.stdout)["axes"]["x"]["bandwidth"] > 0
