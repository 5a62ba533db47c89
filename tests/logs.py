"""Logs as files, for the tests of the command line: simulated flights written as a CSV, with the card that reads it."""

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
from click.testing import CliRunner

from rotorfit.app.cli import main
from rotorfit.core.frames import AXES, Array
from rotorfit.simulation.paper_vehicle import SimulatedFlight

CARD = """
[command]
time = "time"
x = "cmd_x"
y = "cmd_y"
z = "cmd_z"
yaw = "cmd_yaw"
[pose]
time = "time"
x = "x"
y = "y"
z = "z"
yaw = "yaw"
"""
POSE, COMMAND = AXES, tuple(f"cmd_{axis}" for axis in AXES)


class Csv:
    """What a logger writes: poses and commands in one table, blank where a row has none; change it, then write it.

    Times are seconds, `pose` is x, y, z, yaw, shape (N, 4), `command` (M, 4).
    """

    def __init__(self, flight: SimulatedFlight) -> None:
        self.pose_time, self.pose = flight.pose_stamp / 1e9, flight.pose.copy()
        self.command_time, self.command = flight.command_stamp / 1e9, flight.command.copy()

    def write(self, folder: Path, card: str = CARD, **stamps: tuple[Array, Array]) -> tuple[str, ...]:
        """Writes log and card; returns the words that name them to the command line.

        Args:
            folder: Where.
            card: Text of the card.
            stamps: Further columns of stamps: name to those of the poses and of the commands [ns].
        """
        times = {"time": (self.pose_time, self.command_time), **stamps}
        cells = [
            *(self._row(times, 0, i, [*map(repr, row.tolist()), *[""] * 4]) for i, row in enumerate(self.pose)),
            *(self._row(times, 1, i, [*[""] * 4, *map(repr, row.tolist())]) for i, row in enumerate(self.command)),
        ]
        cells.sort(key=lambda row: float(row[0]))
        return _written(folder, card, [*times, *POSE, *COMMAND], cells)

    def write_rows(self, folder: Path, card: str = CARD) -> tuple[str, ...]:
        """The same with the latest command in every row, as loggers do that sample at the rate of the poses."""
        latest = np.searchsorted(self.command_time, self.pose_time, side="right") - 1
        rows = zip(self.pose_time.tolist(), self.pose.tolist(), self.command[latest].tolist(), strict=True)
        cells = [list(map(repr, [t, *pose, *command])) for t, pose, command in rows]
        return _written(folder, card, ["time", *POSE, *COMMAND], cells)

    @staticmethod
    def _row(times: dict[str, tuple[Array, Array]], which: int, i: int, rest: list[str]) -> list[str]:
        return [*(repr(pair[which][i].item()) for pair in times.values()), *rest]


def _written(folder: Path, card: str, names: list[str], cells: list[list[str]]) -> tuple[str, ...]:
    log, toml = folder / "flight.csv", folder / "card.toml"
    toml.write_text(card)
    with log.open("w", newline="") as file:
        csv.writer(file).writerows([names, *cells])
    return str(log), "--card", str(toml)


def ran(*words: str) -> dict[str, Any]:
    """JSON of a verb that must succeed."""
    result = CliRunner().invoke(main, [*words, "--json"])
    assert result.exit_code == 0, result.output
    found: dict[str, Any] = json.loads(result.stdout)
    return found


def said(verb: str, *words: str) -> dict[tuple[str, str | None], dict[str, str]]:
    """Findings that `info` or `fit` gives for logs, by code and axis."""
    found = ran(verb, *words)
    findings = found["logs"][0]["flight"]["findings"] if verb == "info" else found["findings"]
    return {(finding["code"], finding["axis"]): finding for finding in findings}
