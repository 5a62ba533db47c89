"""Parquet files: what becomes of types and empty cells; files that are cut, damaged or hostile."""

import datetime as dt
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from test_log import log_or_line

from rotorfit.core.errors import LogError
from rotorfit.core.log import Log
from rotorfit.files.logs import parquet, read
from rotorfit.files.logs.parquet_worker import columns_to

NOW = dt.datetime(2024, 1, 1, microsecond=5)


def log_of(folder: Path, frame: pl.DataFrame) -> Log:
    frame.write_parquet(folder / "log.parquet")
    return read(folder / "log.parquet")


def test_numbers_come_as_recorded_times_in_nanoseconds_and_others_are_named(tmp_path: Path) -> None:
    second = dt.timedelta(seconds=1)
    frame = pl.DataFrame(
        {
            "stamp": [NOW, NOW + second], "since": [second, 2 * second], "armed": [True, False], "n": [1, None],
            "small": pl.Series([1.5, None], dtype=pl.Float32), "code": pl.Series([7, 8], dtype=pl.UInt16),
            "mode": ["up", "down"], "both": [{"a": 1}, {"a": 2}],
        }
    )  # fmt: skip

    log = log_of(tmp_path, frame)

    columns = log.tables["log"].columns
    assert log.format == "parquet"
    assert columns["stamp"].tolist() == [1_704_067_200_000_005_000, 1_704_067_201_000_005_000]
    assert columns["since"].tolist() == [10**9, 2 * 10**9]
    assert (columns["armed"].tolist(), columns["code"].dtype) == ([True, False], np.uint16)
    np.testing.assert_array_equal(columns["n"], [1, np.nan])
    np.testing.assert_array_equal(columns["small"], [1.5, np.nan])
    assert log.notes == ("columns left out because they hold no numbers: mode, both",)


def test_a_file_cut_short_anywhere_says_so_without_being_decoded(tmp_path: Path) -> None:
    log_of(tmp_path, pl.DataFrame({"t": range(500), "x": np.random.default_rng(1).normal(size=500)}))
    content = (tmp_path / "log.parquet").read_bytes()
    for cut in np.random.default_rng(2).integers(4, len(content) - 1, 50):
        (tmp_path / "log.parquet").write_bytes(content[:cut])
        with pytest.raises(LogError, match="is cut short"):
            read(tmp_path / "log.parquet")


def test_wrong_bytes_give_a_log_or_one_line(tmp_path: Path) -> None:
    log_of(tmp_path, pl.DataFrame({"t": range(500), "x": np.random.default_rng(1).normal(size=500)}))
    content = (tmp_path / "log.parquet").read_bytes()
    rng = np.random.default_rng(3)
    refused = 0
    for _ in range(4):
        damaged = bytearray(content)
        damaged[len(content) - rng.integers(9, 300)] = rng.integers(256)
        damaged[int(rng.integers(4, 60))] ^= 0xFF
        (tmp_path / "log.parquet").write_bytes(damaged)
        refused += log_or_line(tmp_path / "log.parquet") is None
    assert refused > 0


def test_more_numbers_than_the_bound_are_refused_before_they_are_decoded(tmp_path: Path) -> None:
    pl.DataFrame({"t": np.zeros(100_000)}).write_parquet(tmp_path / "log.parquet")

    (problem,) = columns_to(tmp_path / "log.parquet", tmp_path, 1000)["problem"]

    assert problem.endswith("cut the log to the flight that you need")
    assert not (tmp_path / "0.npy").exists()


def test_a_folder_of_logs_is_not_searched_for_modules(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "json.py").write_text("raise SystemExit('run by a stranger')")
    monkeypatch.chdir(tmp_path)

    assert "t" in log_of(tmp_path, pl.DataFrame({"t": [1, 2]})).tables["log"].columns


def test_a_file_that_takes_too_long_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parquet, "_SECONDS", 0.001)

    with pytest.raises(LogError, match=r"not read within 0.001 s; copy the file again"):
        log_of(tmp_path, pl.DataFrame({"t": [1, 2]}))


def test_a_process_that_a_file_takes_down_costs_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pl.DataFrame({"t": [1, 2]}).write_parquet(tmp_path / "log.parquet")
    killer = tmp_path / "python"
    killer.write_text("#!/bin/sh\nkill -ABRT $$\n")
    killer.chmod(0o755)
    monkeypatch.setattr(parquet.sys, "executable", str(killer))

    with pytest.raises(LogError, match="damaged Parquet; copy the file again"):
        read(tmp_path / "log.parquet")


def test_a_file_of_text_only_is_refused(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="no column of numbers in the file"):
        log_of(tmp_path, pl.DataFrame({"mode": ["up"]}))
