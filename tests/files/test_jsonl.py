"""JSON Lines: names of nested values, what is missing, torn or hostile; a flight is that of the same log as CSV."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from files.version_0_1.numbers_of import FOLDER
from rotorfit.core.errors import LogError
from rotorfit.core.log import Log
from rotorfit.diagnosis.card_draft import draft_card
from rotorfit.files.logs import format_of, read


def log_of(folder: Path, *lines: object) -> Log:
    path = folder / "flight.jsonl"
    texts = (line if isinstance(line, str) else json.dumps(line) for line in lines)
    path.write_text("".join(f"{text}\n" for text in texts), encoding="utf-8")
    return read(path)


def test_nested_keys_are_dotted_and_elements_numbered(tmp_path: Path) -> None:
    line = {"t": 1, "pose": {"p": {"x": 1.5}, "q": [1, 0.5]}, "motors": [{"rpm": 7}, {"rpm": 8}], "none": {}, "no": []}

    log = log_of(tmp_path, line, line)

    columns = log.tables["flight"].columns
    assert log.format == "jsonl"
    assert {name: values.tolist() for name, values in columns.items()} == {
        "t": [1, 1], "pose.p.x": [1.5, 1.5], "pose.q[0]": [1, 1], "pose.q[1]": [0.5, 0.5],
        "motors[0].rpm": [7, 7], "motors[1].rpm": [8, 8],
    }  # fmt: skip
    assert columns["t"].dtype == columns["motors[0].rpm"].dtype == np.int64
    assert log.notes == ()


def test_keys_that_come_late_or_lack_null_and_nan_are_blank(tmp_path: Path) -> None:
    log = log_of(tmp_path, {"t": 0, "x": 1}, {"t": 1, "u": 0.5}, "", {"u": None, "t": 2, "x": float("nan")})

    columns = log.tables["flight"].columns
    np.testing.assert_array_equal(columns["x"], [1, np.nan, np.nan])
    np.testing.assert_array_equal(columns["u"], [np.nan, 0.5, np.nan])
    assert columns["t"].tolist() == [0, 1, 2]
    assert log.notes == ()


def test_numbers_keep_every_digit_and_may_be_mixed(tmp_path: Path) -> None:
    stamp = 1_700_000_000_123_456_789

    log = log_of(tmp_path, {"t": stamp, "x": 1, "on": True}, {"t": stamp + 1, "x": 0.1 + 0.2, "on": False})

    columns = log.tables["flight"].columns
    assert columns["t"].tolist() == [stamp, stamp + 1]
    assert columns["x"].tolist() == [1.0, 0.1 + 0.2]
    assert columns["on"].tolist() == [True, False]


def test_text_is_left_out_but_dates_and_stamps_in_two_parts_are_times(tmp_path: Path) -> None:
    lines = [
        {"at": f"2024-05-01T12:00:0{k}Z", "header": {"stamp": {"secs": k, "nsecs": 5}}, "mode": 'a, "b"\n\0\ud800'}
        for k in range(3)
    ]

    log = log_of(tmp_path, *lines)

    columns = log.tables["flight"].columns
    assert columns["at"].tolist() == [1_714_564_800_000_000_000 + k * 10**9 for k in range(3)]
    assert columns["header.stamp"].tolist() == [k * 10**9 + 5 for k in range(3)]
    assert log.notes == ("columns left out because they hold text: mode",)


def test_torn_lines_are_left_out_with_a_note(tmp_path: Path) -> None:
    log = log_of(tmp_path, {"t": 0}, '{"t": 0.5, "x', {"t": 1}, "[1, 2]", '{"t": 2}{"t": 3}', '{"t": 4')

    assert log.tables["flight"].columns["t"].tolist() == [0, 1]
    assert log.notes == ("4 torn lines left out, the first is line 2 of the file",)


def test_a_file_cut_anywhere_gives_what_is_before_the_cut(tmp_path: Path) -> None:
    log_of(tmp_path, *({"t": k / 10, "pose": {"x": -k}} for k in range(500)))
    content = (tmp_path / "flight.jsonl").read_bytes()
    for cut in np.random.default_rng(2).integers(40, len(content), 40):
        (tmp_path / "flight.jsonl").write_bytes(content[:cut])
        whole = content[: cut + 1].count(b"}}\n")

        columns = read(tmp_path / "flight.jsonl").tables["flight"].columns

        assert whole <= len(columns["t"]) <= whole + 1  # a last line that lacks only its end is whole
        np.testing.assert_array_equal(columns["pose.x"], -np.arange(len(columns["t"])))


def test_what_comes_twice_or_is_too_long_is_left_out_with_a_note(tmp_path: Path) -> None:
    log = log_of(tmp_path, '{"t": 1, "t": 2, "a.b": 3, "a": {"b": 4}}', {"t": 5, "ranges": [0] * 65})

    assert log.tables["flight"].columns["t"].tolist() == [1, 5]
    np.testing.assert_array_equal(log.tables["flight"].columns["a.b"], [3, np.nan])
    assert log.notes == (
        "columns left out because they hold lists of more than 64: ranges",
        "cells left out because an earlier one in the line has their name: t, a.b",
    )


HOSTILE = {
    "deep": ("[" * 100_000 + "]" * 100_000, r"line 2 has more than 32 levels of nesting"),
    "not so deep": ("[" * 40 + "]" * 40, r"line 2 has more than 32 levels of nesting"),
    "wide": (json.dumps({f"k{k}": k for k in range(20_000)}), r"a table of 10001 columns, more than 10000"),
    "long names": (json.dumps({"k" * 2000: 1}), r"line 2 has a name of more than 1000 characters"),
}


@pytest.mark.parametrize(("value", "told"), HOSTILE.values(), ids=HOSTILE)
def test_what_no_log_contains_is_one_line(value: str, told: str, tmp_path: Path) -> None:
    with pytest.raises(LogError, match=told) as refused:
        log_of(tmp_path, {"t": 1}, f'{{"t": 1, "x": {value}}}')
    assert "\n" not in str(refused.value)
    assert len(str(refused.value)) < 300


def test_a_new_column_in_every_line_ends_before_it_fills_the_memory(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="more than 32 million cells"):
        log_of(tmp_path, *({f"k{k % 9000}": 1} for k in range(9000)))


def test_a_number_of_five_thousand_digits_spoils_nothing(tmp_path: Path) -> None:
    log = log_of(tmp_path, {"t": 1, "x": 1}, f'{{"t": 2, "x": {"1" * 5000}}}', {"t": 3, "x": 2})

    assert log.tables["flight"].columns["t"].tolist() == [1, 2, 3]


@pytest.mark.parametrize(
    "text",
    [
        '{"format": "rotorfit-model", "version": 1}',
        '{"a": "no number"}',
        '{\n "a": 1\n}',
        "[1, 2]",
        "{1, 2}\n3, 4",
        '{"a": 1',
        "[" * 1000,
        '{"a": ' * 1000 + "1" + "}" * 1000,
        "time,x\n1,2\n",
        '"{""t"": 1}",x\n1,2\n',
    ],
)
def test_other_files_are_not_taken(text: str, tmp_path: Path) -> None:
    assert format_of(tmp_path / "a", text.encode()) != "jsonl"


def test_a_flight_is_that_of_the_same_log_as_csv(tmp_path: Path) -> None:
    sheet, lines = FOLDER / "flight.csv", tmp_path / "flight.jsonl"
    with sheet.open(newline="") as file, lines.open("w") as out:
        for row in csv.DictReader(file):
            out.write(json.dumps({name: float(cell) for name, cell in row.items() if cell}) + "\n")

    one, other = read(sheet), read(lines)

    assert draft_card(one) == draft_card(other).replace("jsonl", "csv")
    for name, values in one.tables["flight"].columns.items():
        np.testing.assert_array_equal(other.tables["flight"].columns[name], values)


def test_the_first_line_may_have_no_number(tmp_path: Path) -> None:
    path = tmp_path / "a.jsonl"
    path.write_text('{"pilot": "me"}\n' + "".join(f'{{"t": {i}}}\n' for i in range(5)))

    assert np.nan_to_num(read(path).tables["a"].columns["t"], nan=-1).tolist() == [-1, 0, 1, 2, 3, 4]
