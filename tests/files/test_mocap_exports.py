"""Exports of Motive and Vicon: what becomes of bodies, markers, units and clocks; what is left of damaged files."""

from pathlib import Path

import numpy as np
import pytest
from test_log import log_or_line

from rotorfit.core.errors import LogError
from rotorfit.core.log import Log
from rotorfit.files.cards import card_from_mapping
from rotorfit.files.logs import read
from rotorfit.flights.streams import poses_of

pytestmark = pytest.mark.flights

MOTIVE = """Format Version,1.23,Take Name,a take,Capture Frame Rate,120.000000,Export Frame Rate,120.000000,\
Capture Start Time,2019-09-18 04.30.02.695 PM,Rotation Type,Quaternion,Length Units,Meters,Coordinate Space,Global

,Type,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body Marker,\
Rigid Body Marker,Rigid Body Marker,Rigid Body Marker,Marker,Marker,Marker
,Name,drone,drone,drone,drone,drone,drone,drone,drone,"drone:Marker1","drone:Marker1","drone:Marker1",\
"drone:Marker1","drone:Marker1","drone:Marker1","drone:Marker1"
,ID,"A1","A1","A1","A1","A1","A1","A1","A1","B","B","B","B","C","C","C"

,,Rotation,Rotation,Rotation,Rotation,Position,Position,Position,Mean Marker Error,Position,Position,Position,\
Marker Quality,Position,Position,Position
Frame,Time (Seconds),X,Y,Z,W,X,Y,Z,,X,Y,Z,,X,Y,Z
72210,601.75,0.1,0.2,0.3,0.9,1,2,3,0.0001,4,5,6,0.5,7,8,9
72211,601.758333,,,,,,,,,,,,,7,8,9
72215,601.791667,0.1,0.2,0.3,0.9,1.5,2,3,0.0002,4,5,6,1,7,8,9.5
"""


def log_of(folder: Path, content: str | bytes, tables: set[str] | None = None) -> Log:
    (folder / "take.csv").write_bytes(content.encode() if isinstance(content, str) else content)
    return read(folder / "take.csv", tables)


@pytest.mark.parametrize("end", ["\n", "\r\n"])
@pytest.mark.parametrize("mark", ["", "\ufeff"])
def test_bodies_and_markers_of_motive_are_named_columns_and_what_was_hidden_is_nan(
    end: str, mark: str, tmp_path: Path
) -> None:
    log = log_of(tmp_path, mark + MOTIVE.replace("\n", end))

    columns = log.tables["take"].columns
    assert log.format == "motive"
    assert list(columns) == [
        "frame", "time", *(f"drone.rotation.{axis}" for axis in "xyzw"), *(f"drone.position.{axis}" for axis in "xyz"),
        "drone.mean_marker_error", *(f"drone:Marker1.expected_position.{axis}" for axis in "xyz"),
        "drone:Marker1.marker_quality", *(f"drone:Marker1.position.{axis}" for axis in "xyz"),
    ]  # fmt: skip
    assert columns["frame"].tolist() == [72210, 72211, 72215]
    assert columns["time"].tolist() == [601.75, 601.758333, 601.791667]
    np.testing.assert_array_equal(columns["drone.position.x"], [1, np.nan, 1.5])
    assert log.units["take", "drone.position.x"] == "m"
    assert log_of(tmp_path, MOTIVE.replace("Meters", "Millimeters")).units["take", "drone:Marker1.position.z"] == "mm"
    np.testing.assert_array_equal(columns["drone.rotation.w"], [0.9, np.nan, 0.9])
    assert log.notes == (
        "Motive captured 2019-09-18 04.30.02.695 PM, rotation Quaternion, lengths in Meters, coordinates Global, "
        "frames per second 120.000000; axes as exported (Y is up unless the export said otherwise)",
    )


def test_with_y_up_the_axes_in_a_ring_give_a_pose_with_z_up(tmp_path: Path) -> None:
    t = np.linspace(0, 2, 50)
    place, yaw = np.stack([np.cos(t), t**2, 1 + t]), 0.5 + t  # east, north, up; counter-clockwise
    columns = {
        "time": t, **dict(zip(("position.z", "position.x", "position.y"), place, strict=True)),
        "rotation.w": np.cos(yaw / 2), "rotation.x": 0 * t, "rotation.y": np.sin(yaw / 2), "rotation.z": 0 * t,
    }  # fmt: skip
    kinds, axes = zip(*(name.split(".") for name in list(columns)[1:]), strict=True)
    header = [
        "Format Version,1.23,Rotation Type,Quaternion", ",Type" + ",Rigid Body" * 7, ",Name" + ",b" * 7,
        f",,{','.join(kinds)}", f"Frame,Time (Seconds),{','.join(axes)}",
    ]  # fmt: skip
    rows = [f"{frame},{','.join(map(repr, row.tolist()))}" for frame, row in enumerate(np.stack([*columns.values()]).T)]
    pose = {"time": "time", "x": "b.position.z", "y": "b.position.x", "z": "b.position.y"}
    raw = {
        "command": {"time": "time", "x": "frame"},
        "pose": pose | {"quaternion": [f"b.rotation.{axis}" for axis in "wzxy"]},
    }

    poses = poses_of(log_of(tmp_path, "\n".join([*header, *rows, ""])), card_from_mapping(raw, "test"))

    np.testing.assert_allclose(poses.values[:, :3], place.T, atol=1e-12)
    np.testing.assert_allclose(np.unwrap(poses.values[:, 3]), yaw, atol=1e-12)


EULER = """Format Version,1.2,Rotation Type,XYZ,Length Units,Millimeters
,Type,Rigid Body,Rigid Body
,Name,b,b
,ID,1,1
,,Rotation,Error Per Marker
Frame,Time,X,
0,0,90,0.1
1,0.01,91,0.2
"""


def test_euler_angles_and_the_older_name_of_the_error_are_understood(tmp_path: Path) -> None:
    log = log_of(tmp_path, EULER)

    assert list(log.tables["take"].columns) == ["frame", "time", "b.rotation.x", "b.mean_marker_error"]
    assert "rotation XYZ, lengths in Millimeters" in log.notes[0]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (MOTIVE[:200], "the header of the Motive export cannot be understood"),
        (MOTIVE[: MOTIVE.index("72210")], "a header row and no rows below it"),
        (MOTIVE.replace(",Name,", ",Nome,"), "the header of the Motive export has no names"),
        ("Format Version,1.23\nFrame\n", "the header of the Motive export cannot be understood"),
        ("Format Version,1.23\n" * 20, "the header of the Motive export cannot be understood"),
    ],
)
def test_a_header_that_is_not_whole_is_refused_in_one_line(content: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(LogError, match=message):
        log_of(tmp_path, content)


HEAD = "Objects\n100\n"
QUATERNION = (
    HEAD + ",,Global Angle (Quaternion) drone:drone,,,,,,,Global Angle (Quaternion) wand:tip,,,,,,\n"
    "Frame,Sub Frame,RX,RY,RZ,RW,TX,TY,TZ,RX,RY,RZ,RW,TX,TY,TZ\n,,,,,,mm,mm,mm,,,,,mm,mm,mm\n"
    "101,0,0,0,0.1,0.9,1000,2000,3000,0,0,0,1,4,5,6\n102,0,0,0,0.2,0.8,1001,2001,3001,,,,,,,\n"
)


def test_objects_of_tracker_are_named_columns_with_a_clock_from_their_frames(tmp_path: Path) -> None:
    log = log_of(tmp_path, QUATERNION)

    columns = log.tables["Objects"].columns
    assert log.format == "vicon"
    assert list(columns)[:10] == [
        "time", "frame", "sub_frame", *(f"drone.rotation.{axis}" for axis in "xyzw"),
        *(f"drone.position.{axis}" for axis in "xyz"),
    ]  # fmt: skip
    assert columns["time"].tolist() == [1.01, 1.02]
    assert columns["drone.position.x"].tolist() == [1000, 1001]
    np.testing.assert_array_equal(columns["wand:tip.position.z"], [6, np.nan])
    assert log.notes == ("Objects: 100 Hz, units mm",)
    assert log.units == {
        ("Objects", f"{body}.position.{axis}"): "mm" for body in ("drone", "wand:tip") for axis in "xyz"
    }


@pytest.mark.parametrize("unit", ["rad", "deg", ""])
def test_helical_angles_come_as_recorded_and_as_a_quaternion(unit: str, tmp_path: Path) -> None:
    angle = np.array([0.0, 0.5, 3.0, 1e-9])
    axis = np.array([[0, 0, 1], [0, 0, 1], [0.6, 0, 0.8], [0, 1, 0]])
    rows = axis * angle[:, np.newaxis] * (180 / np.pi if unit == "deg" else 1)
    lines = [f"{row + 1},0,{','.join(map(repr, values.tolist()))},1,2,3" for row, values in enumerate(rows)]
    head = (
        f"{HEAD},,Global Angle drone:drone,,,,,\nFrame,Sub Frame,RX,RY,RZ,TX,TY,TZ\n,,{unit},{unit},{unit},mm,mm,mm\n"
    )

    log = log_of(tmp_path, head + "\n".join([*lines, ""]))

    columns = log.tables["Objects"].columns
    quaternion = np.stack([columns[f"drone.quaternion.{part}"] for part in "wxyz"], axis=1)
    expected = np.column_stack([np.cos(angle / 2), axis * np.sin(angle / 2)[:, np.newaxis]])
    np.testing.assert_allclose(quaternion, expected, atol=1e-15)
    np.testing.assert_array_equal(columns["drone.rotation.x"], rows[:, 0])
    assert "taken as helical" in log.notes[-1]


NEXUS = """Devices
1000
,,Plate - Force,,
Frame,Sub Frame,Fx,Fy,Fz
,,N,N,N
1,0,1,2,3
1,1,1,2,3
1,2,1,2,3
2,0,4,5,6
2,1,4,5,6
2,2,4,5,6

Trajectories
100
,,drone:a,,,drone:b,,
Frame,Sub Frame,X,Y,Z,X,Y,Z
,,mm,mm,mm,mm,mm,mm
1,0,1,2,3,,,
2,0,1,2,3,4,5,6
"""


def test_sections_of_nexus_are_tables_and_only_those_asked_for_are_decoded(tmp_path: Path) -> None:
    log = log_of(tmp_path, NEXUS)
    one = log_of(tmp_path, NEXUS, {"Trajectories"})

    assert list(log.tables) == ["Devices", "Trajectories"]
    np.testing.assert_allclose(np.diff(log.tables["Devices"].columns["time"]), 1e-3)
    assert log.tables["Devices"].columns["Plate - Force.Fz"].tolist() == [3, 3, 3, 6, 6, 6]
    assert log.tables["Trajectories"].columns["time"].tolist() == [0.01, 0.02]
    np.testing.assert_array_equal(log.tables["Trajectories"].columns["drone:b.position.y"], [np.nan, 5])
    assert list(one.tables) == ["Trajectories"]
    assert one.skipped == {"Devices": "not asked for"}


def test_a_torn_line_or_a_hole_costs_itself_only(tmp_path: Path) -> None:
    rows = [f"{frame},0,0,0,0.1,0.9,{frame},2,3,0,0,0,1,4,5,6" for frame in range(1, 40)]
    rows[20] = rows[20][:9]
    rows[30] = ""
    content = QUATERNION[: QUATERNION.index("101,")] + "\n".join(rows)

    log = log_of(tmp_path, content[:-3])

    assert log.tables["Objects"].columns["frame"].tolist() == [f for f in range(1, 39) if f not in (21, 31)]
    assert any("torn lines left out, the first is line 26" in note for note in log.notes)


@pytest.mark.parametrize("content", ["Objects\n100\n", QUATERNION[: QUATERNION.index("101,")], HEAD + "\n" * 9])
def test_an_export_without_frames_is_refused_in_one_line(content: str, tmp_path: Path) -> None:
    with pytest.raises(LogError) as caught:
        log_of(tmp_path, content)
    assert "\n" not in str(caught.value)


@pytest.mark.slow
@pytest.mark.parametrize("whole", [MOTIVE, QUATERNION, NEXUS])
def test_an_export_cut_anywhere_gives_the_frames_before_the_cut(whole: str, tmp_path: Path) -> None:
    frames = {
        "take": [72210, 72211, 72215],
        "Objects": [101, 102],
        "Devices": [1, 1, 1, 2, 2, 2],
        "Trajectories": [1, 2],
    }
    most = 0
    for cut in range(1, len(whole) + 1):
        (tmp_path / "take.csv").write_text(whole[:cut])
        log = log_or_line(tmp_path / "take.csv")
        for name, table in log.tables.items() if log else ():
            got = table.columns["frame"].tolist()
            begin = whole.index("Frame,", whole.find(name) + 1)
            assert got == frames[name][: len(got)]
            assert len(got) >= min(whole.count("\n", begin, cut) - 2, len(frames[name]))
            most = max(most, len(got))
    assert most > 1


def test_a_real_take_is_read_whole_with_its_holes(real_flights: Path) -> None:
    log = read(real_flights / "motive" / "pathviewr_motive_example_data.csv")

    (table,) = log.tables.values()
    names = ("rotation.x", "rotation.y", "rotation.z", "rotation.w")
    assert len(table.columns) == 2 + 3 * 8
    assert (table.columns["frame"][0], len(table.columns["frame"])) == (72210, 934)
    assert np.sum(np.diff(table.columns["time"]) > 1) == 4  # five pieces
    for body in ("device02", "device03", "device05"):
        quaternion = np.stack([table.columns[f"{body}.{name}"] for name in names])
        seen = np.isfinite(quaternion).all(axis=0)
        np.testing.assert_allclose(np.linalg.norm(quaternion[:, seen], axis=0), 1, atol=1e-4)
    hidden = np.isnan(table.columns["device02.position.x"])
    assert (0 < hidden.sum() < 934) or not hidden.any()
