import errno
import io
import struct
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from test_sources import mcap_record, text

from flying import CARD, SECOND
from rotorfit.app.terminal.contents import survey_view
from rotorfit.app.workflows import load_flight
from rotorfit.core.errors import CardError, LogError
from rotorfit.core.log import Event, Sample
from rotorfit.diagnosis.card_choice import card_of
from rotorfit.diagnosis.survey import survey_logs
from rotorfit.files.cards import card_from_mapping
from rotorfit.files.log_span import LogSpan
from rotorfit.files.logs import read
from rotorfit.flying.recorder import COMMAND, POSE, Recorder, card_as_recorded, record
from rotorfit.version import __version__

pytestmark = pytest.mark.flights

numbers = st.floats(allow_nan=False, width=64)


def filled(path: Path, count: int = 500, attached: dict[str, str] | None = None) -> Path:
    import tomli_w

    told = {"plan": 'name = "sines"\n', "card": tomli_w.dumps(card_as_recorded(CARD.raw)), "link": "sim"}
    recorder = record(path, told if attached is None else attached)
    rng = np.random.default_rng(3)
    recorder.window(0, False)
    recorder.event(5, "plan begins")
    recorder.window(10, True)
    for k in range(count):
        t = (k + 1) * SECOND // 50
        recorder.command(t, tuple(0.1 * rng.standard_normal(4)))
        recorder.sample(Sample("pose", t - 9_000_000, t + 1, (*rng.standard_normal(3), 1.0, 0.0, 0.0, 0.1)))
        recorder.sample(Sample("velocity", t, t, tuple(rng.standard_normal(4))))
    recorder.sample(Sample("battery", 1, t, (0.75,)))
    recorder.event(t, "end: completed")
    recorder.close()
    return path


@given(st.lists(st.tuples(st.integers(0, 2**60), st.tuples(*[numbers] * 11)), min_size=1, max_size=20))
def test_commands_and_poses_come_back_bit_for_bit(rows: list[tuple[int, tuple[float, ...]]]) -> None:
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.mcap"
        recorder = record(path, {})
        for stamp, values in rows:
            recorder.command(stamp, values[:4])
            recorder.sample(Sample("pose", stamp - 7 * SECOND, stamp, values[4:]))
        recorder.close()
        log = read(path)

    command, pose = log.tables[COMMAND].columns, log.tables[POSE].columns
    values = np.array([row for _, row in rows])
    for k, name in enumerate(("linear.x", "linear.y", "linear.z", "angular.z")):
        assert command[f"twist.{name}"].tobytes() == values[:, k].tobytes()
    for k, name in enumerate([*(f"position.{a}" for a in "xyz"), *(f"orientation.{a}" for a in "wxyz")]):
        assert pose[f"pose.{name}"].tobytes() == values[:, 4 + k].tobytes()
    assert command["log_time"].tolist() == command["header.stamp"].tolist() == [stamp for stamp, _ in rows]
    assert pose["header.stamp"].tolist() == [stamp - 7 * SECOND for stamp, _ in rows]


def test_other_readers_of_mcap_read_it_too(tmp_path: Path) -> None:
    with filled(tmp_path / "log.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.message_count == 500 * 3 + 5
        (metadata,) = reader.iter_metadata()
    assert metadata.name == "rotorfit"
    assert metadata.metadata["rotorfit"] == __version__


def test_rosbags_decodes_its_messages_by_the_definitions_in_it(tmp_path: Path) -> None:
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    path = filled(tmp_path / "log.mcap", 3)
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            assert schema is not None
            store = get_typestore(Stores.EMPTY)
            store.register(get_types_from_msg(schema.data.decode(), schema.name))
            decoded = store.deserialize_cdr(message.data, schema.name)
            if channel.topic == COMMAND:
                assert decoded.header.frame_id == "heading"
                assert decoded.twist.linear.x != 0
            elif channel.topic == "/rotorfit/event":
                assert decoded.data in ("plan begins", "end: completed")


def test_plan_card_link_version_and_events_come_back_and_the_card_is_used(tmp_path: Path) -> None:
    path = filled(tmp_path / "log.mcap")
    log = read(path)

    assert log.attached["plan"] == 'name = "sines"\n'
    assert log.attached["link"] == "sim"
    assert log.events == (Event(5, "plan begins"), Event(10 * SECOND, "end: completed"))
    assert card_of(log).limits == CARD.limits
    flight = load_flight(LogSpan(str(path), (None, None)))
    assert flight.card.command["x"].full_scale == "tilt"
    assert flight.command_time.size == 499  # the last one acts beyond the last pose
    other = card_from_mapping({**card_as_recorded(CARD.raw), "name": "another"}, "another")
    assert load_flight(LogSpan(str(path), (None, None)), other).card.name == "another"


def test_info_shows_what_is_attached_and_what_happened(tmp_path: Path) -> None:
    from rich.console import Console

    (survey,) = survey_logs([str(filled(tmp_path / "log.mcap"))])
    assert survey.recording == {"plan": "sines", "link": "sim", "rotorfit": __version__}
    assert survey.events == ((pytest.approx(0.0, abs=1e-6), "plan begins"), (pytest.approx(10.0), "end: completed"))
    console = Console(width=200, file=io.StringIO())
    for part in survey_view(survey):
        console.print(part)
    shown = cast("io.StringIO", console.file).getvalue()
    assert f"plan sines, link sim, rotorfit {__version__}" in shown
    assert "10.00 s: end: completed" in shown


def test_a_file_that_exists_is_never_written_over(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    path.write_text("mine")

    with pytest.raises(LogError, match="exists, and a recording is never overwritten"):
        record(path, {})
    assert path.read_text() == "mine"
    with pytest.raises(LogError, match=r"cannot be written \(No such file or directory\)"):
        record(tmp_path / "nowhere" / "log.mcap", {})


def test_what_is_written_is_on_the_disk_within_a_quarter_of_a_second(tmp_path: Path) -> None:
    recorder = record(tmp_path / "log.mcap", {})
    recorder.command(1, (0.1, 0.2, 0.3, 0.4))
    time.sleep(0.25)

    log = read(tmp_path / "log.mcap")
    assert log.tables[COMMAND].columns["twist.linear.y"].tolist() == [0.2]
    assert log.damage == ("the file was never closed: what was recorded behind its end is lost",)
    recorder.close()


@given(cut=st.floats(0, 1))
def test_a_recording_cut_anywhere_is_read_up_to_there(tmp_path_factory: pytest.TempPathFactory, cut: float) -> None:
    folder = tmp_path_factory.getbasetemp()
    whole = folder / "whole.mcap"
    content = (whole if whole.exists() else filled(whole, 20)).read_bytes()
    part = folder / "part.mcap"
    part.write_bytes(content[: round(cut * len(content))])

    try:
        log = read(part)
    except LogError:  # nothing is left
        assert cut < 0.5
        return
    full = read(whole).tables
    for name, table in log.tables.items():
        count = len(table.columns["log_time"])
        for column, values in table.columns.items():
            assert values.tobytes() == full[name].columns[column][:count].tobytes()


DAMAGED = {
    "a name that is cut": struct.pack("<I", 99) + b"rotorfit",
    "no map": text("rotorfit"),
    "a map that is cut": text("rotorfit") + struct.pack("<I", 9999) + text("plan"),
    "a value that is cut": text("rotorfit") + struct.pack("<I", 8) + text("plan"),
    "nothing": b"",
}


@pytest.mark.parametrize("damaged", DAMAGED.values(), ids=DAMAGED.keys())
def test_damaged_metadata_is_a_note_and_costs_nothing_else(tmp_path: Path, damaged: bytes) -> None:
    content = filled(tmp_path / "log.mcap", attached={}).read_bytes()
    head = (
        content.index(b"rotorfit\x19") if b"rotorfit\x19" in content else 8 + 9 + struct.unpack("<Q", content[9:17])[0]
    )
    path = tmp_path / "damaged.mcap"
    path.write_bytes(content[:head] + mcap_record(0x0C, damaged) + content[head:])

    log = read(path)
    assert len(log.tables[COMMAND].columns["log_time"]) == 500
    assert len(log.notes) == 1
    assert log.notes[0].startswith("what is attached is damaged (a record is cut short)")


def test_metadata_of_others_is_left_alone(tmp_path: Path) -> None:
    content = filled(tmp_path / "log.mcap", 5, attached={}).read_bytes()
    head = 8 + 9 + struct.unpack("<Q", content[9:17])[0]
    path = tmp_path / "other.mcap"
    path.write_bytes(content[:head] + mcap_record(0x0C, text("rosbag2"), b"anything") + content[head:])

    assert read(path).attached == {"rotorfit": __version__}
    assert read(path).notes == ()


def test_an_attached_card_or_plan_that_is_no_toml_is_said_in_one_line(tmp_path: Path) -> None:
    path = filled(tmp_path / "log.mcap", attached={"card": "x = [", "plan": "=", "link": "sim"})

    with pytest.raises(CardError, match=r"the card in it is damaged .*; name one with `--card`"):
        load_flight(LogSpan(str(path), (None, None)))
    (survey,) = survey_logs([str(path)])
    assert survey.problem is not None
    assert survey.recording["plan"].startswith("damaged: ")


def test_poses_may_be_timed_by_their_arrival() -> None:
    card = card_from_mapping(card_as_recorded(CARD.raw, "log_time"), "as recorded")
    assert card.pose_time.source == "/rotorfit/pose:log_time"
    assert card.command == card_from_mapping(card_as_recorded(CARD.raw), "as recorded").command
    off = card_from_mapping(card_as_recorded(CARD.raw, "log_time", "header.stamp", 0.03, 0.02), "as recorded")
    assert (off.pose_time.error, off.command_time.error) == (0.03, 0.02)
    si = {
        **CARD.raw,
        "command": {**CARD.raw["command"], "x": {"from": "a:b", "scale": -1, "unit": "deg", "meaning": "tilt"}},
    }
    assert card_as_recorded(si)["command"]["x"] == {"from": "/rotorfit/command:twist.linear.x", "meaning": "tilt"}


class FullDisk:
    """A file that takes so many bytes and no more."""

    def __init__(self, path: Path, room: int) -> None:
        self.file, self.room = path.open("xb", buffering=0), room

    def write(self, data: bytes) -> int:
        if not self.room:
            raise OSError(errno.ENOSPC, "No space left on device")
        count = self.file.write(data[: self.room])
        self.room -= count
        return count

    def __enter__(self) -> "FullDisk":
        return self

    def __exit__(self, *_: object) -> None:
        self.file.close()


def test_a_full_disk_is_told_and_what_was_written_is_readable(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    recorder = Recorder(FullDisk(path, 5000), path, {})  # type: ignore[arg-type]
    for k in range(100):
        recorder.command(k, (0.1, 0.2, 0.3, 0.4))
    deadline = time.monotonic() + 5
    while not recorder.fault and time.monotonic() < deadline:
        time.sleep(0.01)
        recorder.command(100, (0.1, 0.2, 0.3, 0.4))
    assert (
        recorder.fault == f"{path}: No space left on device; free some room on the disk; what was written is readable"
    )
    recorder.close()
    assert 5 < len(read(path).tables[COMMAND].columns["log_time"]) < 100


def test_a_disk_that_hangs_is_noticed_and_stops_nobody(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rotorfit.flying.recorder.STALLED", 0.3)
    release = threading.Event()

    class Hanging(FullDisk):
        def write(self, data: bytes) -> int:
            release.wait(10)
            return super().write(data)

    path = tmp_path / "log.mcap"
    recorder = Recorder(Hanging(path, 10**9), path, {})  # type: ignore[arg-type]
    began = time.monotonic()
    while not recorder.stalled() and time.monotonic() < began + 5:
        recorder.command(1, (0.1, 0.2, 0.3, 0.4))
        time.sleep(0.01)
    assert recorder.stalled()
    recorder.close()
    assert "the disk has taken nothing for 0.3 s" in recorder.fault
    release.set()


def test_samples_keep_both_clocks(tmp_path: Path) -> None:
    sample = Sample("velocity", 3 * SECOND, 5 * SECOND, (1.0, 2.0, 3.0, 4.0))
    recorder = record(tmp_path / "log.mcap", {})
    recorder.sample(sample)
    recorder.sample(replace(sample, stamp=-SECOND))
    recorder.close()

    columns = read(tmp_path / "log.mcap").tables["/rotorfit/velocity"].columns
    assert columns["header.stamp"].tolist() == [3 * SECOND, -SECOND]
    assert columns["log_time"].tolist() == [5 * SECOND] * 2
    assert columns["twist.angular.z"].tolist() == [4.0] * 2
