"""Parquet: one flat table of columns, as written by pandas, polars and most data tools.

polars decodes it in a separate process with limits on memory and time: a few wrong bytes make polars crash its process
(an allocation of 2^61 bytes, polars 2.1). The description of the columns is at the end of the file, so nothing can be
read from a file that is cut short.

Source: https://parquet.apache.org/docs/file-format/
"""

import json
import os
import subprocess
import sys
from collections.abc import Collection
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from rotorfit.core.errors import LogError
from rotorfit.core.log import Table
from rotorfit.files.logs.content import LIMIT, Content, listed, one_line

_MAGIC = b"PAR1"

_SECONDS = 120


def sniff(path: Path, head: bytes) -> bool:  # noqa: ARG001 - one signature for all formats
    """Whether the file begins with Parquet's magic."""
    return head.startswith(_MAGIC)


def read(path: Path, tables: Collection[str] | None) -> Content:  # noqa: ARG001 - a file is one table
    """Reads the one table, named after the file.

    Raises:
        LogError: Cut short, damaged, too large, or no column of numbers.
    """
    _check_end(path)
    with TemporaryDirectory(prefix="rotorfit-") as folder:
        said = _decoded(path, Path(folder))
        if "problem" in said:
            raise LogError(f"{path}: {one_line(said['problem'][0])}")
        columns = {
            name: np.load(Path(folder) / f"{index}.npy", allow_pickle=False) for index, name in enumerate(said["names"])
        }
    notes = [f"columns left out because they hold no numbers: {listed(said['others'])}"] if said["others"] else []
    if not columns:
        raise LogError(f"{path}: no column of numbers in the file")
    return Content({path.stem: Table(path.stem, columns)}, {}, tuple(notes))


def _check_end(path: Path) -> None:
    """Raises `LogError` unless the file can end with the description of the columns."""
    size = path.stat().st_size
    with path.open("rb") as file:
        file.seek(max(0, size - 8))
        end = file.read(8)
    if end[4:] != _MAGIC or int.from_bytes(end[:4], "little") > size - 12:
        raise LogError(f"{path}: the Parquet file is cut short: its footer is missing; copy it again")


def _decoded(path: Path, folder: Path) -> dict[str, list[str]]:
    """Decodes the columns into a folder as `0.npy` and so on; returns their names, what was left out, or a problem."""
    root = str(Path(__file__).resolve().parents[2])
    paths = filter(None, (root, os.environ.get("PYTHONPATH")))
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(paths), "RUST_BACKTRACE": "0", "POLARS_MAX_THREADS": "1"}
    command = [
        sys.executable,
        "-P",
        "-m",
        "rotorfit.files.logs.parquet_worker",
        str(path.resolve()),
        str(folder),
        str(LIMIT),
    ]
    try:
        done = subprocess.run(command, env=environment, capture_output=True, timeout=_SECONDS, check=False)
    except subprocess.TimeoutExpired:
        return {"problem": [f"damaged Parquet: not read within {_SECONDS} s; copy the file again"]}
    answer = folder / "columns.json"
    if done.returncode or not answer.is_file():
        return {"problem": ["damaged Parquet; copy the file again"]}
    found: dict[str, list[str]] = json.loads(answer.read_text(encoding="utf-8"))
    return found
