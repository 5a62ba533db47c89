"""Memory: what unpacks to far more than it is takes less than 1 GB, in every packed format."""

import subprocess
import sys
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import pytest

import bombs
from rotorfit.core.errors import LogError
from rotorfit.files.logs import read
from rotorfit.files.logs import topics as collector

pytestmark = pytest.mark.flights

MB = 1_000_000
READ = """
import re, resource, sys
from pathlib import Path
from rotorfit.core.errors import LogError
from rotorfit.files.logs import read
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
    "bag, bz2": lambda path: bombs.rosbag1(path, "bz2", 12 << 20, 1),
    "bag, lz4": lambda path: bombs.rosbag1(path, "lz4", BLOCK, 2),
    "bag, lz4, larger than any block": lambda path: bombs.rosbag1(path, "lz4", 300 << 20, 1),
    "mcap, zstd": lambda path: bombs.mcap(path, "zstd", BLOCK, 2),
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
    path = bombs.mcap(tmp_path / "log", "zstd", 1 << 21, 50)  # 37 MiB of numbers
    read(path)
    monkeypatch.setattr(collector, "LIMIT", 30 << 20)

    tracemalloc.start()
    with pytest.raises(LogError, match="more than 30 MiB of numbers"):
        read(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()

    assert peak < 1.3 * (30 << 20) + (10 << 20)
