"""What is compiled beforehand: once, in processes of its own; and a fit compiles nothing else."""

import re
import subprocess
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from numba.core.dispatcher import Dispatcher

from flights import flown, steps
from logs import CARD
from models import demo_card, model_of
from rotorfit.app import first_use
from rotorfit.app.cli import main
from rotorfit.app.first_use import FITTING, PARTS, TRACKING, VALIDATION, compile_beforehand, spread
from rotorfit.core import parallel
from rotorfit.dynamics import (
    disturbance_state,
    general_response,
    general_step,
    kinematics,
    lagged_response,
    motion_filter,
    predictor,
    response,
    whitening,
)
from rotorfit.estimation.fitting import fit
from rotorfit.files.models import save
from rotorfit.simulation.paper_vehicle import Truth
from rotorfit.tracking.replayed import tracked


class Process:
    """One that has ended as soon as it is looked at."""

    started: list[list[str]]

    def __init__(self, words: list[str], **_: Any) -> None:
        self.started.append(words[4:])

    def poll(self) -> int:
        return 0

    def wait(self) -> int:
        return 0


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[list[str]]:
    """Names of the parts of each process that would be started, where nothing is compiled yet."""
    monkeypatch.setattr(Process, "started", [], raising=False)
    monkeypatch.setattr(subprocess, "Popen", Process)
    monkeypatch.setattr(first_use, "_mark", lambda part: tmp_path / "folder" / part)
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "kernel.nbi").touch()
    return Process.started


def test_all_parts_are_compiled_once(started: list[list[str]]) -> None:
    compile_beforehand(TRACKING)

    assert sorted(name for names in started for name in names) == sorted(PARTS)
    started.clear()
    compile_beforehand(TRACKING)
    assert not started


def test_marks_beside_which_nothing_is_compiled_are_not_believed(started: list[list[str]], tmp_path: Path) -> None:
    for _ in range(2):
        started.clear()
        compile_beforehand(FITTING)
        (tmp_path / "folder" / "kernel.nbi").unlink(missing_ok=True)
        assert started


def test_what_a_busy_machine_did_not_finish_in_time_is_begun_again(
    started: list[list[str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(first_use, "PATIENCE", 0.0)
    monkeypatch.setattr(Process, "poll", lambda _self: None)
    monkeypatch.setattr(Process, "kill", lambda _self: None, raising=False)
    for _ in range(2):
        started.clear()
        compile_beforehand(FITTING)
        assert started


def test_what_was_asked_for_is_compiled_and_later_only_the_rest(started: list[list[str]]) -> None:
    compile_beforehand(VALIDATION)

    assert sorted(name for names in started for name in names) == sorted(VALIDATION)
    started.clear()
    compile_beforehand(FITTING)
    assert sorted(name for names in started for name in names) == sorted(set(FITTING) - set(VALIDATION))


def test_where_nothing_can_be_written_the_fit_goes_on(
    started: list[list[str]], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setattr(first_use, "_mark", lambda part: tmp_path / "file" / part)

    compile_beforehand(FITTING)

    assert started


def test_where_no_process_can_be_started_the_fit_goes_on(
    started: list[list[str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*_: Any, **__: Any) -> None:
        raise PermissionError

    monkeypatch.setattr(subprocess, "Popen", refused)

    compile_beforehand(FITTING)

    assert not started


def test_what_is_compiled_for_long_is_told(started: list[list[str]], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parallel, "processors", lambda: 1)
    told: list[str] = []
    for wanted in (FITTING, TRACKING):
        ends = iter([None, None, 0] + [0] * 100)
        monkeypatch.setattr(Process, "poll", lambda _, ends=ends: next(ends))
        compile_beforehand(wanted, lambda _, text: told.append(text))

    assert started
    parts = [text.partition(", once after an installation: ")[0] for text in told]
    assert list(dict.fromkeys(parts)) == ["compiling the estimator", "compiling what follows a vehicle"]


SHORT = "time,cmd_x,x,y,z,yaw\n" + "".join(f"{i / 50},1,{i},{i},{i},0\n" for i in range(20))

UNCOMMANDED = re.sub('[xyzaw]+ = "cmd_.*\n', "", CARD)
GOOD = UNCOMMANDED.replace("[pose]", 'x = "cmd_x"\n[pose]')


@pytest.mark.parametrize("card", [GOOD, UNCOMMANDED], ids=["good", "uncommanded"])
@pytest.mark.parametrize(
    "words",
    [
        ["fit", "short.csv", "--card", "card.toml"],
        ["fit", "missing.csv", "--card", "card.toml"],
        ["track", "short.csv", "--card", "card.toml"],
        ["validate", "model.json", "short.csv", "--card", "card.toml"],
        ["compare", "model.json", "model.json", "short.csv"],
        ["report", "model.json", "short.csv", "--card", "card.toml", "-o", "page.html"],
        ["fly", "plan.toml", "--link", "sim", "--track", "-o", "flight.mcap"],
    ],
    ids=" ".join,
)
def test_errors_of_files_come_before_anything_is_compiled(
    words: list[str], card: str, started: list[list[str]], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("short.csv").write_text(SHORT)
    Path("card.toml").write_text(card)
    Path("plan.toml").write_text("")
    save(model_of(card=demo_card()), Path("model.json"))

    result = CliRunner().invoke(main, words)

    assert result.exit_code == 1, result.output
    assert "Error: " in result.stderr
    assert not started


@pytest.mark.parametrize("processes", [1, 2, 4, 99])
def test_parts_are_spread_over_the_processors(processes: int) -> None:
    shares = spread({"a": 8.0, "b": 5.0, "c": 3.0, "d": 1.0}, processes)

    assert sorted(name for share in shares for name in share) == ["a", "b", "c", "d"]
    assert len(shares) == min(processes, 4)
    if processes == 2:
        assert shares == [["a", "d"], ["b", "c"]]


def test_a_fit_and_a_tracker_compile_nothing_else() -> None:
    modules = (
        disturbance_state, general_response, general_step, kinematics, lagged_response, motion_filter, predictor,
        response, whitening,
    )  # fmt: skip
    kernels = [one for module in modules for one in vars(module).values() if isinstance(one, Dispatcher)]
    for _, part in PARTS.values():
        part()
    before = {kernel.__name__: len(kernel.signatures) for kernel in kernels}

    flight = flown(Truth(), steps(), 15.0)
    fit((flight,))
    assert {kernel.__name__: len(kernel.signatures) for kernel in kernels} == before
    assert any(one.axes["x"].wind is not None for one in tracked(flight, "first_order_delay").states)
    assert {kernel.__name__: len(kernel.signatures) for kernel in kernels} == before
