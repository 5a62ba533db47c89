"""Terminal output of a flight: the preflight list, a status line, and how it ended."""

import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any

from rich.text import Text

from rotorfit.app.terminal.tables import View, bullets, indented, title

if TYPE_CHECKING:
    from rotorfit.core.flight_plan import Flown, Jitter, Plan, Status
    from rotorfit.flying.preflight import Ready

PERIOD = 0.2  # s between two lines


def preflight_view(plan: "Plan", link: str, ready: "Ready", fail_safe: str) -> View:
    """The preflight list, and what the vehicle does if the link is lost."""
    yield title(f"{plan.name}: {plan.duration:g} s at {plan.rate:g} commands a second, by {link}")
    for check in ready.checks:
        line = Text("  ok   " if check.ok else "  NOT  ", style="green" if check.ok else "bold red")
        line.append(f"{check.name}: {check.text}", style="default")
        yield line
    yield from bullets(ready.notes)
    yield indented(f"If the link is lost: {fail_safe}")


def flown_view(flown: "Flown", live: bool) -> View:
    """How a flight ended, and for a live link how late its commands were: simulated time is never late."""
    yield title(f"Flown: {flown.text}.")
    yield indented(
        f"{flown.duration:.1f} s of the plan, {flown.commands} commands, {flown.poses} poses; "
        f"{'landing' if flown.landed else 'hovering'}"
    )
    if live:
        yield indented(jitter_line(flown.jitter, flown.late))
    if flown.outliers:
        yield indented(f"{flown.outliers} poses could not be true and were left out")
    yield from bullets(flown.notes)


def ended_early(flown: "Flown") -> str:
    """One line about a flight that something ended."""
    when = f"after {flown.duration:.1f} s of the plan" if flown.duration else "before the plan began"
    lands = "lands" if flown.landed else "does not land"
    return f"ended early, {when}: {flown.text}; the vehicle {lands}; the log so far: {flown.path}"


def jitter_line(jitter: "Jitter", count: int) -> str:
    """How late commands were, and how many by more than three periods."""
    p50, p99, most = (1e3 * value for value in (jitter.p50, jitter.p99, jitter.max))
    late = f", {count} more than three periods" if count else ""
    return f"commands late by {p50:.2f} ms (median), {p99:.2f} ms (99 %), {most:.2f} ms (most){late}"


def next_command(paths: Sequence[str]) -> str:
    """What to do with the recording."""
    return f"rotorfit fit {' '.join(paths)} -o model.json"


@contextmanager
def status_line(said: Callable[[], str] = lambda: "") -> Iterator[Callable[["Status"], None] | None]:
    """Shows the last status of a flight in one line.

    Args:
        said: Returns a text to show before the status.
    """
    last: list[Any] = [None]

    def show(status: "Status") -> None:
        last[0] = status

    with shown_line(lambda: f"{said()}{status_text(last[0])}" if last[0] else "") as shows:
        yield show if shows else None


@contextmanager
def shown_line(text: Callable[[], str]) -> Iterator[bool]:
    """Shows a line on stderr, if that is a terminal, and refreshes it from a thread of its own.

    A slow terminal therefore does not delay the caller.

    Args:
        text: Returns the current line; empty if there is none.

    Yields:
        Whether there is a terminal.
    """
    if not sys.stderr.isatty():
        yield False
        return
    over = threading.Event()

    def run() -> None:
        """Writes the line again and again, and clears it at the end."""
        with suppress(OSError):  # a terminal that was closed
            while not over.wait(PERIOD):
                if line := text():
                    sys.stderr.write(f"\r\033[K{line}")
                    sys.stderr.flush()
            sys.stderr.write("\r\033[K")
            sys.stderr.flush()

    thread = threading.Thread(target=run, name="rotorfit-status", daemon=True)
    thread.start()
    try:
        yield True
    finally:
        over.set()
        thread.join(1.0)


def line_cleared() -> None:
    """Clears the refreshed line, to make room for a line of text."""
    if sys.stderr.isatty():
        with suppress(OSError):
            sys.stderr.write("\r\033[K")
            sys.stderr.flush()


def status_text(status: "Status") -> str:
    """The status line of a flight."""
    of = f" of {status.duration:g}" if status.phase == "plan" else ""
    place = "no pose"
    if status.pose is not None:
        x, y, z, _ = status.pose
        place = f"x {x:+.2f} y {y:+.2f} z {z:.2f} m, {status.room:.2f} m to the fence"
    battery = "" if status.battery is None else f", battery {status.battery:.0%}"
    return f"{status.phase} {status.time:.1f}{of} s: {place}{battery}  (Ctrl-C or space: hover and end)"
