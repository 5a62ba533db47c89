"""The process that `LooksBeside` starts: it makes looks at a flight that grows in another process.

    python -m rotorfit.tracking.looking

It reads pickled questions from standard input, writes pickled answers to standard output, and ends with its input.
"""

import os
import sys
import traceback
from contextlib import suppress
from types import TracebackType

from rotorfit.tracking.flight_so_far import FlightSoFar
from rotorfit.tracking.following import Following
from rotorfit.tracking.looks import looked_at
from rotorfit.tracking.looks_beside import Failed, packed, received, send

NICE = 10
"""Niceness of the process."""


def main() -> None:
    """Answers questions until standard input closes; an uncaught error answers with its traceback."""
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a library prints must not mix with the answers

    def failed(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
        send(answers, Failed("".join(traceback.format_exception(kind, error, trace))))

    sys.excepthook = failed
    os.nice(NICE)
    card, path, *promised = received(sys.stdin.buffer)
    following, so_far, model = Following(*promised), FlightSoFar(card, path), None
    with suppress(BrokenPipeError):  # the other process is gone
        while not isinstance(question := received(sys.stdin.buffer), Failed):
            what, news, standing, alarms = question
            if what == "recall":
                following.recall(news)
                continue
            so_far.take(news)
            flight = so_far.flight()
            if flight is None:
                send(answers, None)
            elif what == "look":
                looked = looked_at(following, flight, so_far.now, standing, alarms)
                send(answers, packed(looked, model) if looked else None)
                model = looked.state.model if looked else model
            else:
                send(answers, following.finish(flight, so_far.now, alarms))


if __name__ == "__main__":
    main()
