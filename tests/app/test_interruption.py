"""Ctrl-C, wherever it strikes: one word and exit code 1, never a crash of the interpreter."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from types import FunctionType

import pytest
from click.testing import CliRunner

from rotorfit.app.cli import main
from rotorfit.app.cli.interruption import safe_interrupts

STRUCK = """
import os, signal
from llvmlite.binding.executionengine import ExecutionEngine

plain = ExecutionEngine._find_module_ptr

def struck(self, pointer):  # called back by LLVM, which asks for the code of a module
    os.kill(os.getpid(), signal.SIGINT)
    return plain(self, pointer)

ExecutionEngine._find_module_ptr = struck
from rotorfit.app.cli import main
main()
"""


@pytest.fixture(autouse=True)
def _interruptible() -> Iterator[None]:
    """A shell starts what it runs in the background with Ctrl-C ignored, and processes inherit that."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def test_an_interrupt_while_llvm_asks_for_compiled_code_ends_cleanly() -> None:
    words = ("plan", "--card", "rotorfit-demo", "--axes", "z", "--duration", "12")
    assert CliRunner().invoke(main, words).exit_code == 0  # compiled and kept

    done = subprocess.run([sys.executable, "-c", STRUCK, *words], capture_output=True, text=True, timeout=120)

    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.strip() == "Aborted!"


def test_an_interrupt_waits_while_a_frame_of_llvmlite_is_on_the_stack_and_strikes_after_it() -> None:
    at = list[str]()

    def inside() -> None:
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0.05)  # the retries come and go
        at.append("inside")

    callback = FunctionType(inside.__code__, {**globals(), "__name__": "llvmlite.binding"}, closure=inside.__closure__)

    def struck() -> None:
        with safe_interrupts():
            callback()
            at.append("after")
            time.sleep(1.0)
            at.append("never")

    with pytest.raises(KeyboardInterrupt):
        struck()
    assert at == ["inside", "after"]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_an_interrupt_that_strikes_a_compiled_function_as_it_returns_is_an_interrupt() -> None:
    """CPython turns an exception that a C function leaves behind beside its result into a SystemError."""
    with pytest.raises(KeyboardInterrupt), safe_interrupts():
        raise SystemError("returned a result with an exception set") from KeyboardInterrupt()
    with pytest.raises(SystemError, match="another"), safe_interrupts():
        raise SystemError("another") from ValueError()


def test_whoever_else_handles_the_signal_is_left_alone() -> None:
    told = list[int]()
    before = signal.signal(signal.SIGINT, lambda number, _: told.append(number))
    try:
        with safe_interrupts():
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(0.01)
    finally:
        signal.signal(signal.SIGINT, before)
    assert told == [signal.SIGINT]


BESIDE = """
import time
import click
from rotorfit.app.cli import main
from rotorfit.core import parallel

parallel.processors = lambda: 2

@main.command("wait")
def wait():
    click.echo("begun")
    list(parallel.each(lambda _: time.sleep(60.0), range(2), parallel.LONG))

main()
"""


def test_an_interrupt_does_not_wait_for_work_in_threads() -> None:
    with subprocess.Popen(
        [sys.executable, "-u", "-c", BESIDE, "wait"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout
        assert process.stderr
        assert process.stdout.readline() == "begun\n"
        time.sleep(0.5)  # the threads have begun
        process.send_signal(signal.SIGINT)
        assert process.wait(timeout=30.0) == 1
        assert process.stderr.read().strip() == "Aborted!"
