"""Process of `parquet`: decodes the numeric columns of a file into a folder."""

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rotorfit.core.log import Column
from rotorfit.files.logs.content import too_wide

if TYPE_CHECKING:
    import polars as pl

_PROCESS = 900 << 20  # bytes of data memory for the process, 135 MiB of them for polars itself

_LONGEST = 4  # the limit holds this many of the longest column: each is decompressed and copied as a whole


def columns_to(path: Path, folder: Path, limit: int) -> dict[str, list[str]]:
    """Decodes the numeric columns to `0.npy` and so on.

    Args:
        path: The Parquet file.
        folder: Destination.
        limit: Most bytes of numbers.

    Returns:
        `names` of the columns and of the `others`, or a `problem` of one line.
    """
    import polars as pl

    try:
        schema = pl.read_parquet_schema(path)
        count = int(pl.scan_parquet(path).select(pl.len()).collect().item())
        names = [name for name, kind in schema.items() if kind.is_numeric() or kind.is_temporal() or kind == pl.Boolean]
        if told := too_wide(len(schema)):
            return {"problem": [told]}
        if count * len(names) * 8 > limit or count * 8 > limit / _LONGEST:
            return {"problem": [f"more than {limit >> 20} MiB of numbers; cut the log to the flight that you need"]}
        # Each call parses the description of all columns: reading few at a time takes time quadratic in their number.
        together = max(1, limit // _LONGEST // max(1, count * 16))
        for first in range(0, len(names), together):
            part = pl.read_parquet(path, columns=names[first : first + together], use_statistics=False)
            for index, series in enumerate(part.iter_columns(), first):
                np.save(folder / f"{index}.npy", _numbers(series), allow_pickle=False)
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException, OSError, ValueError, MemoryError) as error:
        return {"problem": [f"damaged Parquet ({' '.join(str(error).split())[:200]}); copy the file again"]}
    return {"names": names, "others": [name for name in schema if name not in names]}


def _numbers(series: "pl.Series") -> Column:
    """Values of a column, empty cells as NaN; dates and times as nanoseconds, since 1970 or midnight."""
    import polars as pl

    if series.dtype == pl.Date:
        series = series.cast(pl.Datetime("ns"))
    if series.dtype in (pl.Datetime, pl.Duration):
        series = series.dt.cast_time_unit("ns")
    if series.dtype.is_temporal():
        series = series.to_physical()
    if series.null_count() or series.dtype.is_decimal():
        series = series.cast(pl.Float64).fill_null(float("nan"))
    return np.ascontiguousarray(series.to_numpy())


def _bound_memory() -> None:
    """Limits the process's memory where the system supports it, because a file may claim huge sizes."""
    try:
        import resource
    except ImportError:  # not on Windows
        return
    resource.setrlimit(resource.RLIMIT_DATA, (_PROCESS, _PROCESS))


def _main(words: list[str]) -> None:
    path, folder, limit = Path(words[0]), Path(words[1]), int(words[2])
    _bound_memory()
    answer: dict[str, Any] = columns_to(path, folder, limit)
    (folder / "columns.json").write_text(json.dumps(answer), encoding="utf-8")


if __name__ == "__main__":
    _main(sys.argv[1:])
