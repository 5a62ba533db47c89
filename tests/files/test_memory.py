"""Memory: what unpacks to far more than it is takes less than 1 GB, in every packed format."""

import subprocess
import sys
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from time import process_time

import numpy as np
import polars as pl
import pytest
from scipy.io import savemat
from test_sources import WRITERS, recording

import bombs
from rotorfit.core.errors import LogError
from rotorfit.files import logs
from rotorfit.files.logs import content, csv, damage, read
from rotorfit.files.logs import topics as collector
from rotorfit.files.logs.parquet_worker import columns_to

pytestmark = pytest.mark.flights

MB = 1_000_000
READ = """
import re, resource, sys
from pathlib import Path
from rotorfit.core.errors import LogError
from rotorfit.files.logs import content, csv, read
path = sys.argv[1]
try:
    print(len(next(iter(read(path).tables.values())).columns))
except LogError as error:
    print(error)
# Not ru_maxrss of this process: that begins with what its parent had.
own = int(re.search(r"VmHWM:\\s+(\\d+)", Path("/proc/self/status").read_text())[1])
print(max(own, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss if path.endswith(".parquet") else 0))
"""
BLOCK = 60 << 20
BOMBS: dict[str, Callable[[Path], Path]] = {
    "bag, bz2": lambda path: bombs.rosbag1(path, "bz2", 4 << 20, 1),
    "bag, lz4": lambda path: bombs.rosbag1(path, "lz4", BLOCK, 2),
    "bag, lz4, larger than any block": lambda path: bombs.rosbag1(path, "lz4", 300 << 20, 1),
    "mcap, lz4": lambda path: bombs.mcap(path, "lz4", BLOCK, 2),
    "mcap, zstd, larger than any block": lambda path: bombs.mcap(path, "zstd", 300 << 20, 1),
    "mat, zlib": lambda path: bombs.mat(path, 300 << 20, 3),
    "mat, zlib, larger than all": lambda path: bombs.mat(path, 600 << 20, 1),
    "parquet, snappy": lambda path: bombs.parquet(path, "snappy", 480 << 20),
    "parquet, zstd, larger than all": lambda path: bombs.parquet(path, "zstd", 900 << 20),
}


@pytest.mark.parametrize("name", BOMBS)
def test_what_unpacks_to_far_more_takes_less_than_a_gigabyte(name: str, tmp_path: Path) -> None:
    path = BOMBS[name](tmp_path / ("log.parquet" if "parquet" in name else "log"))

    done = subprocess.run([sys.executable, "-c", READ, str(path)], check=True, capture_output=True, text=True)
    said, peak = done.stdout.splitlines()

    assert float(peak) * 1024 < 1000 * MB + path.stat().st_size
    assert said.isdigit() or str(path) in said
    if "larger" in name:
        assert not said.isdigit()


def test_columns_that_grow_take_little_more_than_they_hold(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = bombs.mcap(tmp_path / "log", "zstd", 1 << 21, 15)  # 11 MiB of numbers
    read(path)
    monkeypatch.setattr(collector, "LIMIT", 9 << 20)

    tracemalloc.start()
    with pytest.raises(LogError, match="more than 9 MiB of numbers"):
        read(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()

    assert peak < 1.3 * (9 << 20) + (10 << 20)


def wide_csv(path: Path, count: int) -> Path:
    path.write_text("\n".join((",".join(f"c{k}" for k in range(count)), *[",".join(["1.5"] * count)] * 2)))
    return path


def wide_mat(path: Path, count: int) -> Path:
    savemat(path, {f"c{k}": 1.0 for k in range(count)})
    return path


def linked_groups(path: Path, count: int) -> Path:
    """As many names as `count` to the third, by a few links to the same groups."""
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w") as file:
        one = file.create_group("c")
        for _ in range(3):
            outer = file.create_group(None)
            for k in range(count):
                outer[f"c{k}"] = one
            one = outer
        file["all"] = one
    return path


@pytest.mark.parametrize("user_block", [0, 512, 2048])
def test_hdf5_is_not_asked_to_load_driver_information_of_any_size(user_block: int, tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    path = tmp_path / "log"
    with h5py.File(path, "w", userblock_size=user_block) as file:
        file["x"] = np.arange(100.0)
    data = bytearray(path.read_bytes())
    data[:19] = data[:19] if user_block == 0 else b"MATLAB 7.3 MAT-file"
    data[user_block + 48 : user_block + 56] = (len(data) - user_block).to_bytes(8, "little")  # where it lies
    path.write_bytes(bytes(data) + bytes(4) + (0x7FFF_FFF0).to_bytes(4, "little") + b"NCSAmult" + bytes(100))

    with pytest.raises(LogError, match="it needs a driver of HDF5, as no MAT file does"):
        read(path)


def test_hdf5_that_ends_after_its_signature_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "log").write_bytes(b"\x89HDF\r\n\x1a\n\0")
    with pytest.raises(LogError, match="damaged HDF5"):
        read(tmp_path / "log")


@pytest.mark.parametrize("wide", [wide_csv, wide_mat, linked_groups])
def test_a_table_of_more_columns_than_anybody_can_look_at_is_one_line(
    wide: Callable[[Path, int], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(content, "MOST_COLUMNS", 100)
    with pytest.raises(LogError, match=r"a table of \d+ columns, more than 100; keep those of") as refused:
        read(wide(tmp_path / "log", 120))
    assert "\n" not in str(refused.value)


def test_a_million_columns_are_refused_before_they_take_time_and_memory(tmp_path: Path) -> None:
    started = process_time()
    with pytest.raises(LogError, match="a table of 300000 columns"):
        read(wide_csv(tmp_path / "log", 300_000))
    assert process_time() - started < 20  # a minute and more, where the columns were read before they were counted


def test_more_cells_than_memory_holds_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(csv, "_MOST_CELLS", 1 << 20)
    (tmp_path / "log").write_text("a,b\n" + "1,1\n" * (1 << 20))
    with pytest.raises(LogError, match="more than 1 million cells; cut the log"):
        read(tmp_path / "log")


@pytest.mark.parametrize(("count", "length"), [(1000, 1000), (100, 100_000)])
def test_columns_of_long_texts_are_left_out_by_their_first_rows(count: int, length: int, tmp_path: Path) -> None:
    rows = "".join(f"{k},1.5,{'no number ' * (length // 10)}\n" for k in range(count))
    (tmp_path / "log").write_text(f"time,x,note\n{rows}")

    log = read(tmp_path / "log")

    assert list(log.tables["log"].columns) == ["time", "x"]
    assert log.notes == ("columns left out because they hold text: note",)


SPARSE = {
    "csv": b"time,x\n1,2\n",
    "motive": b"Format Version,1.23\n",
    "dataflash_text": b"FMT, 128, 89, FMT, BBnNZ, a\n",
}


@pytest.mark.parametrize("head", SPARSE.values(), ids=SPARSE)
def test_ten_gigabytes_of_text_are_refused_at_once(head: bytes, tmp_path: Path) -> None:
    with (tmp_path / "log").open("wb") as file:
        file.write(head)
        file.truncate(10 << 30)
    with pytest.raises(LogError, match="MiB of text; cut the log"):
        read(tmp_path / "log")


EMPTY = {
    "rosbag1": b"#ROSBAG V2.0\n",
    "mcap": b"\x89MCAP0\r\n",
    "rosbag2": b"SQLite format 3\0",
    "ulog": b"ULog\x01\x12\x35\x01" + bytes(8),
    "dataflash": b"\xa3\x95\x80\x80\x59FMT\0BBnNZ\0",
    "parquet": b"PAR1",
    "mat": b"MATLAB 5.0 MAT-file".ljust(124) + b"\0\1IM",
    "mat73": b"MATLAB 7.3 MAT-file".ljust(512) + b"\x89HDF\r\n\x1a\n",
}


@pytest.mark.parametrize("head", EMPTY.values(), ids=EMPTY)
def test_ten_gigabytes_of_nothing_are_one_line(head: bytes, tmp_path: Path) -> None:
    with (tmp_path / "log").open("wb") as file:
        file.write(head)
        file.truncate(10 << 30)
    with pytest.raises(LogError) as refused:
        read(tmp_path / "log")
    assert str(refused.value).isprintable()


def test_wide_parquet_is_refused(tmp_path: Path) -> None:
    pl.DataFrame({f"c{k}": [0.5] for k in range(10_001)}).write_parquet(tmp_path / "log", statistics=False)
    with pytest.raises(LogError, match="a table of 10001 columns"):
        read(tmp_path / "log")


def test_a_structure_of_too_many_arrays_is_left_out_with_a_note(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(content, "MOST_COLUMNS", 100)
    savemat(tmp_path / "log", {"x": np.zeros(9), "all": {f"c{k}": 1.0 for k in range(120)}})

    log = read(tmp_path / "log")

    assert list(log.tables["log"].columns) == ["x"]
    assert "a table of 101 columns" in log.damage[0]


def test_many_columns_of_parquet_take_a_few_readings_of_what_describes_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pl.DataFrame({f"c{k}": [float(k)] for k in range(300)}).write_parquet(tmp_path / "log")
    calls: list[int] = []

    def counted(path: Path, columns: list[str], **more: bool) -> pl.DataFrame:
        calls.append(len(columns))
        return whole(path, columns=columns, **more)

    whole = pl.read_parquet
    monkeypatch.setattr(pl, "read_parquet", counted)

    found = columns_to(tmp_path / "log", tmp_path, 1 << 29)

    assert calls == [300]
    assert found["names"] == [f"c{k}" for k in range(300)]
    assert [np.load(tmp_path / f"{k}.npy")[0] for k in (0, 150, 299)] == [0.0, 150.0, 299.0]


@pytest.mark.parametrize("head", [b"ULog\x01\x12\x35\x01" + bytes(8), b"\xa3\x95\x80\x80\x59FMT\0BBnNZ"])
def test_ten_gigabytes_of_an_autopilots_log_are_refused_at_once(head: bytes, tmp_path: Path) -> None:
    with (tmp_path / "log").open("wb") as file:
        file.write(head)
        file.truncate(10 << 30)
    with pytest.raises(LogError, match="a log of 10 GiB, more than 4; cut it"):
        read(tmp_path / "log")


@pytest.mark.parametrize("case", ["rosbag1", "lone mcap"])
def test_a_hole_of_gigabytes_is_not_searched_to_its_end(
    case: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(damage, "MOST_SEARCHED", 1 << 16)
    path = WRITERS[case][1](tmp_path / "log", recording())
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2] + bytes(1 << 17) + whole[len(whole) // 2 :])

    log = read(path)

    assert log.tables
    assert len(log.damage) == 1
    assert "and what was recorded behind them" in log.damage[0]


def test_reading_a_large_file_tells_how_far_it_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "log.csv").write_text("time,x\n" + "0.25,1.5\n" * 1_000_000)
    told: list[tuple[float, str]] = []

    read(tmp_path / "log.csv", progress=lambda *one: told.append(one))
    assert not told
    monkeypatch.setattr(logs, "_LARGE", 1_000_000)
    read(tmp_path / "log.csv", progress=lambda *one: told.append(one))

    assert [fraction for fraction, _ in told] == sorted(fraction for fraction, _ in told)
    assert told[0][0] < 0.5
    assert {text for _, text in told} == {"reading log.csv, 9 MB"}
    assert told[-1][0] == 1.0


def test_reading_a_large_file_can_be_cancelled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "log.csv").write_text("time,x\n0,1.5\n1,2\n")
    monkeypatch.setattr(logs, "_LARGE", 1)

    def cancel(_: float, __: str) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        read(tmp_path / "log.csv", progress=cancel)
