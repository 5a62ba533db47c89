"""ArduPilot logs: units of the format, instances, messages without a time; what is left of damaged files."""

import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from autopilot_logs import FLASH_ATT, FLASH_FMT, flash, flash_attitudes, flash_format, flash_record
from rotorfit.core.errors import LogError
from rotorfit.core.log import Log
from rotorfit.files.cards import card_from_mapping, load_card
from rotorfit.files.logs import dataflash as reader
from rotorfit.files.logs import read
from rotorfit.flights.assemble import flight_from_log
from rotorfit.flights.columns import card_for, column, unit_note
from rotorfit.flights.streams import commands_of

STAMPS = np.arange(1_000_000, 3_000_000, 10_000)
ATTITUDES = flash_attitudes(STAMPS.tolist())
HEAD = flash(FLASH_ATT)


def log_of(folder: Path, content: bytes, tables: set[str] | None = None) -> Log:
    (folder / "log.bin").write_bytes(content)
    return read(folder / "log.bin", tables)


def test_messages_are_tables_and_numbers_are_divided_as_their_format_says(tmp_path: Path) -> None:
    log = log_of(tmp_path, HEAD + b"".join(ATTITUDES))

    columns = log.tables["ATT"].columns
    assert (log.format, list(log.tables), log.notes) == ("dataflash", ["ATT"], ())
    assert log.skipped == {}
    np.testing.assert_array_equal(columns["TimeUS"], STAMPS)
    np.testing.assert_array_equal(columns["Roll"], STAMPS // 1000 / 100)
    np.testing.assert_array_equal(columns["Pitch"], -0.05)
    np.testing.assert_array_equal(columns["Yaw"], 359.99)


@pytest.mark.parametrize(
    ("codes", "values", "expected"),
    [
        ("bBhHiIfdqQM", [-1, 2, -3, 4, -5, 6, 0.5, 0.1, -7, 8, 9], [-1, 2, -3, 4, -5, 6, 0.5, 0.1, -7, 8, 9]),
        (
            "cnCNeELag",
            [-150, b"abcd", 250, b"text", -35_000, 45_000, -123_456_789, range(32), 1.5],
            [-1.5, 2.5, -350, 450, -12.3456789, list(range(32)), 1.5],
        ),
    ],
)
def test_every_character_of_a_format_is_understood_and_texts_are_passed_over(
    codes: str, values: list[object], expected: list[object], tmp_path: Path
) -> None:
    labels = ",".join(f"{code}{code.isupper():d}" for code in codes)
    content = flash(flash_format(7, "ALL", codes, labels), [flash_record(7, codes, *values)] * 3)

    columns = log_of(tmp_path, content).tables["ALL"].columns

    assert list(columns) == [label for label in labels.split(",") if label[0] not in "nNZ"]
    assert [column[1].tolist() for column in columns.values()] == expected


def test_instances_are_tables_of_their_own(tmp_path: Path) -> None:
    formats = [
        flash_format(2, "XKF1", "QBf", "TimeUS,C,PN"),
        flash_format(3, "FMTU", "QBNN", "TimeUS,FmtType,UnitIds,MultIds"),
        flash_record(3, "QBNN", 0, 2, b"s#m", b"F--"),
    ]
    rows = [flash_record(2, "QBf", t, core, t + core / 4) for t in range(5) for core in (0, 1)]

    log = log_of(tmp_path, flash(formats, rows))
    one = log_of(tmp_path, flash(formats, rows), {"XKF1_1"})

    assert log.tables["XKF1"].columns["PN"].tolist() == [0, 1, 2, 3, 4]
    assert log.tables["XKF1_1"].columns["PN"].tolist() == [0.25, 1.25, 2.25, 3.25, 4.25]
    assert list(one.tables) == ["XKF1_1"]
    assert one.skipped["XKF1"] == "not asked for"


UNITS = [
    flash_format(3, "FMTU", "QBNN", "TimeUS,FmtType,UnitIds,MultIds"),
    flash_format(4, "UNIT", "QbZ", "TimeUS,Id,Label"),
    flash_format(5, "MULT", "Qbd", "TimeUS,Id,Mult"),
    *(flash_record(4, "QbZ", 0, ord(mark), name) for mark, name in (("n", b"m/s"), ("h", b"degheading"), ("v", b"V"))),
    *(flash_record(5, "Qbd", 0, ord(mark), size) for mark, size in (("0", 1.0), ("B", float(np.float32(0.01))))),
]


def guided(multipliers: bytes) -> list[bytes]:
    """Set-points of 0.5 m/s north; which of their columns were multiplied by what, is said."""
    return [
        *UNITS,
        flash_format(2, "GUIP", "QffCf", "TimeUS,vX,vY,Yaw,Volt"),
        flash_record(3, "QBNN", 0, 2, b"snnhv", b"F" + multipliers),
        *(flash_record(2, "QffCf", t, 0.5, 0.0, 4500, 11.0) for t in range(0, 9_000_000, 20_000)),
    ]


@pytest.mark.parametrize(
    ("multipliers", "unit"), [(b"00B0", "m/s"), (b"BBB0", "cm/s"), (b"--B-", None), (b"??B?", None), (b"XX00", None)]
)
def test_a_log_says_in_which_units_its_numbers_are(multipliers: bytes, unit: str | None, tmp_path: Path) -> None:
    log = log_of(tmp_path, flash(guided(multipliers)))

    said = {("GUIP", name): unit for name in ("vX", "vY")} if unit else {}
    assert log.units == {**said, ("GUIP", "Yaw"): "deg"}  # which its format has divided already


def test_the_units_of_the_log_stand_over_those_of_the_card_and_that_is_said(tmp_path: Path) -> None:
    raw = {
        "command": {
            "time": {"from": "GUIP:TimeUS", "unit": "us"},
            "x": {"from": "GUIP:vX", "unit": "cm/s", "scale": -1, "meaning": "velocity"},
            "y": {"from": "GUIP:vY", "meaning": "velocity"},
        },
        "pose": {
            "time": {"from": "GUIP:TimeUS", "unit": "us"}, "x": "GUIP:vX", "y": 0, "z": 0,
            "yaw": {"from": "GUIP:Yaw", "unit": "deg"},
        },
    }  # fmt: skip
    card = card_from_mapping(raw, "test")
    log = log_of(tmp_path, flash(guided(b"00B0")))

    bound = card_for(log, card)

    assert column(log, bound.command["x"])[0] == -0.5
    assert (bound.command["y"], bound.pose) == (card.command["y"], card.pose)  # a speed is no place
    assert unit_note(card, bound) == "by the log's own units, over the card's: GUIP:vX is in m/s, not in cm/s"
    assert unit_note(card, card_for(log_of(tmp_path, flash(guided(b"BBB0"))), card)).endswith(
        ": GUIP:vY is in cm/s, not in SI"
    )


def test_set_points_of_a_real_autopilot_are_metres_a_second_as_its_log_says(real_flights: Path) -> None:
    path = real_flights / "arducopter-sitl" / "s01.BIN"
    if not path.exists():
        pytest.skip(f"{path} is absent")
    flight = flight_from_log(read(path), load_card("arducopter-guided"))

    assert 0.3 < np.abs(flight.command[:, :2]).max() < 0.5
    assert [note.text for note in flight.notes if note.code == "units"] == [
        "by the log's own units, over the card's: GUIP:vY is in m/s, not in cm/s; GUIP:vX is in m/s, not in cm/s; "
        "GUIP:vZ is in m/s, not in cm/s"
    ]


OLD = flash(
    flash_format(1, "ATT", "Icc", "TimeMS,Roll,Pitch"),
    flash_format(2, "MODE", "MH", "Mode,ThrCrs"),
    flash_format(4, "GPS", "BIHI", "Status,TimeMS,Week,T"),
)


def test_messages_without_a_time_get_it_from_their_place_in_the_file(tmp_path: Path) -> None:
    rows = []
    for t in range(1000, 61_000, 20):
        rows.append(flash_record(1, "Icc", t, 5, 6))
        rows += [flash_record(4, "BIHI", 3, 400_000_000 + t, 1800, t)] * (t % 200 == 0)
        rows += [flash_record(2, "MH", t // 1000, 500)] * (t % 10_000 == 0)

    log = log_of(tmp_path, OLD + b"".join(rows))
    alone = log_of(tmp_path, OLD + b"".join(rows), {"MODE"})

    mode = log.tables["MODE"].columns
    assert mode["log_time"].dtype == np.int64
    np.testing.assert_allclose(mode["log_time"] / 1e9, mode["Mode"], atol=0.04)  # not the satellites' 400000 s
    np.testing.assert_array_equal(alone.tables["MODE"].columns["log_time"], mode["log_time"])
    assert "log_time" not in log.tables["ATT"].columns
    assert log.notes == ("no time in MODE: their log_time is interpolated between messages that have one",)


def test_the_mode_opens_a_window_on_commands_of_another_message(tmp_path: Path) -> None:
    rows = []
    for t in range(1000, 11_000, 20):
        rows += [flash_record(2, "MH", t >= 5000, 500)] * (t in (1000, 5000))
        rows.append(flash_record(1, "Icc", t, t % 300, 6))
    raw = {
        "command": {"time": {"from": "ATT:TimeMS", "unit": "ms"}, "x": "ATT:Roll"},
        "pose": {"time": {"from": "ATT:TimeMS", "unit": "ms"}, "x": "ATT:Roll", "y": 0, "z": 0, "yaw": 0},
        "window": {"when": "MODE:Mode"},
    }

    commands, _, _ = commands_of(log_of(tmp_path, OLD + b"".join(rows)), card_from_mapping(raw, "test"))

    assert commands.stamps[0] / 1e9 == pytest.approx(5.0, abs=0.04)
    assert len(commands.stamps) == pytest.approx(300, abs=2)


def test_a_log_whose_only_clock_is_that_of_satellites_is_stamped_by_it_between_the_fixes(tmp_path: Path) -> None:
    formats = flash_format(1, "ATT", "cc", "Roll,Pitch"), flash_format(4, "GPS", "BI", "Status,Time")
    rows = [
        flash_record(4, "BI", 3, 7000 + 200 * fix) + b"".join(flash_record(1, "cc", 5, 6) for _ in range(10))
        for fix in range(1000)
    ]

    attitude = log_of(tmp_path, flash(*formats, rows)).tables["ATT"].columns

    expected = 7000 + 200 * np.arange(1000)[:, np.newaxis] + 200 * (np.arange(10) + 0.4) / 10
    assert np.abs(attitude["log_time"] / 1e6 - expected.ravel())[:-30].max() < 30  # ms


def test_a_log_of_definitions_only_is_refused_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="the log defines 1 messages and holds none of them; download it"):
        log_of(tmp_path, HEAD)
    with pytest.raises(LogError, match=r"holds none of them \(the file ends in the middle"):
        log_of(tmp_path, HEAD[:-5])


@pytest.mark.parametrize("seed", range(50))
def test_a_truncated_log_gives_every_message_before_the_cut(seed: int, tmp_path: Path) -> None:
    content, each = HEAD + b"".join(ATTITUDES), len(ATTITUDES[0])
    cut = int(np.random.default_rng(seed).integers(len(HEAD) + each, len(content)))

    log = log_of(tmp_path, content[:cut])

    whole, left = divmod(cut - len(HEAD), each)
    np.testing.assert_array_equal(log.tables["ATT"].columns["TimeUS"], STAMPS[:whole])
    said = f"the file ends in the middle of a record, of which it holds {left} bytes: what came after is lost"
    assert log.damage == ((said,) if left else ())


@pytest.mark.parametrize("damage", ["zeros", "noise", "torn", "doubled"])
def test_damage_costs_the_records_that_it_hits_and_no_others(damage: str, tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    content, each = HEAD + b"".join(ATTITUDES), len(ATTITUDES[0])
    at = len(HEAD) + 60 * each + 7
    replaced = {"zeros": bytes(100), "noise": rng.bytes(100), "torn": b"", "doubled": content[at - 50 : at + 100]}

    log = log_of(tmp_path, content[:at] + replaced[damage] + content[at + 100 :])

    got = log.tables["ATT"].columns["TimeUS"].tolist()
    assert set(STAMPS[:60]) | set(STAMPS[60 + 100 // each + 2 :]) <= set(got)
    assert set(got) <= set(STAMPS.tolist())
    assert any(text.startswith(("damaged at byte", "damaged in")) for text in log.damage)


def test_blocks_change_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rows = [flash_record(1, "Icc", t, 5, 6) + flash_record(2, "MH", 1, t) * (t % 7 == 0) for t in range(300)]
    content = OLD + b"".join(rows[:90]) + b"\xff" * 33 + b"".join(rows[90:])
    whole = log_of(tmp_path, content)
    monkeypatch.setattr("rotorfit.files.logs.autopilot_records._BLOCK", 700)

    in_blocks = log_of(tmp_path, content)

    for table, name in (("ATT", "TimeMS"), ("MODE", "ThrCrs")):
        np.testing.assert_array_equal(in_blocks.tables[table].columns[name], whole.tables[table].columns[name])
    stamps = [log.tables["MODE"].columns["log_time"] for log in (whole, in_blocks)]
    assert np.abs(stamps[0] - stamps[1]).max() <= 20e6  # anchors lie elsewhere
    assert in_blocks.notes == whole.notes


HOSTILE = {
    "too short for its fields": flash_format(2, "BAD", "QQQ", "a,b,c").replace(bytes([2, 27]), bytes([2, 9]), 1),
    "more fields than names": flash_format(2, "BAD", "QQQ", "a,b"),
    "an unknown character": flash_format(2, "BAD", "Q", "a").replace(b"Q\0", b"*\0", 1),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_a_definition_that_cannot_be_costs_its_message_only(name: str, tmp_path: Path) -> None:
    length = HOSTILE[name][4]
    records = b"\xa3\x95\x02" + bytes(length - 3)
    tracemalloc.start()

    log = log_of(tmp_path, HEAD + HOSTILE[name] + b"".join(ATTITUDES[:5]) + records * 3 + b"".join(ATTITUDES[5:]))

    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert log.skipped["BAD"] == "its definition cannot be understood (3 messages)"
    np.testing.assert_array_equal(log.tables["ATT"].columns["TimeUS"], STAMPS)
    assert peak < 64 << 20


def test_a_second_definition_of_a_type_is_ignored_and_said(tmp_path: Path) -> None:
    other = flash_format(1, "ATT", "Q", "TimeUS")

    log = log_of(tmp_path, HEAD + b"".join(ATTITUDES[:9]) + other + b"".join(ATTITUDES[9:]))

    np.testing.assert_array_equal(log.tables["ATT"].columns["TimeUS"], STAMPS)
    assert log.notes == ("later definitions of ATT differ: the first one is used",)


@settings(max_examples=150, database=None, derandomize=True)
@given(st.lists(st.tuples(st.integers(0, 3000), st.binary(max_size=12), st.integers(0, 40)), min_size=1, max_size=6))
def test_mutated_logs_are_read_to_their_end(changes: list[tuple[int, bytes, int]]) -> None:
    content = bytearray(OLD + b"".join(flash_record(1, "Icc", t, 5, 6) for t in range(150)))
    for position, new, removed in changes:
        content[position : position + removed] = new
    log = reader._Log(None)
    log.lengths[128] = len(FLASH_FMT)

    stopped = reader._step(log, bytes(content), 0, last=True)

    assert 0 <= stopped <= len(content)
    assert stopped >= len(content) - 255


def test_times_that_no_clock_shows_tell_no_place(tmp_path: Path) -> None:
    formats = flash_format(1, "ATT", "Qc", "TimeUS,Roll"), flash_format(2, "MODE", "MH", "Mode,ThrCrs")
    rows = flash_record(1, "Qc", 2**64 - 1, 0), flash_record(2, "MH", 1, 2), flash_record(1, "Qc", 5000, 0)

    mode = log_of(tmp_path, flash(*formats, rows)).tables["MODE"].columns

    assert mode["log_time"].tolist() == [5_000_000]


TEXT = """
 3

ArduCopter V3.1.3 (deadbeef)
Free RAM: 1331
FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format
FMT, 1, 13, ATT, Icc, TimeMS,Roll,Pitch
FMT, 2, 6, MODE, MH, Mode,ThrCrs
FMT, 5, 67, MSG, Z, Message
FMT, 6, 20, IMU, QBf, TimeUS,I,GyrX
FMT, 7, 44, FMTU, QBNN, TimeUS,FmtType,UnitIds,MultIds
FMT, 8, 76, UNIT, QbZ, TimeUS,Id,Label
FMT, 9, 20, MULT, Qbd, TimeUS,Id,Mult
UNIT, 0, 69, rad/s
MULT, 0, 45, 0
MULT, 0, 48, 1.0
FMT, 129, 23, PARM, Nf, Name,Value
PARM, RATE_RLL_P, 0.15
FMTU, 0, 6, s#E, F-0
"""


def text_of(rows: list[str]) -> str:
    return "\n".join([TEXT.strip("\n"), *rows, ""])


def test_the_text_of_a_log_is_read_as_the_log_itself(tmp_path: Path) -> None:
    rows = []
    for t in range(1000, 61_000, 20):
        rows += [f"ATT, {t}, {t % 300 / 100:.2f}, -0.05"] + [f"IMU, {t}000, {core}, 0.5" for core in (0, 1)]
        rows += [f"MODE, {t // 1000}, 500"] * (t % 10_000 == 0)
    rows += ["MSG, Flown, and landed", "ATT, 9", "nonsense, 3"]
    (tmp_path / "flight.log").write_text(text_of(rows))

    log = read(tmp_path / "flight.log")

    assert log.format == "dataflash_text"
    assert list(log.tables) == ["ATT", "MODE", "IMU", "IMU_1"]
    assert log.tables["ATT"].columns["Roll"][:3].tolist() == [1.0, 1.2, 1.4]
    assert len(log.tables["IMU_1"].columns["GyrX"]) == 3000
    assert log.units == {("IMU", "GyrX"): "rad/s", ("IMU_1", "GyrX"): "rad/s"}
    mode = log.tables["MODE"].columns
    np.testing.assert_allclose(mode["log_time"] / 1e9, mode["Mode"], atol=0.1)
    assert log.notes == (
        "2 torn lines left out",
        "no time in MODE: their log_time is interpolated between messages that have one",
    )
    assert list(read(tmp_path / "flight.log", {"IMU_1"}).tables) == ["IMU_1"]


@pytest.mark.parametrize(
    "row", ["IMU, 5, nan, 1", "IMU, 5, 99999999999999999999, 1", "IMU, up, 0, 1", "FMTU, 0, 99999999, #, #", "FMT, 9"]
)
def test_cells_that_cannot_be_cost_their_column_at_most(row: str, tmp_path: Path) -> None:
    rows = [f"ATT, {t}, 0.5, -0.05" for t in range(1000, 2000, 20)]
    (tmp_path / "flight.log").write_text(text_of([*rows, row, *rows, "MODE, 3, 4"]))

    log = read(tmp_path / "flight.log")

    assert len(log.tables["ATT"].columns["TimeMS"]) == 100
    assert len(log.tables["MODE"].columns["log_time"]) == 1


def test_a_real_log_is_read_whole_and_one_of_definitions_is_refused(real_flights: Path) -> None:
    log = read(real_flights / "arducopter" / "2014-10-18_20-04-24.bin")

    counts = {"ATT": 3326, "CTUN": 3326, "NTUN": 3179, "IMU": 16627, "GPS": 1664, "MODE": 6}
    assert {name: len(next(iter(log.tables[name].columns.values()))) for name in counts} == counts
    mode = log.tables["MODE"].columns
    assert mode["Mode"].tolist() == [0, 5, 0, 5, 7, 6]
    assert np.all(np.diff(mode["log_time"]) >= 0)
    attitude, navigation = (log.tables[name].columns["TimeMS"].astype(int) for name in ("ATT", "NTUN"))
    assert abs(mode["log_time"][0] / 1e6 - attitude[0]) < 1000
    assert abs(mode["log_time"][3] / 1e6 - navigation[0]) < 100  # it navigates from this mode on
    assert 0 <= log.tables["ATT"].columns["Yaw"].min() <= log.tables["ATT"].columns["Yaw"].max() <= 360
    with pytest.raises(LogError, match="defines 5 messages and holds none of them"):
        read(real_flights / "arducopter" / "format-only_600_bytes.bin")


def test_a_real_log_comes_as_pymavlink_reads_it(real_flights: Path) -> None:
    reader_of_others = pytest.importorskip("pymavlink.DFReader")
    path = real_flights / "arducopter" / "2014-10-18_20-04-24.bin"
    rows: dict[str, list[object]] = {}
    other = reader_of_others.DFReader_binary(str(path))
    while (message := other.recv_msg()) is not None and len(rows.get("ATT", ())) < 500:
        rows.setdefault(message.get_type(), []).append(message)

    log, compared = read(path), 0

    for name, messages in rows.items():
        for label, values in log.tables[name].columns.items() if name in log.tables else ():
            if label != "log_time":
                expected = [getattr(message, label) for message in messages]
                np.testing.assert_allclose(values[: len(messages)], expected, rtol=1e-12)
                compared += 1
    assert compared > 50
