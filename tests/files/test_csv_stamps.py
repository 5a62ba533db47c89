"""CSV files as other tools write them: dates, stamps in two columns, comments above the names."""

import tomllib
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path

import numpy as np
import pytest

from rotorfit.core.card import Channel
from rotorfit.core.errors import CardError
from rotorfit.core.log import Log, Table
from rotorfit.files.cards import card_from_mapping
from rotorfit.files.logs import read
from rotorfit.flights.assemble import flight_from_log
from rotorfit.flights.stamps import MISSING_STAMP, stamps_of

START = datetime(2024, 5, 1, 12, tzinfo=UTC)
STEPS = [START + timedelta(milliseconds=50 * k) for k in range(40)]
NANOSECONDS = [round(START.timestamp()) * 10**9 + 50_000_000 * k for k in range(40)]


def table_of(folder: Path, head: str, rows: list[str]) -> Table:
    path = folder / "flight.csv"
    path.write_text("\n".join([head, *rows, ""]))
    return read(path).tables["flight"]


@pytest.mark.parametrize(
    ("zone", "form"),
    [
        *(
            (UTC, form)
            for form in (
                "%Y-%m-%dT%H:%M:%S.%fZ",
                "%Y-%m-%d %H:%M:%S.%f",
                "%Y/%m/%d %H:%M:%S.%f",
                "%d.%m.%Y %H:%M:%S.%f",
            )
        ),
        (timezone(timedelta(hours=-3, minutes=-30)), ""),
    ],
)
def test_dates_are_nanoseconds_since_1970(zone: timezone, form: str, tmp_path: Path) -> None:
    here = [step.astimezone(zone) for step in STEPS]
    dates = [step.strftime(form) if form else step.isoformat(timespec="milliseconds") for step in here]

    table = table_of(tmp_path, "time,x", [f"{date},{k}" for k, date in enumerate(dates)])

    assert table.columns["time"].tolist() == NANOSECONDS


@pytest.mark.parametrize("form", ["%d.%m.%Y %H:%M:%S,%f", "%d.%m.%Y %H:%M:%S.%f", "%Y-%m-%d %H:%M:%S,%f"])
@pytest.mark.parametrize("mark", [",", "."])
def test_dates_hinder_no_decimal_commas_and_may_have_one(form: str, mark: str, tmp_path: Path) -> None:
    rows = [f"{step.strftime(form)};{k}{mark}5" for k, step in enumerate(STEPS)]

    table = table_of(tmp_path, "time;x", rows)

    assert table.columns["time"].tolist() == NANOSECONDS
    np.testing.assert_array_equal(table.columns["x"], np.arange(40) + 0.5)


def test_times_of_day_are_nanoseconds_since_midnight(tmp_path: Path) -> None:
    table = table_of(tmp_path, "time,x", [f"{step:%H:%M:%S.%f},1.5" for step in STEPS])

    assert table.columns["time"].tolist() == [each - NANOSECONDS[0] + 12 * 3600 * 10**9 for each in NANOSECONDS]


def test_stamps_in_two_columns_come_as_one_where_poses_and_commands_have_rows_of_their_own(tmp_path: Path) -> None:
    parts = [(str(stamp // 10**9), str(stamp % 10**9), str(k)) for k, stamp in enumerate(NANOSECONDS)]
    rows = [",".join([*part, "", "", ""] if k % 2 else ["", "", "", *part]) for k, part in enumerate(parts)]
    table = table_of(
        tmp_path, "pose.stamp.sec,pose.stamp.nanosec,x,cmd.header.stamp.secs,cmd.header.stamp.nsecs,u", rows
    )

    stamps = table.columns["cmd.header.stamp"]
    assert np.isnan(stamps[1::2]).all()
    np.testing.assert_allclose(stamps[::2], NANOSECONDS[::2], rtol=0, atol=256)
    np.testing.assert_allclose(table.columns["pose.stamp"][1::2], NANOSECONDS[1::2], rtol=0, atol=256)
    log = Log(tmp_path / "a.csv", "csv", "", {"flight": table}, {})
    assert np.sum(stamps_of(log, Channel("cmd.header.stamp")) == np.nan_to_num(stamps).astype(np.int64)) == 20


@pytest.mark.parametrize("names", ["header.stamp.secs,header.stamp.nsecs", "header.stamp.sec,header.stamp.nanosec"])
def test_stamps_in_two_columns_come_as_one_besides(names: str, tmp_path: Path) -> None:
    rows = [f"{stamp // 10**9},{stamp % 10**9},{k}" for k, stamp in enumerate(NANOSECONDS)]

    table = table_of(tmp_path, f"{names},x", rows)

    assert list(table.columns) == ["header.stamp", *names.split(","), "x"]
    assert table.columns["header.stamp"].tolist() == NANOSECONDS


@pytest.mark.parametrize("place", [3, 30, 1500])
@pytest.mark.parametrize("form", ["nanoseconds", "dates"])
def test_a_cell_of_text_among_stamps_that_no_float_holds_costs_its_row(form: str, place: int, tmp_path: Path) -> None:
    stamps = [NANOSECONDS[0] + 1 + 50_000_000 * k for k in range(2000)]
    cells = [str(stamp) for stamp in stamps]
    if form == "dates":
        cells = [f"{START + timedelta(milliseconds=50 * k):%Y-%m-%d %H:%M:%S.%f}001" for k in range(2000)]
    cells[place] = "ERR"

    table = table_of(tmp_path, "time,n", [f"{cell},{k}" for k, cell in enumerate(cells)])

    del stamps[place]
    assert table.columns["time"].tolist() == stamps
    assert table.columns["n"].tolist() == [k for k in range(2000) if k != place]
    log = read(tmp_path / "flight.csv")
    assert log.notes == ("1 of 2000 cells of time hold text, as 'ERR': their rows are left out",)
    assert stamps_of(log, Channel("time")).tolist() == stamps


@pytest.mark.parametrize("cell", ["ERR", ""])
def test_a_cell_without_a_number_makes_no_seconds_of_nanoseconds_since_boot(cell: str, tmp_path: Path) -> None:
    cells = [str(50_000_000 * k) for k in range(40)]
    cells[7] = cell

    table_of(tmp_path, "header.stamp,n", [f"{cell},{k}" for k, cell in enumerate(cells)])

    stamps = stamps_of(read(tmp_path / "flight.csv"), Channel("header.stamp"))
    assert np.flatnonzero(stamps == MISSING_STAMP).tolist() == [7]
    assert np.delete(stamps, 7).tolist() == [50_000_000 * k for k in range(40) if k != 7]


@pytest.mark.parametrize("head", ["# by me\n# lab\ntime,x", "% by me\ntime,x", "# lab, 3\n# time,x", "\n\n#time,x"])
def test_comments_above_the_names_are_passed_over_and_names_in_a_comment_are_names(head: str, tmp_path: Path) -> None:
    table = table_of(tmp_path, head, [f"{k / 20},{k}" for k in range(40)])

    assert list(table.columns) == ["time", "x"]
    np.testing.assert_array_equal(table.columns["x"], np.arange(40))


ROWS = [f"{k / 8};{k};{-k}" for k in range(40)]


@pytest.mark.parametrize(
    ("row", "units", "rest"),
    [
        ("s;m;", {"time": "s", "x": "m"}, ""),
        ("[ms];[mm];[-]", {"time": "ms", "x": "mm"}, ""),
        ("usec;degrees;deg/sec", {"time": "us", "x": "deg", "y": "deg/s"}, ""),
        ("(\N{MICRO SIGN}s);\N{DEGREE SIGN};\N{DEGREE SIGN}/s", {"time": "us", "x": "deg", "y": "deg/s"}, ""),
        ("a;ft;m", {"y": "m"}, "; not used: a, ft"),
        ("s;1;mm", {"time": "s", "y": "mm"}, "; not used: 1"),
    ],
)
def test_a_row_below_the_names_states_units(row: str, units: dict, rest: str, tmp_path: Path) -> None:
    table = table_of(tmp_path, f"time;x;y\n{row}", ROWS)
    log = read(tmp_path / "flight.csv")

    assert table.columns["y"].tolist() == [-k for k in range(40)]
    assert log.units == {("flight", name): unit for name, unit in units.items()}
    assert log.notes == (
        f"units by the row below the names: {', '.join(f'{name} {unit}' for name, unit in units.items())}{rest}",
    )


@pytest.mark.parametrize("blank", [0, 3])
def test_dates_are_nanoseconds_whatever_unit_is_stated(blank: int, tmp_path: Path) -> None:
    table_of(tmp_path, "time,x\ns,m", [",1.5"] * blank + [f"{step:%H:%M:%S.%f},1.5" for step in STEPS])

    assert read(tmp_path / "flight.csv").units == {("flight", "x"): "m"}


def test_a_stated_unit_in_which_no_clock_counts_is_to_be_corrected_in_the_file(tmp_path: Path) -> None:
    table_of(tmp_path, "time,x\ns,m", [f"{stamp},1.5" for stamp in NANOSECONDS])

    with pytest.raises(CardError, match=r'correct the unit that the file states, to "ns", which would be 1.71e\+09 s'):
        stamps_of(read(tmp_path / "flight.csv"), Channel("time", unit="s"))


UNITED = """[command]
time = "t"
x = "u"
[pose]
time = "t"
x = "x"
y = "y"
z = "z"
yaw = "yaw"
"""


@pytest.mark.parametrize("apart", [False, True])
@pytest.mark.parametrize("given", ["", 'unit = "us"'])
def test_stated_units_stand_over_those_of_the_card(given: str, apart: bool, tmp_path: Path) -> None:
    k = np.arange(400)
    moved = {"x": 2000 + 500 * np.sin(k / 20), "y": 10 * np.cos(k / 20), "z": 1 + 0 * k, "yaw": 10 * np.sin(k / 30)}
    units = {"x": "mm", "y": "cm", "z": "m", "yaw": "deg"}
    pose = {"t": ("ms", 50 * k), **{name: (unit, moved[name]) for name, unit in units.items()}}
    command = {"t": ("ms", 50 * k), "u": ("", np.sin(k / 20))}
    for name, columns in {"c": command, "p": pose}.items() if apart else {"c": command | pose}.items():
        rows = zip(*(values.tolist() for _, values in columns.values()), strict=True)
        head = [",".join(columns), ",".join(unit for unit, _ in columns.values())]
        (tmp_path / f"{name}.csv").write_text("\n".join([*head, *(",".join(map(str, row)) for row in rows), ""]))
    log = read("+".join(str(tmp_path / f"{name}.csv") for name in ("cp" if apart else "c")))
    text = UNITED.replace('time = "t"', f'time = {{ from = "t", {given} }}') if given else UNITED
    card = card_from_mapping(tomllib.loads("clock = 'one'\n" + text), "test")

    flight = flight_from_log(log, card)

    assert flight.duration == pytest.approx(19.95)
    assert np.ptp(flight.position[:, 0]) == pytest.approx(1, abs=0.01)
    assert np.ptp(flight.position[:, 1]) == pytest.approx(0.2, abs=0.01)
    assert np.ptp(flight.yaw) == pytest.approx(np.radians(20), abs=0.01)
    (note,) = (note.text for note in flight.notes if note.code == "units")
    assert ("t is in ms, not in us" in note) == bool(given)
    assert "x is in mm, not in SI" in note


@pytest.mark.parametrize(("above", "end"), [("sep=;\r\n", "\r\n"), ("", "\r"), ("# a log\r", "\r")])
def test_a_spreadsheets_first_line_and_line_ends_are_understood(above: str, end: str, tmp_path: Path) -> None:
    path = tmp_path / "flight.csv"
    path.write_bytes((above + end.join(["time;x;y", *ROWS, ""])).encode())

    log = read(path)

    assert log.tables["flight"].columns["time"].tolist() == [k / 8 for k in range(40)]
    assert log.notes == ()


def test_dates_of_another_form_are_told_as_such(tmp_path: Path) -> None:
    table_of(tmp_path, "time,x,mode", [f"05/01/2024 10:00:{k:02d},{k},up" for k in range(40)])

    assert read(tmp_path / "flight.csv").notes == (
        "columns left out because they hold text: mode",
        "columns left out because their dates are not as 2024-05-01 12:00:00.050: time",
    )
