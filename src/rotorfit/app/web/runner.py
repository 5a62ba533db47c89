"""The runner: starts a fit in a process of its own, reads its progress, cancels it. One at a time."""

import json
import subprocess
import sys
from threading import Lock, Thread
from typing import Any

from rotorfit.app.web.workspace import FitEntry, Running, Status, Workspace
from rotorfit.core.errors import RotorfitError
from rotorfit.core.plain import is_number, plain_json
from rotorfit.core.writing import write_whole


class BusyError(RotorfitError):
    """A fit is running already."""


class Runner:
    """Runs at most one worker for a workspace."""

    def __init__(self, workspace: Workspace) -> None:
        self._workspace = workspace
        self._lock = Lock()
        self._process: subprocess.Popen[str] | None = None
        self._running: Running | None = None
        self._cancelled = False

    @property
    def running(self) -> Running | None:
        """The running fit, if there is one."""
        return self._running

    def start(self, request: dict[str, Any], card: str, logs: tuple[str, ...]) -> FitEntry:
        """Starts a fit or a comparison.

        Raises:
            BusyError: A fit or comparison is running.
        """
        with self._lock:
            if self._running is not None:
                raise BusyError("a fit is running; wait for it, or cancel it")
            fit = self._workspace.begin_fit(
                {name: value for name, value in request.items() if name not in ("train", "validate", "names")}, logs
            )
            try:
                process = self._process_of(fit, request, card)
            except OSError as error:
                self._workspace.end_fit(fit.id, "failed", f"the fit could not be started: {error.strerror}")
                raise
            self._process, self._cancelled = process, False
            self._running = Running(fit.id, 0.0, "starting", process.pid)
        Thread(target=self._listen, args=(fit, process), daemon=True).start()
        return fit

    def _process_of(self, fit: FitEntry, request: dict[str, Any], card: str) -> subprocess.Popen[str]:
        folder = self._workspace.fit_folder(fit)
        write_whole(folder / "request.json", json.dumps(request, allow_nan=False))
        write_whole(folder / "card.toml", card)
        with (folder / "trace.txt").open("w") as trace:
            return subprocess.Popen(
                [sys.executable, "-P", "-m", "rotorfit.app.web.worker", str(self._workspace.folder), fit.id],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=trace,
                encoding="utf-8",
                errors="replace",
            )

    def cancel(self, fit_id: str) -> None:
        """Ends the running fit, if it is this one; nothing of it is kept."""
        with self._lock:
            if self._running is not None and self._running.id == fit_id and self._process is not None:
                self._cancelled = True
                self._process.kill()

    def close(self) -> None:
        """Ends the running fit, if there is one."""
        if self._running is not None:
            self.cancel(self._running.id)

    def _listen(self, fit: FitEntry, process: subprocess.Popen[str]) -> None:
        said: dict[str, Any] = {}
        assert process.stdout is not None
        assert process.stdin is not None
        for line in process.stdout:
            message = message_of(line)
            said |= message
            if is_number(message.get("fraction")):
                self._running = Running(fit.id, float(message["fraction"]), str(message.get("text", "")), process.pid)
        code = process.wait()
        process.stdin.close()
        process.stdout.close()
        status, text = self._outcome(fit, code, said)
        with self._lock:  # together: a fit without a process must not be shown as running
            try:
                self._workspace.end_fit(fit.id, status, text)
            finally:
                self._running = self._process = None

    def _outcome(self, fit: FitEntry, code: int, said: dict[str, Any]) -> tuple[Status, str]:
        if self._cancelled:
            return "stopped", "cancelled"
        if code == 0 and "done" in said:
            return "done", str(said["done"])
        if "error" in said:
            return "failed", str(said["error"])
        if code < 0:
            return (
                "failed",
                f"the fit was killed from outside (signal {-code}), perhaps for want of memory; start it again",
            )
        trace = self._workspace.fit_folder(fit) / "trace.txt"
        return "failed", f"this is a bug of rotorfit; please report it with its trace, {trace}"


def message_of(line: str) -> dict[str, Any]:
    """The message of another process in a line of its output; empty if a library printed the line."""
    try:
        message = plain_json(line)
    except ValueError:
        return {}
    return message if isinstance(message, dict) else {}
