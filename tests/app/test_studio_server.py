"""The studio starts on the loopback interface only, says what it lacks in one line, and ends when it is told to."""

import json
import signal
import socket
import subprocess
import sys
from pathlib import Path
from urllib.parse import parse_qs, urlsplit

import pytest
from click.testing import CliRunner

import rotorfit
from rotorfit.app.cli import main


@pytest.mark.parametrize("package", ["starlette", "uvicorn"])
def test_a_missing_package_is_one_line_that_says_how_to_install_it(
    package: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, package, None)

    result = CliRunner().invoke(main, ["studio", str(tmp_path / "workspace")])

    assert result.exit_code == 1
    assert result.stderr == f"Error: {package} is not installed; install it with: pip install 'rotorfit[studio]'\n"
    assert list(tmp_path.iterdir()) == []


def test_a_port_that_is_taken_is_one_line(tmp_path: Path) -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        with pytest.raises(rotorfit.RotorfitError, match=rf"^port {port}: .*--port"):
            rotorfit.studio(tmp_path / "workspace", port)


def test_it_listens_on_the_loopback_only_with_a_new_key_each_time_and_keeps_its_folder_private(tmp_path: Path) -> None:
    keys = set()
    for _ in range(2):
        command = [sys.executable, "-m", "rotorfit", "studio", str(tmp_path / "workspace"), "--json"]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None
            said = ""
            while not said.rstrip().endswith("}"):
                said += process.stdout.readline()
            address = urlsplit(json.loads(said)["address"])
            keys |= set(parse_qs(address.query)["token"])
            assert address.hostname == "127.0.0.1"
            socket.create_connection(("127.0.0.1", address.port or 0), timeout=5).close()
            with pytest.raises(ConnectionRefusedError):  # what listens everywhere would answer here, too
                socket.create_connection(("127.0.0.2", address.port or 0), timeout=5)
            process.send_signal(signal.SIGINT)
            assert process.wait(20) == 0
    assert len(keys) == 2
    assert min(map(len, keys)) >= 43
    assert (tmp_path / "workspace").stat().st_mode & 0o077 == 0
