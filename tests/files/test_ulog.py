"""PX4 logs: what becomes of topics, instances and nested types; what is left of damaged and hostile files."""

import struct
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from autopilot_logs import (
    ULOG_HEADER,
    ULOG_STATE,
    ULOG_SYNC,
    ulog,
    ulog_data,
    ulog_format,
    ulog_record,
    ulog_states,
    ulog_subscription,
)
from rotorfit.core.errors import LogError
from rotorfit.core.log import Log
from rotorfit.diagnosis.survey import survey
from rotorfit.files.logs import read
from rotorfit.files.logs import ulog as reader

STAMPS = np.arange(1_000_000, 3_000_000, 10_000)
STATES = ulog_states(STAMPS.tolist())
HEAD = ulog(ULOG_STATE, ulog_subscription(0, "state"))


def log_of(folder: Path, content: bytes, tables: set[str] | None = None) -> Log:
    (folder / "log.ulg").write_bytes(content)
    return read(folder / "log.ulg", tables)


def test_topics_are_tables_with_arrays_as_matrices_and_stamps_as_recorded(tmp_path: Path) -> None:
    log = log_of(tmp_path, HEAD + b"".join(STATES))

    columns = log.tables["state"].columns
    assert list(log.tables) == ["state"]
    assert list(columns) == ["timestamp", "x", "v", "armed"]
    assert [values.dtype.str for values in columns.values()] == ["<u8", "<f4", "<f4", "|b1"]
    np.testing.assert_array_equal(columns["timestamp"], STAMPS)
    np.testing.assert_array_equal(columns["x"], STAMPS / 1000)
    np.testing.assert_array_equal(columns["v"], np.tile([1, 2, 3], (len(STAMPS), 1)))
    assert columns["armed"].all()
    assert log.notes == ()
    assert log.skipped == {}


def test_instances_are_tables_of_their_own_and_never_take_the_name_of_a_topic(tmp_path: Path) -> None:
    names = [("state", 0), ("state_1", 0), ("state", 1), ("state", 2)]
    formats = ULOG_STATE + ulog_format("state_1", "uint64_t timestamp;float y;")
    subscriptions = [ulog_subscription(number, *name) for number, name in enumerate(names)]
    data = [*ulog_states([5], 0), ulog_data(1, "Qf", 6, 0.5), *ulog_states([7], 2), *ulog_states([8], 3)]

    log = log_of(tmp_path, ulog(formats, subscriptions, data))

    stamps = {name: table.columns["timestamp"].tolist() for name, table in log.tables.items()}
    assert stamps == {"state": [5], "state_1": [6], "state[1]": [7], "state_2": [8]}


def test_nested_types_are_dotted_and_text_and_wide_arrays_are_named_in_a_note(tmp_path: Path) -> None:
    formats = [
        ulog_format("esc", "uint8_t[2] _padding0;int16_t rpm;float[2] load;"),
        ulog_format("all", "uint64_t timestamp;esc best;esc[2] each;char[4] text;uint8_t[65] wide;int16_t last;"),
    ]
    one = [9, 9, 7, 0.5, 0.25]
    data = ulog_data(3, "Q" + "BBhff" * 3 + "4s65sh", 1, *one, *one, *one, b"abcd", bytes(65), -3)

    log = log_of(tmp_path, ulog(formats, ulog_subscription(3, "all"), data))

    assert {name: values.tolist() for name, values in log.tables["all"].columns.items()} == {
        "timestamp": [1], "best.rpm": [7], "best.load": [[0.5, 0.25]], "each[0].rpm": [7],
        "each[0].load": [[0.5, 0.25]], "each[1].rpm": [7], "each[1].load": [[0.5, 0.25]], "last": [-3],
    }  # fmt: skip
    assert log.notes == ("columns left out because they hold text or more than 64 numbers: all:text, all:wide",)


def test_only_the_topics_asked_for_are_decoded(tmp_path: Path) -> None:
    content = ulog(ULOG_STATE, ulog_subscription(0, "state"), ulog_subscription(1, "state", 1), STATES)
    content += b"".join(ulog_states([1, 2], 1))

    log = log_of(tmp_path, content, {"state_1"})

    assert list(log.tables) == ["state_1"]
    assert log.skipped == {"state": "not asked for (200 messages)"}


def test_dropouts_are_counted_and_other_records_passed_over(tmp_path: Path) -> None:
    others = [
        ulog_record("I", b"\x08char a b", b"value"), ulog_record("P", b"\x09float KPX", bytes(4)),
        ulog_record("L", b"6", bytes(8), b"a text"), ulog_record("M", b"\0\x08char a b", bytes(40_000)),
        ulog_record("S", ULOG_SYNC), ulog_record("R", b"\0\0"),
        ulog_record("O", struct.pack("<H", 250)), ulog_record("O", struct.pack("<H", 500)),
    ]  # fmt: skip

    log = log_of(tmp_path, HEAD + b"".join([*STATES[:100], *others, *STATES[100:]]))

    np.testing.assert_array_equal(log.tables["state"].columns["timestamp"], STAMPS)
    assert log.notes == ("2 dropouts of the logger, 0.75 s in all: messages are missing there",)


def test_what_a_crash_left_behind_is_read_from_where_it_was_appended(tmp_path: Path) -> None:
    flags = struct.Struct("<8s8s3Q")
    head = ULOG_HEADER + ulog_record("B", bytes(40)) + ULOG_STATE + ulog_subscription(0, "state")
    first = head + b"".join(STATES[:150]) + STATES[150][:9]
    bits = ulog_record("B", flags.pack(bytes(8), b"\x01" + bytes(7), len(first), 0, 0))

    log = log_of(tmp_path, ULOG_HEADER + bits + first[len(ULOG_HEADER) + len(bits) :] + b"".join(STATES[151:]))

    np.testing.assert_array_equal(log.tables["state"].columns["timestamp"], np.delete(STAMPS, 150))
    assert log.notes == ()


def test_a_log_of_a_later_version_is_refused_in_one_line(tmp_path: Path) -> None:
    bits = ulog_record("B", struct.pack("<8s8s3Q", bytes(8), b"\x02" + bytes(7), 0, 0, 0))

    with pytest.raises(LogError, match="later version of ULog"):
        log_of(tmp_path, ULOG_HEADER + bits + HEAD[len(ULOG_HEADER) :] + b"".join(STATES))


@pytest.mark.parametrize("seed", range(50))
def test_a_truncated_log_gives_every_message_before_the_cut(seed: int, tmp_path: Path) -> None:
    content = HEAD + b"".join(STATES)
    first, each = len(HEAD) + len(STATES[0]), len(STATES[0])
    cut = int(np.random.default_rng(seed).integers(first, len(content)))

    log = log_of(tmp_path, content[:cut])

    whole = (cut - len(HEAD)) // each
    np.testing.assert_array_equal(log.tables["state"].columns["timestamp"], STAMPS[:whole])
    left = cut - len(HEAD) - whole * each
    said = f"the file ends in the middle of a record, of which it holds {left} bytes: what came after is lost"
    assert log.damage == ((said,) if left else ())


@pytest.mark.parametrize("damage", ["zeros", "noise", "torn", "doubled"])
def test_damage_costs_the_records_that_it_hits_and_no_others(damage: str, tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    at, each = len(HEAD) + 60 * len(STATES[0]) + 7, len(STATES[0])
    content = HEAD + b"".join(STATES)
    replaced = {"zeros": bytes(100), "noise": rng.bytes(100), "torn": b"", "doubled": content[at - 50 : at + 100]}
    content = content[:at] + replaced[damage] + content[at + 100 :]

    log = log_of(tmp_path, content)

    got = log.tables["state"].columns["timestamp"]
    assert set(STAMPS[:60]) | set(STAMPS[60 + 100 // each + 2 :]) <= set(got.tolist())
    assert set(got.tolist()) <= set(STAMPS.tolist())
    assert any(text.startswith(("damaged at byte", "damaged in")) for text in log.damage)


def test_blocks_change_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    content = HEAD + b"".join(STATES[:90]) + b"\xff" * 33 + b"".join(STATES[90:])
    whole = log_of(tmp_path, content)
    monkeypatch.setattr("rotorfit.files.logs.autopilot_records._BLOCK", 101)

    in_blocks = log_of(tmp_path, content)

    for name, values in whole.tables["state"].columns.items():
        np.testing.assert_array_equal(in_blocks.tables["state"].columns[name], values)
    assert in_blocks.notes == whole.notes


HOSTILE = {
    "claims a huge array": ulog_format("state", "float[65535] a;float[65535] b;"),
    "holds itself": ulog_format("state", "state again;"),
    "grows without bound": b"".join(
        ulog_format(name, "".join(f"{below} f{i};" for i in range(99)))
        for name, below in [("state", "b"), "bc", "cd", "de", "ef"]
    ) + ulog_format("f", "uint8_t a;"),
    "nests empty types": ulog_format("state", "a[99999] b;") + ulog_format("a", ""),
    "names an unknown type": ulog_format("state", "nobody b;"),
    "is no definition": ulog_format("state", "\0\1\2;;;float"),
}  # fmt: skip


@pytest.mark.parametrize("name", HOSTILE)
def test_a_definition_that_cannot_be_costs_its_topic_only(name: str, tmp_path: Path) -> None:
    good = ulog_format("good", "uint64_t timestamp;") + ulog_subscription(1, "good")
    tracemalloc.start()

    log = log_of(tmp_path, ulog(HOSTILE[name], ulog_subscription(0, "state"), good, [ulog_data(1, "Q", 5)] * 3))

    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert list(log.tables) == ["good"]
    assert list(log.skipped) == ["state"]
    assert peak < 64 << 20


def test_a_log_without_messages_says_what_to_check(tmp_path: Path) -> None:
    with pytest.raises(
        LogError, match=r"no message in the log \(1 topics announced\); check that the vehicle was armed"
    ):
        log_of(tmp_path, HEAD)
    with pytest.raises(LogError, match="no message in the log"):
        log_of(tmp_path, ULOG_HEADER[:11])


def test_a_number_that_is_given_away_again_belongs_to_its_new_topic_from_there_on(tmp_path: Path) -> None:
    other = ulog_format("other", "uint64_t timestamp;double[8] long;") + ulog_subscription(0, "other")

    log = log_of(tmp_path, HEAD + b"".join(STATES[:3]) + other + ulog_data(0, "Q8d", 4, *range(8)))

    assert {name: len(table.columns["timestamp"]) for name, table in log.tables.items()} == {"state": 3, "other": 1}


@pytest.mark.parametrize("period", [1_000, 100_000, 3_000_000])
def test_a_survey_takes_stamps_for_microseconds_however_slow_a_topic_is(period: int, tmp_path: Path) -> None:
    log = log_of(tmp_path, HEAD + b"".join(ulog_states(range(period, 20 * period, period))))

    (table,) = survey(log).tables

    assert table.rate is not None
    assert table.rate.period == pytest.approx(period / 1e6)


@settings(max_examples=150, database=None, derandomize=True)
@given(st.lists(st.tuples(st.integers(0, 4000), st.binary(max_size=12), st.integers(0, 40)), min_size=1, max_size=6))
def test_mutated_logs_are_read_or_refused_in_one_line(changes: list[tuple[int, bytes, int]]) -> None:
    content = bytearray(HEAD + ulog_record("S", ULOG_SYNC) + b"".join(STATES[:80]))
    for position, new, removed in changes:
        content[position : position + removed] = new
    log = reader._Log(None)
    end = len(content)

    stopped = reader._step(log, bytes(content), 0, last=True)

    assert 0 <= stopped <= end
    assert sum(topic.count for topic in log.topics.values()) <= 80 + sum(len(new) for _, new, _ in changes)


def assert_as_pyulog(path: Path) -> None:
    """Reads a log and compares every number with pyulog."""
    other = pytest.importorskip("pyulog").ULog(str(path))
    log, compared = read(path), 0
    for data in other.data_list:
        table = log.tables[f"{data.name}_{data.multi_id}" if data.multi_id else data.name]
        for name, values in table.columns.items():
            parts = {name: values} if values.ndim == 1 else {f"{name}[{i}]": part for i, part in enumerate(values.T)}
            for label, part in parts.items():
                np.testing.assert_array_equal(part, data.data[label])
                compared += 1
    assert compared > 5


def test_a_log_comes_as_pyulog_reads_it(tmp_path: Path) -> None:
    log_of(tmp_path, HEAD + b"".join(STATES))
    assert_as_pyulog(tmp_path / "log.ulg")


def test_a_real_log_comes_as_pyulog_reads_it(real_flights: Path) -> None:
    assert_as_pyulog(real_flights / "px4-s500" / "TestFlight1.ulg")


def test_a_real_log_is_read_whole(real_flights: Path) -> None:
    log = read(real_flights / "px4-s500" / "TestFlight1.ulg")

    position = log.tables["vehicle_local_position"].columns
    assert (len(log.tables), log.skipped, log.notes) == (77, {}, ())  # reports of three crashes are appended
    assert {"sensor_accel", "sensor_accel_1"} <= set(log.tables)
    assert len(position["x"]) == 586
    assert np.all(np.diff(position["timestamp"].astype(np.int64)) > 0)
    assert log.tables["vehicle_attitude"].columns["q"].shape == (1171, 4)
    setpoint = log.tables["vehicle_local_position_setpoint"].columns
    assert np.isnan(setpoint["vx"]).any()  # before control starts
    assert np.isfinite(setpoint["vx"]).any()
    assert np.ptp(position["heading_reset_counter"]) > 0
