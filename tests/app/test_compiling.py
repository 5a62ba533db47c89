"""The line about compiling: where it is worth it, once, and on a terminal only."""

from types import SimpleNamespace

import pytest
from numba.core import event

from rotorfit.app import first_use
from rotorfit.app.cli import compiling
from rotorfit.app.cli.compiling import compiling_announced
from rotorfit.app.cli.options import compiled_beforehand
from rotorfit.core.progress import Progress


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The time, to be moved, on what passes for a terminal."""
    now = [0.0]
    monkeypatch.setattr(compiling, "perf_counter", lambda: now[0])
    on_terminal(monkeypatch, True)
    return now


def on_terminal(monkeypatch: pytest.MonkeyPatch, yes: bool) -> None:
    monkeypatch.setattr(compiling, "sys", SimpleNamespace(stderr=SimpleNamespace(isatty=lambda: yes)))


def compiled(clock: list[float], *seconds: float) -> None:
    """Functions that call each other, the outermost first."""
    with event.trigger_event("numba:compile"):
        clock[0] += seconds[0]
        if seconds[1:]:
            compiled(clock, *seconds[1:])


def test_what_takes_its_time_is_said_once(clock: list[float], capsys: pytest.CaptureFixture[str]) -> None:
    with compiling_announced():
        for _ in range(5):
            compiled(clock, 0.3, 0.1)

    assert capsys.readouterr() == ("", compiling.LINE + "\n")


def test_what_other_processes_compile_is_said_at_once_and_not_again(
    clock: list[float], capsys: pytest.CaptureFixture[str]
) -> None:
    assert first_use.TEXT.startswith(compiling.COMPILING)
    with compiling_announced() as announce:
        announce()
        assert capsys.readouterr().err == compiling.LINE + "\n"
        compiled(clock, 5.0)
        announce()

    assert capsys.readouterr().err == ""


def test_one_long_compilation_is_said_while_it_lasts(clock: list[float], capsys: pytest.CaptureFixture[str]) -> None:
    with compiling_announced(), event.trigger_event("numba:compile"):
        clock[0] += 1.5
        compiled(clock, 0.1)
        assert capsys.readouterr().err == compiling.LINE + "\n"


def test_other_work_between_short_compilations_does_not_count(
    clock: list[float], capsys: pytest.CaptureFixture[str]
) -> None:
    with compiling_announced():
        for _ in range(3):
            compiled(clock, 0.1)
            clock[0] += 100

    assert capsys.readouterr().err == ""


def test_nothing_is_said_in_a_pipe(
    clock: list[float], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    on_terminal(monkeypatch, False)
    with compiling_announced():
        compiled(clock, 60)

    assert capsys.readouterr().err == ""


def test_a_tracker_says_in_a_pipe_too_what_it_waits_for(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def compiles(_wanted: object, progress: Progress) -> None:
        for second in range(3):
            progress(0.0, f"{first_use.TEXT}: {second} s")

    monkeypatch.setattr(first_use, "compile_beforehand", compiles)
    compiled_beforehand()

    assert capsys.readouterr() == ("", first_use.TEXT + "\n")
