"""The follower: runs `rotorfit track --link` in a process of its own, and feeds its output to the live page.

Nothing is commanded: the process only listens. Its recording becomes a log of the session.
"""

import signal
import subprocess
import sys
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from threading import Lock, Thread
from typing import Any

from rotorfit.app.live.feed import Feed
from rotorfit.app.web.runner import BusyError, message_of
from rotorfit.core.writing import write_whole

MOST_LINES = 20
"""Number of lines of the process' other output that are kept."""

PATIENCE = 10.0
"""How long the process may take to end with the studio [s]."""


@dataclass
class Run:
    """A tracking run, going on or ended.

    Attributes:
        number: Number of the run, from 1.
        link: The link as the user gave it.
        process: The process that tracks.
        feed: The feed of the page.
        said: Other output of the process: where it listens, what is missing, that it ended.
        running: Whether it is going on.
    """

    number: int
    link: str
    process: subprocess.Popen[str]
    feed: Feed
    said: deque[str] = field(default_factory=lambda: deque(maxlen=MOST_LINES))
    running: bool = True


class Follower:
    """Tracks at most one vehicle at a time.

    Args:
        place: Gives a path for a new recording, as `Workspace.recording`.
        kept: Makes a recording a log of the session, and says so in a line, or where it lies instead.
    """

    def __init__(self, place: Callable[[], Path], kept: Callable[[Path], str]) -> None:
        self._place, self._kept = place, kept
        self._lock = Lock()
        self._run: Run | None = None
        self._listener: Thread | None = None
        self._none = Feed()

    @property
    def feed(self) -> Feed:
        """The feed of the current or last run."""
        return self._run.feed if self._run else self._none

    def to_mapping(self) -> dict[str, Any] | None:
        """What else the page shows of the run; None before the first run."""
        run = self._run
        if run is None:
            return None
        return {"number": run.number, "link": run.link, "running": run.running, "said": list(run.said)}

    def start(self, link: str, card: str, text: bool) -> None:
        """Starts to listen.

        Args:
            link: The link, as in `rotorfit track --link`.
            card: Name of a built-in card, or the text of a card; empty for the link's own card.
            text: Whether `card` is a text.

        Raises:
            BusyError: A vehicle is tracked already.
            WorkspaceError: There is no room for another log.
        """
        with self._lock:
            if self._run is not None and self._run.running:
                raise BusyError("a vehicle is followed already; end that first")
            path = self._place()
            number = self._run.number + 1 if self._run else 1
            self._run = run = Run(number, link, _process(link, card, text, path), Feed(link))
            self._listener = Thread(target=self._listen, args=(run, path), daemon=True)
            self._listener.start()

    def stop(self) -> None:
        """Asks the process to end: it makes a last fit, and its recording is kept."""
        if self._run is not None and self._run.running:
            self._run.process.send_signal(signal.SIGINT)

    def close(self) -> None:
        """Ends the run with the studio; its recording is kept before this returns."""
        run, listener = self._run, self._listener
        if run is None or listener is None:
            return
        self.stop()
        try:
            run.process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            run.process.kill()
        listener.join()

    def _listen(self, run: Run, path: Path) -> None:
        """Body of the thread: reads the output of the process, and keeps its recording at the end."""
        with run.process as process:
            assert process.stdout is not None
            for line in process.stdout:
                message = message_of(line)
                if message.get("type") in ("state", "alarm"):
                    run.feed.add(message)
                elif line.strip() and not line.startswith("{"):
                    run.said.append(line.strip().replace("ended: Ctrl-C", "ended on this page"))  # by `stop`
            process.wait()
            run.feed.over = True
            with suppress(OSError):
                path.with_suffix(".toml").unlink(missing_ok=True)
            if path.exists():
                run.said.append(self._kept(path))
            run.running = False


def _process(link: str, card: str, text: bool, record: Path) -> subprocess.Popen[str]:
    words = [sys.executable, "-P", "-m", "rotorfit", "track", "--link", link, "--jsonl", "--record", str(record)]
    if text:
        write_whole(record.with_suffix(".toml"), card, keep=False)
        card = str(record.with_suffix(".toml"))
    return subprocess.Popen(
        [*words, *(["--card", card] if card else [])],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        encoding="utf-8",
        errors="replace",
    )
