"""Nothing is lost: a full disk, a kill and a shorter result leave the earlier file whole."""

import errno
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import CliRunner

import rotorfit as rf
from models import VEHICLE, model_of
from rotorfit.app.cli import main
from rotorfit.core.errors import LogError
from rotorfit.core.model import Model
from rotorfit.core.writing import check_place, write_whole
from rotorfit.exports import export
from rotorfit.exports.gains import save_gains
from rotorfit.files.models import load, save


def only_z() -> Model:
    return model_of({"z": VEHICLE["z"]})


def test_a_file_is_replaced_and_the_earlier_one_kept(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"

    assert write_whole(path, "one") is None
    assert write_whole(path, "one") is None
    assert write_whole(path, "two") == tmp_path / "a.txt~"
    assert write_whole(path, "three") == tmp_path / "a.txt~"

    assert [path.read_text(), (tmp_path / "a.txt~").read_text()] == ["three", "two"]
    assert sorted(one.name for one in tmp_path.iterdir()) == ["a.txt", "a.txt~"]
    assert write_whole(path, "four", keep=False) is None
    assert (tmp_path / "a.txt~").read_text() == "two"


def test_rights_and_links_stay(tmp_path: Path) -> None:
    path, link = tmp_path / "a.txt", tmp_path / "link"
    write_whole(path, "one")
    mask = os.umask(0)
    os.umask(mask)
    assert path.stat().st_mode & 0o777 == 0o666 & ~mask
    path.chmod(0o640)
    link.symlink_to(path)
    write_whole(link, "two")

    assert link.is_symlink()
    assert path.read_text() == "two"
    assert path.stat().st_mode & 0o777 == 0o640
    write_whole("/dev/null", "three")
    assert Path("/dev/null").is_char_device()


WRITERS: dict[str, Callable[[Path], object]] = {
    "model": lambda path: save(only_z(), path),
    "gains.toml": lambda path: save_gains(rf.tune(model_of(), axes=("z",), draws=20), model_of(), path),
    "gains.yaml": lambda path: save_gains(rf.tune(model_of(), axes=("z",), draws=20), model_of(), path),
    "export.h": lambda path: export(model_of(), "c", path),
}


def test_a_place_that_takes_no_file_is_told_beforehand_and_nothing_is_left_there(tmp_path: Path) -> None:
    check_place(tmp_path / "model.json")
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(LogError, match="there is no folder"):
        check_place(tmp_path / "none" / "model.json")
    with pytest.raises(LogError, match="cannot be written"):
        check_place(Path("/proc/model.json"))
    with pytest.raises(LogError, match="is a folder; name a file in it"):
        save(only_z(), tmp_path)


@pytest.mark.parametrize("fails", ["fsync", "replace"])
@pytest.mark.parametrize("kind", WRITERS)
def test_a_full_disk_leaves_what_was_there(
    kind: str, fails: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / (kind if "." in kind else f"{kind}.json")
    path.write_text("what was there", encoding="utf-8")

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(*(("os.fsync", full) if fails == "fsync" else (Path, "replace", full)))  # type: ignore[arg-type]
    with pytest.raises(OSError, match="No space left on device") as told:
        WRITERS[kind](path)

    assert told.value.filename == str(path)
    assert path.read_text(encoding="utf-8") == "what was there"
    assert [one.name for one in tmp_path.iterdir()] == [path.name]


KILLED = """
import sys
from rotorfit.core.writing import write_whole
print("ready", flush=True)
for n in range(10**9):
    write_whole(sys.argv[1], f"{n:07d}" * 200_000)
    print(n, flush=True)
"""


def test_a_kill_at_any_moment_leaves_the_old_file_or_the_new_one(tmp_path: Path) -> None:
    path = tmp_path / "file"
    for number in range(12):
        process = subprocess.Popen(
            [sys.executable, "-c", KILLED, str(path)], stdout=subprocess.PIPE, text=True
        )  # fmt: skip
        assert process.stdout
        process.stdout.readline()
        time.sleep(0.013 * number)
        process.send_signal(signal.SIGKILL)
        acknowledged = [int(line) for line in process.stdout if line.endswith("\n")]
        process.wait()
        process.stdout.close()
        for file in (path, tmp_path / "file~"):
            if file.exists():
                text = file.read_text()
                assert len(text) == 1_400_000
                assert text == text[:7] * 200_000
        if acknowledged:
            assert int(path.read_text()[:7]) >= acknowledged[-1]


def test_after_a_kill_between_two_renames_the_kept_file_is_a_file_of_its_own(tmp_path: Path) -> None:
    path, kept = tmp_path / "file", tmp_path / "file~"
    path.write_text("first")
    kept.hardlink_to(path)  # what such a kill leaves
    write_whole(path, "second")
    write_whole(path, "third")

    assert path.read_text() == "third"
    assert kept.read_text() == "second"
    assert sorted(one.name for one in tmp_path.iterdir()) == ["file", "file~"]


def test_a_model_of_fewer_axes_says_what_it_replaces(tmp_path: Path) -> None:
    path, whole, other = tmp_path / "model.json", tmp_path / "whole.json", tmp_path / "z.json"
    save(model_of(), whole)
    save(only_z(), other)
    rf.save(model_of(), path)

    with pytest.warns(UserWarning, match=r"the earlier model knew x, y, yaw, too; it is kept as .*model\.json~"):
        rf.save(only_z(), path)
    assert rf.load(f"{path}~").axes["x"].predictor

    run = CliRunner().invoke(main, ["convert", str(other), "--limits", "vertical_speed=2", "-o", str(whole)])
    assert run.exit_code == 0, run.output
    assert run.stderr == f"Note: the earlier whole.json, which knew x, y, yaw, too, is kept as {whole}~.\n"
    assert load(tmp_path / "whole.json~").axes["x"].predictor


def test_a_pipe_without_a_name_is_written_directly() -> None:
    reading, writing = os.pipe()
    assert write_whole(f"/dev/fd/{writing}", "all of it") is None
    os.close(writing)
    with os.fdopen(reading) as pipe:
        assert pipe.read() == "all of it"
