"""Installations that cannot be written to, users without a home, other users: it works."""

import json
import os
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

from files.version_0_1.numbers_of import FOLDER
from rotorfit.core import compiled_code

SOURCE = Path(compiled_code.__file__).resolve().parents[2]
WHERE = "import os, rotorfit; print(os.environ.get('NUMBA_CACHE_DIR', ''))"


@pytest.fixture
def read_only(tmp_path: Path) -> Path:
    """A copy of the source in which no compiled code can be kept, not even by root: a file is in the way."""
    copy = tmp_path / "src"
    shutil.copytree(SOURCE, copy, ignore=shutil.ignore_patterns("__pycache__"))
    for folder, _, _ in os.walk(copy / "rotorfit"):
        (Path(folder) / "__pycache__").write_text("")
    return copy


def run(source: Path, *words: str, **environment: str) -> subprocess.CompletedProcess[str]:
    plain = {"PATH": os.environ["PATH"], "PYTHONPATH": str(source), "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, *words]
    return subprocess.run(command, env=plain | environment, capture_output=True, text=True, cwd=source.parent)


def test_code_is_kept_where_it_always_was_if_that_can_be_written(tmp_path: Path) -> None:
    assert run(SOURCE, "-c", WHERE, HOME=str(tmp_path)).stdout == "\n"


def test_an_unwritable_installation_keeps_its_code_at_home(read_only: Path, tmp_path: Path) -> None:
    assert run(read_only, "-c", WHERE, HOME=str(tmp_path)).stdout == "\n"


def test_a_folder_that_was_asked_for_is_left_as_it_is(read_only: Path) -> None:
    assert run(read_only, "-c", WHERE, HOME="/dev/null", NUMBA_CACHE_DIR="/asked/for").stdout == "/asked/for\n"


def test_without_a_home_the_users_own_temporary_folder_is_used_again(read_only: Path, tmp_path: Path) -> None:
    found = {run(read_only, "-c", WHERE, HOME="/dev/null", TMPDIR=str(tmp_path)).stdout.strip() for _ in range(2)}

    (kept,) = map(Path, found)
    assert kept.parent == tmp_path
    assert kept.stat().st_mode & 0o077 == 0


def test_a_folder_that_others_can_write_to_is_not_trusted(read_only: Path, tmp_path: Path) -> None:
    planted = tmp_path / f"rotorfit-compiled-{os.getuid()}"
    planted.mkdir()
    planted.chmod(0o777)

    kept = run(read_only, "-c", WHERE, HOME="/dev/null", TMPDIR=str(tmp_path)).stdout.strip()

    assert Path(kept).parent == tmp_path
    assert Path(kept) != planted


def info(source: Path, **environment: str) -> dict[str, object]:
    words = ("-m", "rotorfit", "info", str(FOLDER / "flight.csv"), "--card", str(FOLDER / "card.toml"), "--json")
    done = run(source, *words, **environment)
    assert (done.returncode, done.stderr) == (0, "")
    told: dict[str, object] = json.loads(done.stdout)
    return told


@pytest.mark.slow
def test_a_log_is_looked_through_without_a_home_in_an_installation_that_cannot_be_written(
    read_only: Path, tmp_path: Path
) -> None:
    assert info(read_only, HOME="/dev/null", TMPDIR=str(tmp_path))["logs"]


@pytest.mark.slow
def test_a_flight_is_fitted_without_a_home_in_an_installation_that_cannot_be_written(
    read_only: Path, tmp_path: Path
) -> None:
    words = ("fit", str(FOLDER / "flight.csv"), "--card", str(FOLDER / "card.toml"), "--axes", "z", "-o", "model.json")

    done = run(read_only, "-m", "rotorfit", *words, HOME="/dev/null", TMPDIR=str(tmp_path))

    assert done.returncode == 0, done.stderr
    assert (read_only.parent / "model.json").is_file()


@pytest.mark.skipif(os.getuid() != 0, reason="only root can become somebody else")
def test_another_user_runs_it() -> None:
    packages = sysconfig.get_path("purelib")
    plain = {"PATH": os.environ["PATH"], "PYTHONPATH": f"{SOURCE}:{packages}", "TMPDIR": "/tmp"}
    system = f"/usr/bin/python{sys.version_info.major}.{sys.version_info.minor}"  # where root alone has this Python
    for python in filter(os.path.exists, (sys.executable, system)):
        command = [python, "-m", "rotorfit", "formats"]
        try:
            done = subprocess.run(command, env=plain, user="nobody", cwd="/", capture_output=True, text=True)
        except PermissionError:
            continue
        assert done.returncode == 0, done.stderr
        assert "rosbag1" in done.stdout
        return
    pytest.skip("no Python of this version is within reach of other users")
