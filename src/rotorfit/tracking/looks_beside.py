"""Looks in a process of their own, beside the one that feeds samples; `looking` is that process.

A look takes tens of milliseconds and a refit seconds. Python lets one thread compute at a time, and most of a refit is
not compiled: in a thread it would stall the feeding one for 60 ms, in a process it does not. The process receives what
is new of the flight and makes the same looks in the same order, so the states are the same.
"""

import os
import pickle
import queue
import subprocess
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import IO, Any

from rotorfit.core.card import Card
from rotorfit.core.errors import LinkError
from rotorfit.core.model import Model
from rotorfit.tracking.growing_flight import GrowingFlight
from rotorfit.tracking.looks import End, Looked

BEHIND, PACED = 40, 12
"""Largest number of pending looks and glances. Further ones at a vehicle are skipped until the machine has caught up;
what is simulated or played back (paced) waits instead."""

PATIENCE = 5.0
"""How long the process may take to end before it is killed [s]."""


class LooksBeside:
    """Makes looks in a process of its own, which ends with this one; see `Looks`.

    Args:
        card: Meaning of commands and poses.
        path: File of the recording.
        promised: The arguments of `Following`.
        paced: Whether `ask` waits rather than skip looks.
    """

    def __init__(self, card: Card, path: str, promised: Sequence[Any], paced: bool = False) -> None:
        self._paced, self._waiting, self._over = paced, 0, False
        quiet = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "rotorfit.tracking.looking"],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, env={**os.environ, **quiet}, start_new_session=True,
        )  # fmt: skip
        self._asked: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._answered: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._looked: list[Looked] = []
        self._model: Model | None = None
        for work in (self._write, self._read):
            threading.Thread(target=work, name="rotorfit-looks", daemon=True).start()
        self._asked.put((card, path, *promised))

    def ask(self, growing: GrowingFlight) -> None:
        """Sends what is new and requests a look, unless too many are pending; then the next one sends it.

        Raises:
            RuntimeError: Paced, the process has failed; the message has its traceback.
            LinkError: Paced, the process was killed.
        """
        while self._paced and self._waiting >= PACED:
            self._take(self._answered.get())
        if self._waiting < BEHIND:
            self._waiting += 1
            self._asked.put(("look", growing.news(), growing.standing, growing.alarms()))

    def answers(self) -> Iterator[Looked]:
        """See `Looks`.

        Raises:
            RuntimeError: The process has failed; the message has its traceback.
            LinkError: The process was killed.
        """
        while self._looked or not (self._over or self._answered.empty()):
            if not self._looked:
                self._take(self._answered.get())
            else:
                yield self._looked.pop(0)

    def finish(self, growing: GrowingFlight) -> End | None:
        """See `Looks`; waits for the pending looks.

        Raises:
            RuntimeError: The process has failed; the message has its traceback.
            LinkError: The process was killed.
        """
        self._asked.put(("finish", growing.news(), growing.standing, growing.alarms()))
        while self._waiting:
            self._take(self._answered.get())
        end: End | None = self._checked(self._answered.get())
        return end

    def recall(self, memory: Mapping[str, Any]) -> None:
        """See `Looks`."""
        self._asked.put(("recall", memory, False, ()))

    def close(self) -> None:
        """Ends the process; kills it if looks are pending."""
        self._over = True
        self._asked.put(None)
        if self._waiting:
            self._process.kill()
        try:
            self._process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _take(self, answer: Any) -> None:
        found = self._checked(answer)
        self._waiting -= 1
        if found:
            looked = unpacked(found[0], found[1], self._model)
            self._model = looked.state.model
            self._looked.append(looked)

    def _checked(self, answer: Any) -> Any:
        """The answer, or an error if the process has ended."""
        if isinstance(answer, Failed):
            self._answered.put(answer)  # the next call fails alike
            if answer.trace:
                raise RuntimeError(f"the process that looks at the flight has failed:\n{answer.trace}")
            code = self._process.wait()
            raise LinkError(
                f"the process that looks at the flight was ended from outside (status {code}), perhaps for want of "
                "memory; start again"
            )
        return answer

    def _write(self) -> None:
        """Body of the thread that sends questions: only it waits while the pipe is full."""
        pipe = self._process.stdin
        assert pipe is not None
        with suppress(OSError):  # the process is gone, which the reading thread reports
            while (question := self._asked.get()) is not None:
                send(pipe, question)
        with suppress(OSError):
            pipe.close()

    def _read(self) -> None:
        """Body of the thread that receives answers, until the process ends."""
        pipe = self._process.stdout
        assert pipe is not None
        with pipe:
            answer: Any = None
            while not isinstance(answer, Failed):
                answer = received(pipe)
                self._answered.put(answer)


def packed(looked: Looked, before: Model | None) -> tuple[Looked, frozenset[str] | None]:
    """A look to be sent, without its model if that is unchanged, and the axes that are new (None: no new model)."""
    model = looked.state.model
    if model is before:
        return replace(looked, state=replace(looked.state, model=None)), None
    old, axes = before.axes if before else {}, model.axes if model else {}
    return looked, frozenset(axis for axis, one in axes.items() if one is not old.get(axis))


def unpacked(looked: Looked, new: frozenset[str] | None, before: Model | None) -> Looked:
    """The look as it was before `packed`; an axis that was not fitted again is the same object as in `before`."""
    model = looked.state.model
    if new is None:
        model = before
    elif model and before:
        model = replace(model, axes={a: one if a in new else before.axes[a] for a, one in model.axes.items()})
    return replace(looked, state=replace(looked.state, model=model))


@dataclass(frozen=True)
class Failed:
    """The process has ended.

    Attributes:
        trace: Its traceback; empty if it sent none.
    """

    trace: str = ""


def send(pipe: IO[bytes], what: Any) -> None:
    """Sends a question or an answer."""
    pipe.write(pickle.dumps(what))
    pipe.flush()


def received(pipe: IO[bytes]) -> Any:
    """Receives a question or an answer; `Failed` if the other end is gone."""
    try:
        return pickle.load(pipe)  # from a process of our own
    except (EOFError, pickle.UnpicklingError):
        return Failed()
