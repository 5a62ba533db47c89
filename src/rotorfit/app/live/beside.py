"""The far end of a tracker beside a flight of ours: states in words, alarms, and new gains if wanted."""

import json
import os
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rotorfit.core.log import NUMBERS, Sample
from rotorfit.core.tracked import Tracked
from rotorfit.files.cards import card_from_mapping
from rotorfit.flying.beside import RECORD, STREAMS, Beside
from rotorfit.tracking.flight_so_far import UNRECORDED

FAR = "rotorfit.app.live.beside"
"""This module, as a program."""

NICE = 10
"""Niceness of the program where the flight does not wait for it."""


def asked_of(
    card: Mapping[str, Any],
    after: Path | None = None,
    gains: str | None = None,
    paced: bool = False,
    path: str = UNRECORDED,
) -> dict[str, Any]:
    """What the program is told first.

    Args:
        card: Raw card of the commands that are flown.
        after: Model file of an earlier flight.
        gains: Path of the gains file, or empty for words alone; None to publish no gains.
        paced: Whether the flight waits for the program, as in simulated time.
        path: File of the recording.
    """
    return {"card": dict(card), "after": after and str(after), "gains": gains, "paced": paced, "path": path}


@contextmanager
def tracked_beside(asked: Mapping[str, Any] | None) -> Iterator[Beside | None]:
    """A tracker beside a flight that does what is `asked`, if anything, else None; it is closed on exit."""
    if asked is None:
        yield None
        return
    beside = Beside(FAR, asked, asked["paced"])
    try:
        yield beside
    finally:
        beside.close()


def gains_of(message: Mapping[str, Any]) -> list[str]:
    """New gains, in words for each axis."""
    return [
        f"{message['time']:.1f} s  GAINS {axis}: bandwidth {one['bandwidth']:.3g} rad/s; {message['why'][axis]}"
        for axis, one in message["axes"].items()
    ]


def main() -> None:
    """Reads samples from standard input, writes words, alarms and gains to standard output."""
    from rotorfit.app.terminal import text_of
    from rotorfit.app.terminal.tracking import changes_of, track_view
    from rotorfit.core.tracked import Track
    from rotorfit.tracking.earlier import earlier_of
    from rotorfit.tracking.tracker import Tracker

    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what a library prints is no answer
    stream = sys.stdin.buffer
    asked = json.loads(stream.readline())
    os.nice(0 if asked["paced"] else NICE)
    earlier = earlier_of(asked["after"]) if asked["after"] else None
    card, tuned = card_from_mapping(asked["card"], "of the flight"), asked["gains"] is not None
    tracker = Tracker(card, after=earlier, path=asked["path"], tuned=tuned)
    gains, raised, states, said = list[str](), dict[float, str](), list[Tracked](), set[str]()
    regaining = None
    if tuned:
        from rotorfit.app.live.regained import regaining_of

        regaining = regaining_of(
            asked["gains"],
            lambda message, _now: gains.extend(gains_of(message)),
            lambda kept: gains.extend([f"the earlier gains are kept as {kept}"] if kept else []),
            earlier,
        )

    def tell(state: Tracked, now: int, summary: str = "") -> None:
        """Answers with a state, what is to be said since the last one (alarms, gains, faults), and a summary."""
        states.append(state)
        if regaining:
            regaining.state(state, now)
        alarms = []
        for one in state.alarms:
            before = raised.get(one.raised) if one.revises is not None else None
            raised[one.raised] = "; ".join(filter(None, (f"{one.time:.2f} s  {one.title}: {one.why}", changes_of(one))))
            alarms.append((raised[one.raised], before))
        new = [f"{state.time:.1f} s  {text}" for key, text in state.faults.items() if key not in said]
        said.update(state.faults)
        told = {"time": state.time, "words": state.words, "alarms": alarms, "lines": [*gains, *tracker.remarks(), *new]}
        gains.clear()
        print(json.dumps({**told, "summary": summary}), file=answers, flush=True)

    received = 0
    try:
        while len(data := stream.read(RECORD.size)) == RECORD.size:
            number, stamp, received, error, *values = RECORD.unpack(data)
            name = STREAMS[number]
            tracker.update(Sample(name, stamp, received, tuple(values[: NUMBERS[name]]), error=error))
            for state in tracker.news():
                tell(state, received)
        last, regimes = tracker.finish()
        for state in tracker.news():
            tell(state, received)
        whole = Track((*states, last), regimes)
        tell(last, received, text_of(track_view(whole)) + (regaining.summary if regaining else ""))
    except BrokenPipeError:  # the flight was ended meanwhile, and nobody reads any more
        os.dup2(os.open(os.devnull, os.O_WRONLY), answers.fileno())


if __name__ == "__main__":
    main()
