"""Logs that are damaged, hostile or no logs at all: what can be saved is, the loss is stated, else one clear line."""

import bz2
import os
import shutil
import sqlite3
import struct
import zlib
from contextlib import closing
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_sources import (
    BAGS,
    WRITERS,
    as_recording,
    mcap_record,
    recording,
    text,
    write_mat,
    write_mat73,
    write_mcap_ros1,
    write_rosbag1,
    write_rosbag2,
    write_storage,
)

from rotorfit.core.errors import LogError
from rotorfit.core.log import Log
from rotorfit.files.logs import compression, mat73, read

pytestmark = pytest.mark.flights

FILES = [name for name in WRITERS if not name.startswith("rosbag2")]
"""Cases of `WRITERS` that are one file."""


@cache
def sample(name: str) -> bytes:
    """A small file of a format."""
    with TemporaryDirectory() as folder:
        return WRITERS[name][1](Path(folder) / "flight", recording()).read_bytes()


def error_of(path: Path) -> str:
    """The one line that reading gives."""
    with pytest.raises(LogError) as caught:
        read(path)
    line = str(caught.value)
    assert "\n" not in line
    assert str(path) in line
    return line


def log_or_line(path: Path) -> Log | None:
    """The log, or None where reading gives one line."""
    line = ""
    try:
        return read(path)
    except LogError as error:
        line = str(error)
    assert "\n" not in line
    return None


ROS1_HEAD = b"#ROSBAG V2.0\n"
BROKEN: dict[str, tuple[bytes, str]] = {
    "empty": (b"", "the file is empty"),
    "text": (
        b"Flown on a windy day.\nIt went well.\n",
        "of no known format; `rotorfit formats` lists what",
    ),
    "binary": (bytes(range(256)) * 3, "of no known format"),
    "gzip": (b"\x1f\x8b\x08" + bytes(90), "compressed with gzip; unpack it"),
    "npz": (b"PK\x03\x04" + bytes(90), "a zip archive, as .npz and .xlsx are"),
    "npy": (b"\x93NUMPY\x01" + bytes(90), "an array of NumPy; save the arrays with scipy.io.savemat"),
    "json array": (b'[{"t": 0.5, "x": 1}, {"t": 0.6, "x": 2}]', "JSON, but not one object a line"),
    "json of many lines": (b'{\n "t": 0.5,\n "x": 1\n}\n', "write each row with json.dumps"),
    "csv between blanks": (b"time x y\n0 1 2\n1 2 3\n", "numbers between commas, semicolons or tabs"),
    "csv below text": (b"flown today\nby me\ntime,x\n0,1\n", "or below lines that begin with #"),
    "csv without rows": (b"time,x,y\n", "no rows below"),
    "csv without header": (b"0,1,2\n1,2,3\n", "add a header row"),
    "csv of other width": (b"time,x\n0,1,2\n1,2,3\n", "2 names but 3 cells in a row"),
    "csv of text": (b"time,mode\n1:00,up\n1:01,7a\n", "of no known format"),
    "csv in latin-1": (b"time,yaw [\xb0]\n1,2\n", "line 1 is not UTF-8 (byte 0xb0)"),
    "csv in utf-16": ("time,x\n1,2\n".encode("utf-16"), "save it in UTF-8"),
    "ros 1.2": (b"#ROSBAG V1.2\n" + bytes(100), "version '1.2'"),
    "ros 1 magic only": (ROS1_HEAD, "holds no messages"),
    "mcap magic only": (b"\x89MCAP0\r\n", "holds no messages"),
    "sqlite magic only": (b"SQLite format 3\0" + bytes(600), "holds no messages"),
    "mat header only": (b"MATLAB 5.0 MAT-file".ljust(124) + b"\0\1IM", "no array of numbers"),
    "mat73 header only": (b"MATLAB 7.3 MAT-file".ljust(124) + b"\0\2IM" + bytes(600), "damaged HDF5"),
    "zstd of nothing": (compression._zstd().compress(b"nothing"), "neither SQLite nor MCAP"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_file_that_is_no_log_gives_one_line_that_says_why(name: str, tmp_path: Path) -> None:
    content, expected = BROKEN[name]
    path = tmp_path / "flight.log"
    path.write_bytes(content)

    assert expected in error_of(path)


def test_a_path_that_leads_nowhere_gives_one_line_that_says_why(tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    os.mkfifo(tmp_path / "pipe")

    assert "no such file" in error_of(tmp_path / "missing.bag")
    assert "no ROS 2 bag" in error_of(tmp_path / "folder")
    assert "not a regular file" in error_of(tmp_path / "pipe")


@pytest.mark.parametrize("metadata", ["", "a: [", "rosbag2_bagfile_information: 3", "\0", "- 1"])
def test_a_folder_whose_metadata_is_damaged_gives_one_line(metadata: str, tmp_path: Path) -> None:
    folder = write_rosbag2(tmp_path / "bag", recording())
    (folder / "metadata.yaml").write_text(metadata)

    assert "ros2 bag reindex" in error_of(folder)


def test_a_folder_whose_storage_is_missing_names_it(tmp_path: Path) -> None:
    folder = write_rosbag2(tmp_path / "bag", recording())
    (folder / "bag.db3").unlink()

    assert "(bag.db3)" in error_of(folder)


@pytest.mark.parametrize("name", BAGS)
def test_a_bag_without_messages_says_so(name: str, tmp_path: Path) -> None:
    assert "holds no messages" in error_of(WRITERS[name][1](tmp_path / "bag", recording(0, 0)))


@pytest.mark.parametrize("name", [*FILES, "rosbag2 sqlite"])
def test_a_file_cut_short_gives_the_rows_before_the_cut_and_says_so_or_one_clear_line(
    name: str, tmp_path: Path
) -> None:
    content = sample("lone db3" if name == "rosbag2 sqlite" else name)
    rec = recording()
    path = tmp_path / "cut"
    rows_before = 0
    for size in np.linspace(1, len(content) - 1, 40).astype(int):
        path.write_bytes(content[:size])
        log = log_or_line(path)
        if log is None:
            continue
        names = ("pose.position.x", "p0", "drone.position.x")
        columns = (table.columns for table in log.tables.values())
        x = next((table[name] for table in columns for name in names if name in table), np.zeros(0))
        np.testing.assert_array_equal(x, rec.pose[: len(x), 0])
        assert len(x) >= rows_before
        # Nothing to say where only the index behind the messages is cut, or a CSV just behind a line.
        sheet = name.startswith(("csv", "motive", "vicon", "dataflash_text"))
        unseen = content[:size].endswith(b"\n") if sheet else len(x) == 60
        assert log.damage or log.notes or unseen, f"{size} of {len(content)} bytes"
        rows_before = len(x)
    assert rows_before > 0 or name.startswith(("mat73", "parquet"))


def test_a_ros1_bag_without_index_gives_all_its_messages(tmp_path: Path) -> None:
    content = bytearray(write_rosbag1(tmp_path / "bag", recording()).read_bytes())
    place = content.index(b"index_pos=") + len(b"index_pos=")
    (index,) = struct.unpack_from("<Q", content, place)
    content[place : place + 8] = bytes(8)
    (tmp_path / "bag").write_bytes(content[:index])

    log = read(tmp_path / "bag")

    np.testing.assert_array_equal(as_recording(log).pose, recording().pose)
    assert log.damage == ("the bag was never closed and has no index: what was recorded behind its end is lost",)


@pytest.mark.parametrize("cut", ["1.5,2", "1.5,", "1.5,2,", "1.5,2,-"])
def test_a_cut_last_line_of_a_csv_is_left_out_with_a_note(cut: str, tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text(f"t,x,y\n0,1,2\n1,3,4\n{cut}")

    log = read(path)

    assert log.tables["a"].columns["t"][:2].tolist() == [0, 1]
    assert not np.isnan(log.tables["a"].columns["x"]).any()
    assert len(log.notes) == 1


@pytest.mark.parametrize("place", [3, 150, 399])
@pytest.mark.parametrize("cell", ["ERR", "#N/A", "1.2.3"])
def test_a_cell_of_text_among_numbers_costs_itself_only(place: int, cell: str, tmp_path: Path) -> None:
    cells = [[f"{i}", f"{i / 7:.4f}", f"10:00:00.{i:03d}"] for i in range(400)]
    cells[place] = [cell] * 3
    file = tmp_path / "a.csv"
    file.write_text("n,x,day\n" + "\n".join(",".join(row) for row in cells) + "\n")

    log = read(file)

    columns = log.tables["a"].columns
    assert list(columns) == ["n", "x", "day"]
    for values in columns.values():
        assert np.flatnonzero(np.isnan(values)).tolist() == [place]
    assert columns["x"][200] == 28.5714
    assert log.notes == tuple(f"1 of 400 cells of {name} hold text, as {cell!r}: blank" for name in columns)


@pytest.mark.parametrize("text", ["v1.13.2", "192.168.0.1", "a.9.csv", "01.05.2024 12:00:00,05"])
def test_points_in_a_column_of_text_are_no_decimal_points(text: str, tmp_path: Path) -> None:
    file = tmp_path / "a.csv"
    file.write_text("t;note;x\n" + "".join(f"{i};{text};{i},25\n" for i in range(50)))

    assert read(file).tables["a"].columns["x"].tolist() == [i + 0.25 for i in range(50)]


@pytest.mark.parametrize(
    ("head", "lines"),
    [("t,cmd x\n", 2), ("t,cmd x\nns,m/s\n", 4), ("# a lab\n#t,cmd x\n", 4)],
)
def test_a_header_that_is_repeated_among_the_rows_is_left_out(head: str, lines: int, tmp_path: Path) -> None:
    rows = "".join(f"{i},{i / 8}\n" for i in range(50))
    file = tmp_path / "a.csv"
    file.write_text((head + rows) * 3)

    log = read(file)

    columns = log.tables["a"].columns
    assert columns["t"].tolist() == [*range(50)] * 3
    assert columns["t"].dtype == np.int64
    assert len(columns["cmd x"]) == 150
    assert log.notes[-1] == f"the header is repeated among the rows, in {lines} lines: left out"
    assert len(log.notes) == 1 + ("m/s" in head)


def test_torn_lines_and_zero_bytes_inside_a_csv_are_left_out_with_a_note(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_bytes(b"t,x\n0,1\n1,2\n2,\0\0\0\n3,4,5\n6\n\n7,8\n")

    log = read(path)

    assert log.tables["a"].columns["t"].tolist() == [0, 1, 7]
    assert log.notes == ("3 torn lines left out, the first is line 4 of the file",)


def test_a_message_that_is_not_what_its_definition_says_costs_itself_only(tmp_path: Path) -> None:
    path = write_storage(tmp_path / "bag", recording())
    with sqlite3.connect(path) as database:
        database.execute("UPDATE messages SET data = x'0001000001' WHERE id IN (4, 5)")
        database.execute("UPDATE messages SET timestamp = -3 WHERE id = 6")
    database.close()

    log = read(path)
    rows = sum(len(log.tables[topic].columns["log_time"]) for topic in ("/drone/pose", "/cmd_vel"))

    assert rows == 60 + 17 - 3
    assert any("could not be decoded" in note for note in log.notes)


def test_a_damaged_chunk_costs_itself_only(tmp_path: Path) -> None:
    first, second = (write_mcap_ros1(tmp_path / name, recording(), packed=True).read_bytes() for name in "ab")
    magic, end = len(b"\x89MCAP0\r\n"), len(first) - 8 - 29 - 13
    broken = bytearray(first[magic:end])
    broken[200:260] = bytes(60)
    (tmp_path / "c").write_bytes(first[:magic] + bytes(broken) + second[magic:])

    log = read(tmp_path / "c")

    np.testing.assert_array_equal(as_recording(log).pose[-60:], recording().pose)
    assert "checksum" in log.damage[0] or "lz4" in log.damage[0]


HOSTILE = {
    "a type within itself": "my_msgs/State inner",
    "a huge array of types": "Leaf[2000000000] leaves\n" + "=" * 80 + "\nMSG: my_msgs/Leaf\nstring text",
    "a huge array of nothing": "Leaf[2000000000] leaves\n" + "=" * 80 + "\nMSG: my_msgs/Leaf\n",
    "a huge array of numbers": "float64[99999999999] values",
    "a type that is not there": "my_msgs/Unknown thing",
    "code": "float64 x=__import__('os')",
    "nonsense": "\x00\x01 \n float64[ x",
}


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_definition_costs_its_topic_only_and_no_time(name: str, tmp_path: Path) -> None:
    definition = HOSTILE[name]
    records = mcap_record(3, struct.pack("<H", 1), text("my_msgs/State"), text("ros1msg"), text(definition))
    records += mcap_record(4, struct.pack("<HH", 7, 1), text("/state"), text("ros1"), text(""))
    records += mcap_record(5, struct.pack("<HIQQ", 7, 0, 1, 1), bytes(64))
    content = write_mcap_ros1(tmp_path / "log", recording()).read_bytes()
    (tmp_path / "log").write_bytes(content[:8] + records + content[8:])

    log = read(tmp_path / "log")

    np.testing.assert_array_equal(as_recording(log).pose, recording().pose)
    assert "/state" in log.skipped
    assert "\n" not in log.skipped["/state"]


@pytest.mark.parametrize("module", ["rosbag1", "mat"])
def test_a_block_that_unpacks_beyond_the_bound_is_refused(
    module: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "bomb"
    bomb = bytes(3_000_000)
    if module == "mat":
        monkeypatch.setattr("rotorfit.files.logs.mat.LIMIT", 1_000_000)
        block = zlib.compress(struct.pack("<II", 14, len(bomb)) + bomb)
        path.write_bytes(b"MATLAB 5.0 MAT-file".ljust(124) + b"\0\1IM" + struct.pack("<II", 15, len(block)) + block)
        expected = "unpacks to more than"
    else:
        monkeypatch.setattr("rotorfit.files.logs.compression.BLOCK_LIMIT", 1_000_000)
        fields = [b"op=\x05", b"compression=bz2", b"size=" + struct.pack("<I", len(bomb))]
        header = b"".join(struct.pack("<I", len(field)) + field for field in fields)
        path.write_bytes(b"#ROSBAG V2.0\n" + text(header) + text(bz2.compress(bomb)))
        expected = "claims 3000000 bytes"

    assert expected in error_of(path)


def test_more_numbers_than_the_bound_are_refused_with_advice(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_rosbag1(tmp_path / "bag", recording())
    monkeypatch.setattr("rotorfit.files.logs.topics.LIMIT", 1000)

    assert "read only the topics that you need" in error_of(path)


def test_an_sqlite_file_whose_messages_are_computed_without_end_is_refused(tmp_path: Path) -> None:
    with sqlite3.connect(tmp_path / "endless.db3") as database:
        database.executescript(
            "CREATE TABLE topics(id, name, type, serialization_format);"
            "CREATE VIEW messages AS WITH RECURSIVE n(id) AS (SELECT 1 UNION ALL SELECT id + 1 FROM n)"
            " SELECT id, 1 AS topic_id, id AS timestamp, x'00' AS data FROM n"
        )
    database.close()

    assert "no ROS 2 bag" in error_of(tmp_path / "endless.db3")


def test_links_out_of_an_hdf5_file_are_not_followed(tmp_path: Path) -> None:
    write_mat73(tmp_path / "secret.mat", recording())
    write_mat73(tmp_path / "log.mat", recording())
    with h5py.File(tmp_path / "log.mat", "a") as file:
        file["stolen"] = h5py.ExternalLink("secret.mat", "/p0")
        file.create_dataset("peeked", (8,), "u1", external=[(str(tmp_path / "secret.mat"), 0, 8)])

    log = read(tmp_path / "log.mat")

    assert not {"stolen", "peeked"} & set(log.tables["log"].columns)
    assert "stolen" in log.notes[0]


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="the size of the process is not known here")
def test_descriptions_in_a_mat73_file_have_bounded_memory() -> None:
    """The library allocates what they claim: a mutated file of 24 kB took 24 GB. What comes after is not bounded."""
    with mat73._bounded(), pytest.raises(MemoryError):
        bytearray(2 * mat73.DESCRIPTIONS)
    assert len(bytearray(2 * mat73.DESCRIPTIONS)) == 2 * mat73.DESCRIPTIONS


def test_mat73_without_h5py_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_mat73(tmp_path / "a.mat", recording())
    monkeypatch.setitem(__import__("sys").modules, "h5py", None)

    assert "pip install 'rotorfit[mat73]'" in error_of(path)


def test_a_variable_twice_in_a_mat_file_is_read_quietly_with_a_note(
    tmp_path: Path, recwarn: pytest.WarningsRecorder
) -> None:
    content = write_mat(tmp_path / "a.mat", recording()).read_bytes()
    (tmp_path / "a.mat").write_bytes(content + content[128:])

    log = read(tmp_path / "a.mat")

    np.testing.assert_array_equal(as_recording(log).pose, recording().pose)
    assert "t_pose is there more than once; the last one is used" in log.notes
    assert len(recwarn) == 0


def test_nothing_is_written_beside_a_log(tmp_path: Path) -> None:
    path = write_storage(tmp_path / "bag", recording())
    Path(f"{path}-wal").write_bytes(b"unmerged")
    before = sorted(entry.name for entry in tmp_path.rglob("*")), path.read_bytes()

    log = read(path)

    assert (sorted(entry.name for entry in tmp_path.rglob("*")), path.read_bytes()) == before
    assert "cannot be merged" in log.damage[0]


@pytest.mark.parametrize("share", [0.0, 0.4])
def test_messages_in_a_write_ahead_log_are_read(share: float, tmp_path: Path) -> None:
    live, crashed = write_storage(tmp_path / "live.db3", recording()), tmp_path / "crashed.db3"
    with closing(sqlite3.connect(live)) as database:
        messages = database.execute("SELECT * FROM messages").fetchall()
        database.execute("DELETE FROM messages WHERE id > ?", [round(share * len(messages))])
        database.commit()
        database.execute("PRAGMA journal_mode = WAL")
        database.execute("PRAGMA wal_autocheckpoint = 0")
        database.executemany("INSERT OR IGNORE INTO messages VALUES (?, ?, ?, ?)", messages)
        database.commit()
        for end in ("", "-wal"):
            shutil.copyfile(f"{live}{end}", f"{crashed}{end}")

    log = read(crashed)

    np.testing.assert_array_equal(as_recording(log).pose, recording().pose)
    assert (log.notes, log.damage) == (("crashed.db3-wal was merged in a copy",), ())
    assert sorted(entry.name for entry in tmp_path.glob("crashed*")) == ["crashed.db3", "crashed.db3-wal"]


def survives(content: bytes) -> None:
    """Reads bytes: a log or a LogError of one line."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "log"
        path.write_bytes(content)
        log_or_line(path)


MAGICS = [b"", ROS1_HEAD, b"\x89MCAP0\r\n", b"SQLite format 3\0", b"(\xb5/\xfd", b"t,x\n1,2\n", sample("mat")[:128]]


@settings(max_examples=150)
@given(st.sampled_from(MAGICS), st.binary(max_size=400))
def test_random_bytes_never_give_anything_but_a_log_or_a_log_error(magic: bytes, noise: bytes) -> None:
    survives(magic + noise)


@settings(max_examples=300)
@given(
    st.sampled_from([name for name in FILES if name != "parquet"]),
    st.lists(st.tuples(st.floats(0, 1, exclude_max=True), st.binary(min_size=1, max_size=4)), min_size=1, max_size=8),
    st.floats(0.05, 1),
)
def test_a_damaged_file_never_gives_anything_but_a_log_or_a_log_error(
    name: str, edits: list[tuple[float, bytes]], kept: float
) -> None:
    content = bytearray(sample(name))
    for place, noise in edits:
        # Squared: heads and definitions, which stand at the front, are hit more often than payload.
        start = int(place**2 * len(content))
        content[start : start + len(noise)] = noise

    survives(bytes(content[: int(kept * len(content)) + 1]))
