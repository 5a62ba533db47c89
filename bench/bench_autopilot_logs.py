"""How fast are logs of autopilots read, against pyulog and pymavlink on the same file in the same run?

    python bench/bench_autopilot_logs.py [LOG...]

Writes a ULog of 60 MB and a DataFlash log of 20 MB, or takes the logs named, and reads everything, then two of their
tables. Every reading is a process of its own, the best of three after imports. Then 512 bytes of each ULog are set to
zero at a place drawn at random, eight times (seed 0), and the messages that are lost are counted. Needs
`pip install pyulog pymavlink`.
"""

import contextlib
import io
import json
import random
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from autopilot_logs import (
    ULOG_SYNC,
    flash,
    flash_format,
    flash_record,
    ulog,
    ulog_data,
    ulog_format,
    ulog_record,
    ulog_subscription,
)

RUNS = 3
OURS = """
from importlib import import_module
from rotorfit.sources import FORMATS, read
for module in FORMATS.values():
    import_module(module)
def work():
    log = read(path, tables)
    return sum(len(next(iter(table.columns.values()))) for table in log.tables.values())
"""
PYULOG = """
from pyulog import ULog
def work():
    log = ULog(path, message_name_filter_list=tables, disable_str_exceptions=True)
    return sum(len(data.data["timestamp"]) for data in log.data_list)
"""
PYMAVLINK = """
from pymavlink.DFReader import DFReader_binary
def work():
    log, count = DFReader_binary(path), 0
    while (message := log.recv_match(type=tables) if tables else log.recv_msg()) is not None:
        count += 1
    return count
"""
MEASURE = """
import json, sys, time
path, tables = json.loads(sys.argv[1])
{setup}
start = time.perf_counter()
count = work()
print(json.dumps([time.perf_counter() - start, count]))
"""


def write_ulog(path: Path) -> Path:
    """Half an hour of IMU at 200 Hz, attitude at 50 Hz and position at 10 Hz."""
    kinds = {"sensor_combined": (13, 1), "vehicle_attitude": (12, 4), "vehicle_local_position": (40, 20)}
    records = [ulog_format(name, f"uint64_t timestamp;float[{width}] values;") for name, (width, _) in kinds.items()]
    records += [ulog_subscription(number, name) for number, name in enumerate(kinds)]
    for step in range(600_000):
        records += [ulog_record("S", ULOG_SYNC)] * (step % 100 == 0)
        records += [
            ulog_data(number, f"Q{width}f", step * 5000, *[step] * width)
            for number, (width, every) in enumerate(kinds.values())
            if step % every == 0
        ]
    path.write_bytes(ulog(records))
    return path


def write_dataflash(path: Path) -> Path:
    """Half an hour of IMU at 100 Hz, attitude and position at 10 Hz."""
    kinds = {"IMU": ("Qffffff", 1), "ATT": ("Qcccccc", 10), "PSCN": ("Qffffff", 10)}
    labels = "TimeUS," + ",".join("abcdef")
    records = [flash_format(number + 1, name, code, labels) for number, (name, (code, _)) in enumerate(kinds.items())]
    for step in range(180_000):
        records += [
            flash_record(number + 1, code, step * 10_000, *[step % 999] * 6)
            for number, (code, every) in enumerate(kinds.values())
            if step % every == 0
        ]
    path.write_bytes(flash(records))
    return path


def measured(setup: str, path: Path, tables: list[str] | None) -> tuple[float, int]:
    """Seconds of the best reading, and messages."""
    command = [sys.executable, "-c", MEASURE.format(setup=setup), json.dumps([str(path), tables])]
    runs: list[Any] = [json.loads(subprocess.run(command, check=True, capture_output=True).stdout) for _ in range(RUNS)]
    return min(runs)


def rows(path: Path) -> None:
    """Prints what both readers take for everything and for two tables."""
    is_ulog = path.read_bytes()[:4] == b"ULog"
    other, name = (PYULOG, "pyulog") if is_ulog else (PYMAVLINK, "pymavlink")
    two = ["vehicle_attitude", "vehicle_local_position"] if is_ulog else ["ATT", "PSCN"]
    for what, tables in (("everything", None), (" and ".join(two), two)):
        ours, count = measured(OURS, path, tables)
        theirs, their_count = measured(other, path, tables)
        size = path.stat().st_size / 1e6
        print(
            f"| {path.name}, {size:.1f} MB: {what} | {count} | {ours:.3f} | {theirs:.3f} ({name}, {their_count}) "
            f"| {theirs / ours:.1f} |",
            flush=True,
        )


def losses(path: Path, folder: Path) -> None:
    """Prints how many messages a hole of 512 bytes costs each reader of ULog, at eight places."""
    from pyulog import ULog

    from rotorfit.sources import read

    content, hole, rng = path.read_bytes(), folder / "hole.ulg", random.Random(0)
    counts: list[tuple[int, int]] = []
    for place in (None, *(rng.randrange(len(content) // 20, len(content) - 512) for _ in range(8))):
        data = bytearray(content)
        if place is not None:
            data[place : place + 512] = bytes(512)
        hole.write_bytes(data)
        with contextlib.redirect_stdout(io.StringIO()):
            theirs = sum(len(data.data["timestamp"]) for data in ULog(str(hole)).data_list)
        ours = sum(len(table.columns["timestamp"]) for table in read(hole).tables.values())
        counts.append((ours, theirs))
    lost = [[counts[0][k] - one[k] for one in counts[1:]] for k in (0, 1)]
    print(f"\n{path.name}: a hole of 512 bytes costs {lost[0]} of {counts[0][0]} messages, pyulog {lost[1]}")


def main() -> None:
    print("| file | messages | s | s of the other (messages) | ratio |")
    print("|---|---|---|---|---|")
    with TemporaryDirectory() as folder:
        logs = [Path(word) for word in sys.argv[1:]]
        logs = logs or [write_ulog(Path(folder) / "px4.ulg"), write_dataflash(Path(folder) / "arducopter.bin")]
        for path in logs:
            rows(path)
        for path in logs:
            if path.read_bytes()[:4] == b"ULog":
                losses(path, Path(folder))


if __name__ == "__main__":
    main()
