"""Bags read fast: an index that lies, chunks left packed, damage at any place, bounds on memory and on time."""

import random
import sqlite3
import struct
import tracemalloc
from collections.abc import Callable
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time

import lz4.frame
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.rosbag1 import Writer as Writer1
from test_log import log_or_line, survives
from test_sources import (
    IMAGE,
    JAZZY,
    NOETIC,
    TOPICS,
    Recording,
    as_recording,
    mcap_record,
    messages,
    recording,
    text,
    write_storage,
)

from rotorfit.app.workflows import load_flight
from rotorfit.core.log import Log
from rotorfit.files.cards import builtin_cards, card_from_mapping
from rotorfit.files.log_span import WHOLE, LogSpan
from rotorfit.files.logs import mcap, read, rosbag1
from rotorfit.files.logs.batches import messages_of
from rotorfit.files.logs.mcap_records import summary_channels
from rotorfit.files.logs.ros_messages import Topic, decoded, types_of
from rotorfit.flights.columns import tables_of

pytestmark = pytest.mark.flights

Write = Callable[[Path, Recording], Path]


def write_bag1(path: Path, rec: Recording, chunk: int = 1500) -> Path:
    """A ROS 1 bag of many chunks."""
    with Writer1(path) as writer:
        writer.chunk_threshold = chunk
        connections = {topic: writer.add_connection(topic, kind, typestore=NOETIC) for topic, kind in TOPICS.items()}
        for time, topic, data in messages(rec, NOETIC):
            writer.write(connections[topic], time, data)
    return path


def mcap_chunk(records: list[tuple[int, bytes]], head: bytes = b"", method: str = "") -> bytes:
    """A chunk of messages (channel, record) behind other records, and its index."""
    plain, index = head, dict[int, bytes]()
    for channel, record in records:
        index[channel] = index.get(channel, b"") + struct.pack("<QQ", 1, len(plain))
        plain += record
    packed = lz4.frame.compress(plain) if method else plain
    start = struct.pack("<QQQI", 0, 0, len(plain), 0) + text(method) + struct.pack("<Q", len(packed))
    behind = b"".join(mcap_record(7, struct.pack("<H", channel), text(entries)) for channel, entries in index.items())
    return mcap_record(6, start, packed) + behind


def write_mcap(path: Path, rec: Recording, size: int = 7, method: str = "") -> Path:
    """An MCAP of many chunks, each with its index."""
    head = b""
    for number, (topic, kind) in enumerate(TOPICS.items()):
        name, (definition, _) = kind.replace("/msg/", "/"), NOETIC.generate_msgdef(kind)
        head += mcap_record(3, struct.pack("<H", number + 1), text(name), text("ros1msg"), text(definition))
        head += mcap_record(4, struct.pack("<HH", number, number + 1), text(topic), text("ros1"), text(""))
    records = []
    for time, topic, data in messages(rec, NOETIC):
        channel = [*TOPICS].index(topic)
        records.append((channel, mcap_record(5, struct.pack("<HIQQ", channel, 0, time, time), data)))
    chunks = [
        mcap_chunk(records[start : start + size], b"" if start else head, method)
        for start in range(0, len(records), size)
    ]
    magic = b"\x89MCAP0\r\n"
    content = magic + mcap_record(1, text("ros1"), text("test")) + b"".join(chunks)
    path.write_bytes(content + mcap_record(15, bytes(4)) + mcap_record(2, bytes(20)) + magic)
    return path


def write_pages(path: Path, rec: Recording, page: int = 512) -> Path:
    """An SQLite bag with small pages: a tree of several levels, images over many pages."""
    with sqlite3.connect(path) as database:
        database.execute(f"PRAGMA page_size = {page}")
        database.executescript(
            "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT);"
            "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL,"
            " data BLOB NOT NULL);"
            "CREATE INDEX timestamp_idx ON messages (timestamp ASC);"
        )
        numbers = {topic: number + 1 for number, topic in enumerate(TOPICS)}
        database.executemany(
            "INSERT INTO topics VALUES (?, ?, ?, 'cdr')",
            [(numbers[topic], topic, kind) for topic, kind in TOPICS.items()],
        )
        for time, topic, data in messages(rec, JAZZY):
            database.execute(
                "INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)", (numbers[topic], time, data)
            )
    database.close()
    return path


WRITERS: dict[str, Write] = {"rosbag1": write_bag1, "mcap": write_mcap, "sqlite": write_pages}


def check_same(log: Log, rec: Recording) -> None:
    got = as_recording(log)
    for name in ("pose_time", "pose", "command_time", "command"):
        np.testing.assert_array_equal(getattr(got, name), getattr(rec, name))


# The index


def index_entries(content: bytes) -> list[tuple[int, int]]:
    """Where a ROS 1 bag or an MCAP says where a message lies in its chunk: place and bytes of the number."""
    entries: list[tuple[int, int]] = []
    position = 13 if content.startswith(b"#ROSBAG") else 8
    while position < len(content) - 8:
        if content.startswith(b"#ROSBAG"):
            data = position + 4 + int.from_bytes(content[position : position + 4], "little")
            end = data + 4 + int.from_bytes(content[data : data + 4], "little")
            if b"op=\x04" in content[position:data]:
                entries += [(place, 4) for place in range(data + 4 + 8, end, 12)]
        else:
            end = position + 9 + int.from_bytes(content[position + 1 : position + 9], "little")
            if content[position] == 7:
                entries += [(place, 8) for place in range(position + 9 + 6 + 8, end, 16)]
        position = end
    return entries


@pytest.mark.parametrize("name", ["rosbag1", "mcap"])
def test_an_index_that_lies_changes_nothing(name: str, tmp_path: Path) -> None:
    rec, rng = recording(), random.Random(1)
    content = WRITERS[name](tmp_path / "bag", rec).read_bytes()
    entries = index_entries(content)
    assert len(entries) == 78

    for share in (0.02, 0.3, 1.0):
        broken = bytearray(content)
        for place, size in entries:
            if rng.random() < share:
                lie = rng.choice([0, 46, rng.randrange(2000), (1 << 8 * size) - 1, 1 << 8 * size - 1])
                broken[place : place + size] = lie.to_bytes(size, "little")
        (tmp_path / "lies").write_bytes(broken)
        check_same(read(tmp_path / "lies"), rec)


@pytest.mark.parametrize(("name", "module"), [("rosbag1", rosbag1), ("mcap", mcap)])
def test_chunks_without_a_wanted_topic_stay_packed(
    name: str, module: object, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rec = recording()
    path = WRITERS[name](tmp_path / "bag", rec)
    unpacked: list[int] = []
    unpack = module.unpacked  # type: ignore[attr-defined]
    monkeypatch.setattr(module, "unpacked", lambda *words: (unpacked.append(1), unpack(*words))[1])

    everything = read(path)
    chunks, unpacked = len(unpacked), []
    log = read(path, {"/camera"})

    assert len(unpacked) < chunks / 2
    assert log.tables["/camera"].columns["height"].tolist() == [2]
    assert log.skipped["/drone/pose"].endswith("60 messages)")
    assert log.skipped["/cmd_vel"].endswith("17 messages)")
    check_same(everything, rec)


def test_messages_of_two_publishers_keep_the_order_of_the_file(tmp_path: Path) -> None:
    rec = recording()
    with Writer1(tmp_path / "bag") as writer:
        pair = [writer.add_connection("/drone/pose", TOPICS["/drone/pose"], typestore=NOETIC, callerid=f"/{name}")
                for name in "ab"]  # fmt: skip
        for number, (time, topic, data) in enumerate(messages(rec, NOETIC)):
            if topic == "/drone/pose":
                writer.write(pair[number % 3 == 0], time, data)

    stamps = read(tmp_path / "bag").tables["/drone/pose"].columns["header.stamp"]

    np.testing.assert_array_equal(stamps, rec.pose_time)


def test_headers_as_other_writers_lay_them_out_give_the_same(tmp_path: Path) -> None:
    """Fields in another order, and further ones of varying length: the header of each message is read by itself."""
    rec = recording()
    records = b""
    for number, (topic, kind) in enumerate(TOPICS.items()):
        fields = [b"conn=" + struct.pack("<I", number), b"op=\x07", b"topic=" + topic.encode()]
        details = [b"type=" + kind.encode(), b"message_definition=" + NOETIC.generate_msgdef(kind)[0].encode()]
        records += text(b"".join(map(text, fields))) + text(b"".join(map(text, details)))
    for number, (time, topic, data) in enumerate(messages(rec, NOETIC)):
        fields = [
            b"time=" + struct.pack("<II", *divmod(time, 10**9)),
            b"op=\x02",
            b"note=conn=" + b"a" * (number % 30),
            b"conn=" + struct.pack("<I", [*TOPICS].index(topic)),
        ]
        records += text(b"".join(map(text, fields[number % 2 :] + fields[: number % 2]))) + text(data)
    chunk = [b"op=\x05", b"compression=none", b"size=" + struct.pack("<I", len(records))]
    (tmp_path / "bag").write_bytes(b"#ROSBAG V2.0\n" + text(b"".join(map(text, chunk))) + text(records))

    log = read(tmp_path / "bag")

    check_same(log, rec)
    assert log.notes == ()


# SQLite's pages


@pytest.mark.parametrize("page", [512, 4096, 65536])
def test_rows_from_the_pages_are_those_that_sqlite_gives(page: int, tmp_path: Path) -> None:
    rec = recording(900, 200)
    path = write_pages(tmp_path / "bag", rec, page)
    fast = read(path, {"/drone/pose", "/cmd_vel", "/camera"})
    with sqlite3.connect(path) as database:
        database.execute("ALTER TABLE messages ADD COLUMN extra INTEGER")  # no longer as rosbag2 writes it
    database.close()
    slow = read(path, {"/drone/pose", "/cmd_vel", "/camera"})

    check_same(fast, rec)
    assert fast.notes == slow.notes == ()
    for name, table in slow.tables.items():
        for column, values in table.columns.items():
            np.testing.assert_array_equal(fast.tables[name].columns[column], values)


def test_rows_that_were_deleted_and_numbers_of_all_sizes_are_read_as_sqlite_reads_them(tmp_path: Path) -> None:
    rec = recording(300, 60)
    path = write_pages(tmp_path / "bag", rec)
    with sqlite3.connect(path) as database:
        database.execute("DELETE FROM messages WHERE id % 7 = 0")
        database.execute("UPDATE messages SET id = id * 1000003 * 1000003 WHERE id % 5 = 0")
        database.execute("UPDATE messages SET timestamp = id WHERE id % 3 = 0")
        database.execute("UPDATE messages SET timestamp = id * 70000 WHERE id % 4 = 0 AND id < 1000")
        expected = [
            [time for (time,) in database.execute(f"SELECT timestamp FROM messages WHERE topic_id = {n} ORDER BY id")]
            for n in (1, 2)
        ]
    database.close()

    log = read(path)

    for topic, times in zip(("/drone/pose", "/cmd_vel"), expected, strict=True):
        assert log.tables[topic].columns["log_time"].tolist() == times


# Damage


def ends_of_messages(content: bytes, rec: Recording, store: object) -> np.ndarray:
    """Where the bytes of the poses and the commands end in a file that is not packed, ascending."""
    data = [data for _, topic, data in messages(rec, store) if topic != "/camera"]
    assert all(content.count(one) == 1 for one in data)
    return np.sort([content.index(one) + len(one) for one in data])


@pytest.mark.parametrize("name", WRITERS)
def test_of_a_bag_cut_at_50_random_places_every_message_before_the_cut_is_read(name: str, tmp_path: Path) -> None:
    rec, rng = recording(400, 90), random.Random(5)
    content = WRITERS[name](tmp_path / "bag", rec).read_bytes()
    ends = ends_of_messages(content, rec, JAZZY if name == "sqlite" else NOETIC)
    page = 512 if name == "sqlite" else 1  # what lies in a page that is half there cannot be told from zeros
    for cut in (rng.randrange(1, len(content)) for _ in range(50)):
        (tmp_path / "cut").write_bytes(content[:cut])
        before = int(np.searchsorted(ends, cut - cut % page, side="right"))
        log = log_or_line(tmp_path / "cut")
        if log is None:
            assert before == 0
            continue
        tables = [log.tables[topic].columns["log_time"] for topic in ("/drone/pose", "/cmd_vel") if topic in log.tables]
        assert sum(map(len, tables)) >= before
        assert all((np.diff(times) > 0).all() for times in tables)
        assert log.damage or sum(map(len, tables)) == 490


def write_loose(path: Path, rec: Recording) -> Path:
    """An MCAP without chunks, with the channels once more in its summary."""
    records, channels = list[bytes](), b""
    for number, (topic, kind) in enumerate(TOPICS.items()):
        name, (definition, _) = kind.replace("/msg/", "/"), NOETIC.generate_msgdef(kind)
        channels += mcap_record(3, struct.pack("<H", number + 1), text(name), text("ros1msg"), text(definition))
        channels += mcap_record(4, struct.pack("<HH", number, number + 1), text(topic), text("ros1"), text(""))
    for time, topic, data in messages(rec, NOETIC):
        records.append(mcap_record(5, struct.pack("<HIQQ", [*TOPICS].index(topic), 0, time, time), data))
    magic = b"\x89MCAP0\r\n"
    content = magic + mcap_record(1, text("ros1"), text("test")) + channels + b"".join(records)
    content += mcap_record(15, bytes(4))
    footer = mcap_record(2, struct.pack("<QQI", len(content), 0, 0))
    path.write_bytes(content + channels + footer + magic)
    return path


HOLED: dict[str, Write] = {
    "mcap, loose": write_loose,
    "mcap, many chunks": write_mcap,
    "mcap, one chunk": lambda path, rec: write_mcap(path, rec, 10_000),
    "rosbag1, many chunks": write_bag1,
    "rosbag1, one chunk": lambda path, rec: write_bag1(path, rec, 1 << 20),
}


@pytest.mark.parametrize("noise", [False, True], ids=["zeros", "noise"])
@pytest.mark.parametrize("name", HOLED)
def test_a_hole_costs_what_it_hits_and_its_size_is_told(name: str, noise: bool, tmp_path: Path) -> None:
    rec, rng, hole = recording(400, 90), random.Random(6), 2000
    content = HOLED[name](tmp_path / "bag", rec).read_bytes()
    data = {time: data for time, topic, data in messages(rec, NOETIC) if topic != "/camera"}
    places = {content.index(one): time for time, one in data.items()}
    first, last = min(places) + 3000, max(places) - 6000
    for at in (rng.randrange(first, last) for _ in range(12)):
        filling = rng.randbytes(hole) if noise else bytes(hole)
        (tmp_path / "hole").write_bytes(content[:at] + filling + content[at + hole :])

        log = read(tmp_path / "hole")

        got = as_recording(log)
        assert set(map(tuple, got.pose)) <= set(map(tuple, rec.pose))  # nothing is made up
        assert set(map(tuple, got.command)) <= set(map(tuple, rec.command))
        missing = 490 - len(got.pose) - len(got.command)
        hit = sum(at - 2000 < place < at + hole + 500 for place in places)  # with a chunk's head or index, its rest
        assert missing <= hit, f"{missing} of {hit} at {at}"
        assert not missing or "bytes lost" in log.damage[0]
        assert missing < 5 or "s without a message" in log.damage[0]


def test_the_channels_of_an_mcap_are_found_in_its_summary(tmp_path: Path) -> None:
    rec = recording(400, 90)
    content = write_loose(tmp_path / "bag", rec).read_bytes()
    (tmp_path / "hole").write_bytes(content[:30] + bytes(3000) + content[3030:])

    log = read(tmp_path / "hole")

    assert len(as_recording(log).pose) > 300
    assert "bytes lost" in log.damage[0]


def test_a_summary_that_begins_in_a_hole_is_left_at_once() -> None:
    magic = b"\x89MCAP0\r\n"
    channel = mcap_record(4, struct.pack("<HH", 1, 0) + text("/cmd_vel") + text("ros1") + text(""))
    footer = mcap_record(2, struct.pack("<QQI", len(magic), 0, 0))

    assert [*summary_channels(magic + channel + footer + magic)]
    assert not [*summary_channels(magic + bytes(9000) + channel + footer + magic)]


def test_messages_behind_a_page_of_the_tree_that_is_lost_are_found(tmp_path: Path) -> None:
    rec = recording(400, 90)
    content = bytearray(write_pages(tmp_path / "bag", rec).read_bytes())
    interior = [place for place in range(512, len(content), 512) if content[place] == 5]
    assert len(interior) > 2
    for place in interior[1:]:
        content[place : place + 512] = bytes(512)
    (tmp_path / "holes").write_bytes(content)

    log = read(tmp_path / "holes")

    check_same(log, rec)
    assert "is damaged" in log.damage[0]


# Hostile files


def quick_and_small(path: Path, most: int, seconds: float = 20) -> Log | None:
    """Reads a file within bounds of memory and time: a log, or None for a line that says why not."""
    tracemalloc.start()
    start = process_time()
    log = log_or_line(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < most
    assert process_time() - start < seconds
    return log


@pytest.mark.parametrize("name", WRITERS)
def test_lengths_that_claim_anything_are_bounded(name: str, tmp_path: Path) -> None:
    content = WRITERS[name](tmp_path / "bag", recording(40, 10)).read_bytes()
    rng = random.Random(8)
    for _ in range(40):
        broken = bytearray(content)
        place, size = rng.randrange(8, len(content) - 8), rng.choice([4, 8])
        broken[place : place + size] = rng.choice([1 << 8 * size - 4, (1 << 8 * size) - 1]).to_bytes(size, "little")
        (tmp_path / "claims").write_bytes(broken)
        quick_and_small(tmp_path / "claims", 50 << 20)


@pytest.mark.parametrize("kind", ["index", "record", "chunk"])
def test_an_mcap_that_claims_2_to_the_60_bytes_gives_what_is_before(kind: str, tmp_path: Path) -> None:
    rec = recording()
    content = write_mcap(tmp_path / "bag", rec).read_bytes()[: -(13 + 29 + 8)]
    huge = struct.pack("<Q", 1 << 60)
    ends = {
        "index": b"\x07" + huge,
        "record": b"\x05" + huge,
        "chunk": mcap_record(6, struct.pack("<QQ", 0, 0) + huge + bytes(4) + text("lz4") + huge + bytes(9)),
    }
    (tmp_path / "huge").write_bytes(content + ends[kind])

    log = quick_and_small(tmp_path / "huge", 50 << 20)

    assert log is not None
    check_same(log, rec)
    assert log.damage


def test_a_chunk_of_thousands_of_frames_is_refused_quickly(tmp_path: Path) -> None:
    frames = lz4.frame.compress(b"") * 100_000
    head = struct.pack("<QQQI", 0, 0, 1 << 20, 0) + text("lz4") + struct.pack("<Q", len(frames))
    (tmp_path / "bag").write_bytes(b"\x89MCAP0\r\n" + mcap_record(6, head, frames))

    assert quick_and_small(tmp_path / "bag", 50 << 20) is None


def test_a_chain_of_pages_that_bites_its_tail_ends(tmp_path: Path) -> None:
    path = tmp_path / "bag"
    write_pages(path, recording(3, 1))
    with sqlite3.connect(path) as database:
        database.executemany(
            "INSERT INTO messages (topic_id, timestamp, data) VALUES (1, ?, zeroblob(200000))",
            [(time,) for time in range(20)],
        )
        database.commit()
    database.close()
    content = bytearray(path.read_bytes())
    for place in range(512, len(content), 512):
        following = int.from_bytes(content[place : place + 4], "big")
        if following == place // 512 + 2:  # an overflow page: make it its own successor
            content[place : place + 4] = (place // 512 + 1).to_bytes(4, "big")
    path.write_bytes(content)

    quick_and_small(path, 100 << 20)


def test_topics_without_end_are_not_taken(tmp_path: Path) -> None:
    definition = "float64 a\n" * 20
    fields = [
        (b"conn=" + struct.pack("<I", number), b"topic=/" + str(number).encode()) for number in range((1 << 14) + 1)
    ]
    details = text(b"type=a/B") + text(b"message_definition=" + definition.encode())
    bag = b"".join(text(text(b"op=\x07") + text(one) + text(two)) + text(details) for one, two in fields)
    (tmp_path / "topics").write_bytes(b"#ROSBAG V2.0\n" + bag)

    assert quick_and_small(tmp_path / "topics", 100 << 20) is None


def test_messages_of_as_many_shapes_as_there_are_messages_are_all_read() -> None:
    topic = Topic("/words", "a/msg/B", "ros1", "string one\nstring two\nfloat64 x")
    words = [(text("a" * row) + text("b" * (300 - row)), float(row)) for row in range(300)]

    got = decoded(topic, types_of(topic), messages_of([head + struct.pack("<d", x) for head, x in words]))

    np.testing.assert_array_equal(got.columns["x"], np.arange(300.0))
    assert got.fault == ""


# Memory


def test_reading_poses_between_images_takes_little_more_memory_than_the_poses(tmp_path: Path) -> None:
    rec = recording(2000, 10)
    header = struct.pack("<III", 1, 2, 3) + text("map")
    picture = header + struct.pack("<II", 1000, 1000) + text("mono8") + b"\0" + struct.pack("<I", 1000)
    image = picture + text(bytes(1_000_000))
    with Writer1(tmp_path / "bag") as writer:
        pose = writer.add_connection("/drone/pose", TOPICS["/drone/pose"], typestore=NOETIC)
        camera = writer.add_connection("/camera", IMAGE, typestore=NOETIC)
        for number, (time, topic, data) in enumerate(messages(rec, NOETIC)):
            if topic == "/drone/pose":
                writer.write(pose, time, data)
            if number % 50 == 0:
                writer.write(camera, time, image)
    read(tmp_path / "bag", {"/drone/pose"})  # what is imported on use is imported

    log = quick_and_small(tmp_path / "bag", 16 << 20)

    assert log is not None
    assert len(log.tables["/drone/pose"].columns["log_time"]) == 2000


# What a card needs


CARD = {
    "command": {"time": "/cmd_vel:header.stamp", "x": "/cmd_vel:twist.linear.x"},
    "pose": {
        "time": "/drone/pose:header.stamp",
        **{axis: f"/drone/pose:pose.position.{axis}" for axis in "xyz"},
        "quaternion": "/drone/pose:pose.orientation",
    },
}


def test_a_card_names_its_tables_or_none_where_a_log_has_only_one() -> None:
    assert tables_of(card_from_mapping(CARD, "test")) == {"/cmd_vel", "/drone/pose"}
    window = card_from_mapping(CARD | {"window": {"when": "/state:armed"}}, "test")
    assert tables_of(window) == {"/cmd_vel", "/drone/pose", "/state"}
    assert tables_of(builtin_cards()["bebop2-wsu"]) is None


def test_a_flight_with_a_card_decodes_the_tables_of_the_card_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_storage(tmp_path / "bag", recording(600, 170))
    asked: list[object] = []
    monkeypatch.setattr(
        "rotorfit.app.workflows.read", lambda path, tables=None, _=None: (asked.append(tables), read(path, tables))[1]
    )

    flight = load_flight(LogSpan(str(path), WHOLE), card_from_mapping(CARD, "test"))

    assert asked == [{"/cmd_vel", "/drone/pose"}]
    assert flight.duration > 0


# Fuzz


@cache
def sample(name: str) -> bytes:
    """A small bag."""
    with TemporaryDirectory() as folder:
        return WRITERS[name](Path(folder) / "bag", recording(60, 17)).read_bytes()


@settings(max_examples=150)
@given(
    st.sampled_from(sorted(WRITERS)),
    st.lists(st.tuples(st.floats(0, 1, exclude_max=True), st.binary(min_size=1, max_size=4)), min_size=1, max_size=6),
    st.floats(0.05, 1),
)
def test_a_bag_changed_at_random_gives_a_log_or_one_line(
    name: str, edits: list[tuple[float, bytes]], kept: float
) -> None:
    content = bytearray(sample(name))
    for place, noise in edits:
        start = int(place * len(content))
        content[start : start + len(noise)] = noise

    survives(bytes(content[: int(kept * len(content)) + 1]))
