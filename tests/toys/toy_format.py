"""A log format: the word TOY, then rows of time, command, position."""

from collections.abc import Collection
from pathlib import Path

import numpy as np

from rotorfit.core.log import Table
from rotorfit.files.logs.content import Content


def sniff(path: Path, head: bytes) -> bool:
    return head.startswith(b"TOY\n")


def read(path: Path, tables: Collection[str] | None = None) -> Content:
    time, command, position = np.loadtxt(path, skiprows=1).T
    columns = {"time": time, "command": command, "position": position}
    return Content({"toy": Table("toy", columns)}, skipped={}, notes=())
