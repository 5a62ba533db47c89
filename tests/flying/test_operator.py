"""The operator's abort at a terminal."""

import os
import pty
import sys
import termios
import threading
import time
from contextlib import suppress

import pytest

from rotorfit.flying.operator import operator_abort


def test_a_paused_terminal_does_not_hold_up_the_end_and_gets_its_mode_back(monkeypatch: pytest.MonkeyPatch) -> None:
    master, slave = pty.openpty()
    mode, ended = termios.tcgetattr(slave), threading.Event()
    monkeypatch.setattr(sys, "stdin", os.fdopen(slave))

    def printing() -> None:
        with suppress(OSError):  # the terminal is closed
            os.write(slave, b"a line\n" * 100_000)

    def session() -> None:
        with operator_abort() as abort:
            assert not abort()
            threading.Thread(target=printing, daemon=True).start()
            time.sleep(0.3)  # nobody reads it, and it waits
        ended.set()

    threading.Thread(target=session, daemon=True).start()
    in_time = ended.wait(5.0)
    restored = termios.tcgetattr(slave)
    os.close(master)
    ended.wait(5.0)
    sys.stdin.close()

    assert in_time
    assert restored == mode
