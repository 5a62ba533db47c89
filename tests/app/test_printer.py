"""Printing from a thread: a reader who stalls holds up nobody, and what is left out is counted."""

import threading
import time

import pytest

from rotorfit.app.terminal import printer
from rotorfit.app.terminal.printer import Printer


def test_what_a_stalled_reader_leaves_waiting_comes_later_in_order_without_the_states_too_many(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(printer, "MOST", 3)
    read, lines, out = threading.Event(), list[int](), Printer(beside=True)
    out.take(lambda: read.wait(10.0) and None)
    for number in range(6):
        out.take(lambda number=number: lines.append(number), spare=number != 4)  # type: ignore[misc]

    assert not lines
    read.set()
    assert out.close(patient=True)
    assert lines == [0, 1, 4]
    assert out.spared == 3


def test_only_a_reader_who_takes_nothing_has_stalled_and_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(printer, "STALLED", 0.3)
    read, out = threading.Event(), Printer(beside=True)
    for _ in range(10):
        out.take(lambda: time.sleep(0.1))
    time.sleep(0.5)
    assert not out.stalled
    out.take(lambda: read.wait(10.0) and None)

    assert not out.close(patient=False)
    assert out.stalled
    read.set()
    assert out.close(patient=True)


def test_what_must_be_told_comes_elsewhere_where_the_reader_is_gone() -> None:
    lines, streams = list[str](), ["pipe"]

    def write(text: str) -> None:
        if streams[0] == "pipe":
            raise BrokenPipeError(32, "Broken pipe")
        lines.append(text)

    out = Printer(beside=True, redirects=[lambda: streams.insert(0, "stderr")])
    out.take(lambda: write("state"), spare=True)
    out.take(lambda: write("alarm"))
    out.take(lambda: write("state"), spare=True)

    assert out.close(patient=True)
    assert lines == ["alarm"]
    assert out.fault == "Broken pipe"
    assert not out.spared


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")  # it is what is wanted
def test_a_bug_in_what_prints_is_not_waited_for() -> None:
    out = Printer(beside=True)
    out.take(lambda: [][0])

    with pytest.raises(RuntimeError, match="has failed"):
        out.close(patient=True)
