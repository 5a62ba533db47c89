"""The documents say what is: their blocks run, and what they list is what the code knows."""

import ast
import re
import shlex
import sys
import tomllib
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import click
import numpy as np
import pytest
from click.testing import CliRunner
from matplotlib.figure import Figure
from mypy import api as mypy

import rotorfit
from rotorfit.app.cli import main
from rotorfit.assessment import advice, coefficient_findings, plausibility, whiteness
from rotorfit.core.frames import AXES, UNIT_SCALE
from rotorfit.diagnosis import clock_checks, command_checks, doctor, frame_checks, motion_checks, pose_checks
from rotorfit.diagnosis.globe import metres_per_degree
from rotorfit.dynamics import protocol as forecast
from rotorfit.estimation.identifiability import LEAST_TIME, WIDEST_DELAY, WIDEST_INPUT
from rotorfit.estimation.likelihood import axis_estimate as estimate
from rotorfit.estimation.likelihood import blocks as record
from rotorfit.estimation.likelihood import feedback
from rotorfit.estimation.likelihood import optima as modes
from rotorfit.estimation.likelihood import parameters as point
from rotorfit.estimation.likelihood.coefficients import DIVERGED, WIDEST_DAMPING
from rotorfit.estimation.methods import METHODS
from rotorfit.estimation.regression import paper as regression
from rotorfit.exports.formats import FORMATS as EXPORT_FORMATS
from rotorfit.files import cards as card_file
from rotorfit.files.cards import builtin_cards, card_from_mapping, load_card
from rotorfit.files.logs import FORMATS
from rotorfit.files.logs.formats import FORMATS as LOG_FORMATS
from rotorfit.flying.links import LINKS
from rotorfit.planning.signals import two_sines
from rotorfit.simulation.paper_vehicle import Truth, simulate_flight

pytestmark = pytest.mark.flights

ROOT = Path(__file__).resolve().parents[1]
sys.path.append(str(ROOT / "examples"))
from two_flights import two_flights  # noqa: E402

README = (ROOT / "README.md").read_text(encoding="utf-8")
CARDS, FINDINGS, METHOD, ARCHITECTURE = (
    (ROOT / "docs" / f"{name}.md").read_text(encoding="utf-8")
    for name in ("cards", "findings", "method", "architecture")
)
DOCUMENTS = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/*.md")])


def blocks(text: str, language: str) -> list[str]:
    """Contents of the fenced blocks of a language."""
    return re.findall(rf"^```{language}\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)


def section(text: str, title: str) -> str:
    """What stands under a heading of the second level."""
    return re.split(r"^## ", text.split(f"\n## {title}\n")[1], maxsplit=1, flags=re.MULTILINE)[0]


def commands(text: str) -> list[list[str]]:
    """The lines of the shell blocks as words."""
    lines = (line for block in blocks(text, "sh") for line in block.splitlines())
    return [words for line in lines if (words := shlex.split(line, comments=True))]


@cache
def calls_in(module: Path) -> list[ast.Call]:
    """All calls of a module."""
    nodes = ast.walk(ast.parse(module.read_text(encoding="utf-8")))
    return [node for node in nodes if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)]


def codes_in(path: str, name: str) -> set[str]:
    """First arguments, written out, of all calls of a name in the modules of a folder, or in one of them."""
    place = ROOT / "src" / "rotorfit" / path
    calls = (call for module in (place.rglob("*.py") if place.is_dir() else [place]) for call in calls_in(module))
    firsts = (call.args[0] for call in calls if call.func.id == name and call.args)  # type: ignore[attr-defined]
    return {first.value for first in firsts if isinstance(first, ast.Constant) and isinstance(first.value, str)}


def undocumented() -> set[str]:
    """Formats, methods, exports and links that have no row in the table of their page."""
    tables = {
        "format": ("formats", LOG_FORMATS),
        "method": ("ladder", METHODS),
        "export": ("exports", EXPORT_FORMATS),
        "link": ("links", LINKS),
    }
    rows = {
        kind: " ".join(line for line in page_of(page).splitlines() if line.startswith("|"))
        for kind, (page, _) in tables.items()
    }
    return {f"{kind} {name}" for kind, (_, table) in tables.items() for name in table if f"`{name}" not in rows[kind]}


def page_of(name: str) -> str:
    return (ROOT / f"docs/{name}.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def walked(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Path, dict[str, str]]]:
    """A folder with a user's two logs after the shell blocks of the README were run in it, and what they printed.

    The files of the figures stay empty: to draw them takes longer than all else, and `reporting/test_report.py` does.
    """
    folder = tmp_path_factory.mktemp("user")
    two_flights(folder, (25.0, 10.0))
    printed = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setattr(Figure, "savefig", lambda *_, **__: None)
        for program, *words in commands(section(README, "Your own log in five minutes")):
            assert program == "rotorfit"
            result = CliRunner().invoke(main, words)
            assert result.exit_code == 0, result.output
            printed[words[0]] = result.output
        yield folder, printed


def test_the_five_minutes_of_the_readme_run_and_leave_a_model_a_report_and_figures(
    walked: tuple[Path, dict[str, str]],
) -> None:
    folder, printed = walked

    assert list(printed) == ["info", "fit", "validate", "report"]
    assert "Known: input gain, damping and delay of " in printed["fit"]
    assert {path.name for path in folder.iterdir()} == {
        "flight1.csv", "flight2.csv", "my-drone.toml", "model.json", "report.html", "figures",
    }  # fmt: skip


def test_the_card_that_the_readme_shows_is_the_one_that_is_drafted(walked: tuple[Path, dict[str, str]]) -> None:
    (shown,) = blocks(section(README, "Your own log in five minutes"), "toml")

    assert load_card(str(walked[0] / "my-drone.toml")).raw == tomllib.loads(shown)


def test_the_csv_that_the_readme_shows_has_the_columns_of_the_one_that_was_fitted(
    walked: tuple[Path, dict[str, str]],
) -> None:
    first_line = (walked[0] / "flight1.csv").read_text().splitlines()[0]

    assert first_line in README


def test_the_library_example_is_ten_lines_and_runs_as_printed(
    walked: tuple[Path, dict[str, str]], capsys: pytest.CaptureFixture[str]
) -> None:
    example, use = blocks(section(README, "As a library"), "python")
    (walked[0] / "model.json").unlink()

    exec(compile(example, "README.md", "exec"), {})
    exec(compile(use, "README.md", "exec"), {})

    assert sum(bool(line.strip()) for line in example.splitlines()) == 10
    x = rotorfit.load(walked[0] / "model.json").axes["x"]
    assert x.status == {"input": "ok", "damping": "ok", "delay": "ok"}
    assert x.input == pytest.approx(Truth().gamma[0], rel=0.1)
    printed = capsys.readouterr().out
    assert str(x.input) in printed
    assert "nan" not in printed
    assert "None" not in printed


def test_the_recipe_of_the_library_makes_a_flight_of_arrays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recipe = section(page_of("api"), "From arrays to a flight")
    (example,), (card,) = blocks(recipe, "python"), blocks(recipe, "toml")
    (tmp_path / "arrays.toml").write_text(card)
    monkeypatch.chdir(tmp_path)
    flown = simulate_flight(Truth(), two_sines, 10.0, 1)
    given: dict[str, Any] = {
        "pose_time": flown.pose_stamp / 1e9, "pose": flown.pose,
        "command_time": flown.command_stamp / 1e9, "command": flown.command,
    }  # fmt: skip

    exec(compile(example, "docs/api.md", "exec"), given)

    flight = given["flight"]
    np.testing.assert_array_equal(flight.command, flown.command)
    assert len(flight.pose_time) > 0.9 * len(flown.pose)
    assert np.isin(flight.position[:, 0], flown.pose[:, 0]).all()


def test_the_examples_pass_mypy_strict_so_that_users_see_the_real_signatures(tmp_path: Path) -> None:
    for number, example in enumerate(blocks(README, "python")):
        (tmp_path / f"example{number}.py").write_text(example)
    (tmp_path / "wrong.py").write_text("import rotorfit\n\nrotorfit.fit(3)\nrotorfit.no_such_name\n")
    options = ["--strict", "--config-file", str(ROOT / "pyproject.toml"), "--cache-dir", str(ROOT / ".mypy_cache")]

    said, _, code = mypy.run([*options, *map(str, sorted(tmp_path.glob("*.py")))])

    errors = [line for line in said.splitlines() if ": error: " in line]
    assert code == 1, said
    assert [Path(line.partition(":")[0]).name for line in errors] == ["wrong.py"], said
    assert errors[0].endswith("[arg-type]")


def test_every_command_of_the_documents_is_one_of_the_command_line() -> None:
    spoken = [
        shlex.split(code)
        for document in DOCUMENTS
        for code in re.findall(r"`(rotorfit [^`\n]+)`", document.read_text(encoding="utf-8"))
    ]
    for program, *words in [*commands(README), *spoken]:
        if program != "rotorfit" or words[0] in ("VERB", "--help", "--version"):
            continue
        verb = main.commands[words[0]]
        known = {
            option for parameter in verb.params if isinstance(parameter, click.Option) for option in parameter.opts
        }
        asked = {word for word in words[1:] if re.fullmatch(r"--?[a-z][a-z-]*", word)}
        assert asked <= {*known, "--help"}, " ".join(words)


def test_every_make_target_of_the_readme_is_in_the_makefile() -> None:
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))

    assert {words[1] for words in commands(README) if words[0] == "make"} == {"demo", "test"}
    assert targets >= {"demo", "test"}


def test_the_readme_names_every_format_every_built_in_card_and_every_verb() -> None:
    formats = section(README, "Formats and vehicles")

    assert set(re.findall(r"^\| `(\w+)` \|", formats, re.MULTILINE)) == set(FORMATS)
    assert {name for name in builtin_cards() if f"`{name}`" not in formats} == set()
    assert {verb for verb in main.commands if f"rotorfit {verb}" not in README} <= {"demo"}


def test_every_finding_of_the_code_is_in_the_documents_and_the_other_way_round() -> None:
    described = re.findall(r"^### `(\w+)`$", section(FINDINGS, "Findings"), re.MULTILINE)
    told = codes_in("", "Finding")
    assert sorted(described) == sorted(told)


def test_every_finding_has_one_row_that_says_where_it_was_seen_in_a_test_that_is_there() -> None:
    described = re.findall(r"^### `(\w+)`$", section(FINDINGS, "Findings"), re.MULTILINE)
    rows = section(FINDINGS, "Where each finding was seen")
    assert sorted(re.findall(r"^\| `(\w+)` \|", rows, re.MULTILINE)) == sorted(described)
    assert all((ROOT / "tests" / name).exists() for name in re.findall(r"\| `(\w+/\w+\.py)` \|", rows))


CLOSED = {"commands_outside_window", "commands_on_ground", "idle_commands"}
"""Notes of what `kept` leaves out of the commands."""


def test_every_note_of_the_code_is_in_the_documents() -> None:
    notes = section(FINDINGS, "Notes")
    codes = codes_in("", "Note") | CLOSED

    assert len(codes) >= 7
    assert {code for code in codes if f"`{code}`" not in notes} == set()


def test_every_status_that_a_coefficient_can_have_is_in_the_documents() -> None:
    statuses = re.findall(r"^\| `(\w+)` \|", section(FINDINGS, "Statuses"), re.MULTILINE)

    assert sorted(statuses) == [
        "diverged",
        "not_excited",
        "not_fitted",
        "not_identifiable",
        "ok",
        "pose_frozen",
        "refuted",
        "too_short",
    ]
    assert {status for status in statuses if f"`{status}`" not in METHOD} == set()


def test_the_figures_of_the_method_are_those_of_the_code() -> None:
    low, high = record.DELAY_RANGE
    told = (
        f"blocks of 1/{record.BLOCK_RATE:g} s",
        f"tau from {low:g} to {high:g} s",
        f"scored from {high:g} s on",
        f"b from {point.DAMPING_RANGE[0]:g} to {point.DAMPING_RANGE[1]:g} 1/s",
        f"within {np.degrees(record.HELD_HEADING):g} degrees",
        f"within {100 * modes.ALIKE:g} % of it",
        f"a damping above {np.exp(modes.BACKWARDS):g} 1/s",
        f"that share is {estimate.HELPS:g}",
        f"feedback loop it is {estimate.EXPLAINS:g}",
        f"more than {feedback.SUSPICIOUS_SIGMAS:g} standard deviations",
        f"from {feedback.LOOP_SIGMAS:g} on it counts as shown",
        f"below {estimate.PLAINLY:g} of that of holding",
        f"wider than {WIDEST_DELAY:g} s",
        f"more than a factor of {WIDEST_DAMPING:g}, the input's a factor of {WIDEST_INPUT:g}",
        f"less than {LEAST_TIME:g} s can be scored",
        f"gain more than {DIVERGED:g}",
        f"gives {forecast.SETTLING:g} s to the model's own causal filter",
        f"every {forecast.START_EVERY:g} s",
        f"fewer than {forecast.LEAST_SCORES} give no score",
        f"a hole of {forecast.LONGEST_GAP:g} s",
        f"autocorrelations over {whiteness.REACH:g} s",
        f"command of up to {whiteness.REACH:g} s before, every {whiteness.COMMAND_EVERY:g} s",
        f"ask for p below {whiteness.FINDING_LEVEL:g}",
        f"degree {regression.DEGREE} over +-{regression.HALF_WIDTH:g} s, at least {regression.LEAST} poses",
        {6: "six starts"}[len(modes.STARTS)],
        {60.0: "the minute"}[modes.EXCERPT],
    )

    assert [phrase for phrase in told if phrase not in METHOD] == []


def test_the_figures_of_the_findings_are_those_of_the_code() -> None:
    low, high = record.DELAY_RANGE
    told = (
        f"{low:g} or {high:g} s",
        f"less than {LEAST_TIME:g} s of the flights",
        f"delay wider than {WIDEST_DELAY:g} s",
        f"more than a factor of {WIDEST_DAMPING:g} apart; of the input gain, a factor of {WIDEST_INPUT:g}",
        f"is wider than {WIDEST_DELAY:g} s or open",
        f"spans more than a factor of {WIDEST_DAMPING:g}",
        f"more than {100 * coefficient_findings.WEAK_GAIN:g} % of it",
        f"above {plausibility.LIMIT_MARGIN:g} times, or below 1 / {plausibility.LIMIT_MARGIN:g} times",
        f"beyond {plausibility.GAIN_SYMMETRY:g}, or that of their dampings beyond {plausibility.DAMPING_SYMMETRY:g}",
        f"more than a factor of {plausibility.ALIKE:g} outside",
        f"A warning where it is {whiteness.OPTIMISTIC:g} or more",
        f"beyond chance (p below {whiteness.FINDING_LEVEL:g})",
        f"less than {doctor.SHORT_TIME:g} s together",
        f"more than {100 * command_checks.SATURATED_SHARE:g} % of its samples",
        f"More than {100 * clock_checks.STALE_SHARE:g} % of the poses",
        f"less than {100 * command_checks.SLOW_SHARE:g} % of the power lies above {command_checks.SLOW_FREQUENCY:g} Hz",
        f"less than {100 * advice.NEEDED_SHARE:g} % lies in the band",
        f"correlation is beyond {command_checks.ALIKE:g}",
        f"correlation beyond {motion_checks.FOLLOWS:g}",
        f"less than {100 * motion_checks.EXPLAINED:g} % of the acceleration",
        f"more than {motion_checks.LATCH_TIME:g} s and {motion_checks.LATCH_CHANGES:g} times the usual time",
        f"more than {motion_checks.LATCH_UNEXPLAINED:g} times that elsewhere",
        f"more than {100 * motion_checks.LATCH_MOTION:g} % of the changes under changing commands",
        f"stays within {coefficient_findings.FAR_INSIDE:g} s of it",
        f"that stay within {pose_checks.FEW_DEGREES:g}, are in degrees",
        f"more than {feedback.LOOP_SIGMAS:g} standard deviations of an open loop",
        f"of more than {np.degrees(frame_checks.OFF):g} degrees and {frame_checks.SIGNIFICANT:g} standard errors",
        f"more than {pose_checks.FASTEST:g} m/s or {pose_checks.HARDEST:g} m/s^2",
        f"no more than {100 * pose_checks.SMALLEST:g} cm of travel",
        f"more than {pose_checks.FASTEST_TURN:g} rad/s of turning",
        f"beyond {command_checks.FRACTION_LIMIT:g} where they are a fraction",
        f"{pose_checks.LEAP_SIGMAS:g} robust standard deviations",
        f"come back within {pose_checks.RETURN:g} s",
        f"from {clock_checks.LONG_HOLE:g} s or {100 * clock_checks.LOST_SHARE:g} % on",
        f"Warning from {100 * clock_checks.LARGE_LOSS:g} % of the time on",
        f"each loses its first {clock_checks.SETTLING_LOSS:g} s",
        f"more than {1e3 * clock_checks.LEAST_JITTER:g} ms",
        f"more than {1e3 * clock_checks.DRIFT_GROWTH:g} ms on that of the commands",
        f"more than {1e3 * clock_checks.CLOCK_OFFSET:g} ms apart",
    )

    assert [phrase for phrase in told if phrase not in FINDINGS] == []


def test_the_complete_card_of_the_documents_loads_and_holds_every_key() -> None:
    (text,) = blocks(section(CARDS, "A complete card"), "toml")
    complete = card_from_mapping(tomllib.loads(text), "docs/cards.md")
    keys = set(re.findall(r"^#? ?(\w+) = ", text, re.MULTILINE)) | set(re.findall(r"[{,] (\w+) = ", text))

    assert set(complete.command) == set(AXES)
    assert set(complete.velocity) == set(complete.reference) == set(AXES)
    assert keys == known_keys()


def test_the_card_for_latitude_and_longitude_is_in_metres() -> None:
    (text,) = blocks(section(CARDS, "Units, by example"), "toml")
    card = card_from_mapping(tomllib.loads(text), "docs/cards.md")
    east, north = metres_per_degree(47.4)
    assert card.pose["x"].scale == pytest.approx(east, rel=2e-4)
    assert card.pose["y"].scale == pytest.approx(north, rel=2e-4)


def test_every_line_that_shows_a_unit_is_one_of_a_card() -> None:
    lines = re.findall(r"^\| .+? \| `(\w+ = \{[^`]+)`", section(CARDS, "Units, by example"), re.MULTILINE)
    assert len(lines) >= 8
    for line in lines:
        (value,) = tomllib.loads(line).values()
        place = "limits" if "value" in value else "command" if "meaning" in value else "pose"
        raw = {
            "command": {"time": "t", "z": "up"},
            "pose": {"time": "t", **{axis: f"pose_{axis}" for axis in AXES}},
            **({"limits": {}} if place == "limits" else {}),
        }
        if value.get("unit") == "cm/s":
            place, raw = "velocity", {**raw, "velocity": {}}
        raw[place] |= tomllib.loads(line)
        card_from_mapping(raw, line)


def test_every_key_and_every_unit_of_a_card_is_explained() -> None:
    tables = section(CARDS, "Every key")
    explained = {name for cell in re.findall(r"`([^`]+)`", tables) for name in cell.split()}

    assert known_keys() - explained == set()
    assert set(UNIT_SCALE) - explained == set()


def known_keys() -> set[str]:
    """Every key that `files/cards.py` lets pass: of its sections, and written out where keys are checked."""
    tree = ast.parse((ROOT / "src/rotorfit/files/cards.py").read_text(encoding="utf-8"))
    checks = [
        node
        for node in ast.walk(tree)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "_check_keys"
    ]
    constants = (node for check in checks for node in ast.walk(check.args[1]) if isinstance(node, ast.Constant))
    written = {node.value for node in constants if isinstance(node.value, str)}
    assert written >= {"name", "from", "scale"}
    sections = card_file._SECTIONS.values()
    return written | {key for keys in (*sections, card_file._OF_COMMANDS, card_file._OF_CLOCKS) for key in keys}


def test_the_architecture_lists_every_package_and_names_modules_that_are_there() -> None:
    rows = re.findall(r"^\| `(\w+)` \|.*\| (.+) \|$", section(ARCHITECTURE, "The packages"), re.MULTILINE)
    package = ROOT / "src/rotorfit"
    named = [package / name / module for name, modules in rows for module in re.findall(r"`([\w/]+)`", modules)]
    located = re.findall(r"`([a-z_]+/[\w/]+(?:\.py|/))`", section(ARCHITECTURE, "Where is ..."))

    assert sorted(name for name, _ in rows) == sorted(path.parent.name for path in package.glob("*/__init__.py"))
    assert [path for path in named if not path.is_dir() and not path.with_suffix(".py").is_file()] == []
    assert [path for path in located if not (package / path).exists()] == []


def test_links_and_pictures_of_the_documents_lead_somewhere() -> None:
    for document in DOCUMENTS:
        text = document.read_text(encoding="utf-8")
        for target in re.findall(r"\]\(([^)]+)\)", text):
            if target.startswith("https://"):
                continue
            path, _, anchor = target.partition("#")
            page = document.parent / path if path else document
            assert page.exists(), f"{document.name}: {target}"
            assert not anchor or anchor in anchors(page), f"{document.name}: {target}"


def anchors(page: Path) -> set[str]:
    """What the headings of a page can be linked by."""
    headings = re.findall(r"^#+ (.+)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_the_changelog_has_an_entry_of_this_version() -> None:
    assert f"## [{rotorfit.__version__}]" in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")


def test_tests_that_the_documents_name_are_there() -> None:
    named = {path for page in DOCUMENTS for path in re.findall(r"tests/[\w/]+\.py", page.read_text(encoding="utf-8"))}

    assert len(named) > 10
    assert {path for path in named if not (ROOT / path).is_file()} == set()
