"""The Foxglove server as a client of the protocol sees it: Foxglove and PlotJuggler read these channels.

Source: github.com/foxglove/ws-protocol, docs/spec.md: frames of opcode 1 are JSON, of opcode 2 binary; message data is
0x01, the subscription (uint32), the time (uint64), the payload.
"""

import base64
import json
import os
import socket
import struct
import threading
import time
from collections.abc import Iterator
from contextlib import closing
from types import SimpleNamespace
from typing import Any

import pytest

from rotorfit.core.log import Sample
from rotorfit.core.tracked import Alarm, Motion, Tracked, TrackedAxis

pytest.importorskip("foxglove", reason="pip install 'rotorfit[foxglove]'")

PROTOCOLS = "foxglove.sdk.v1, foxglove.websocket.v1"
TOPICS = {f"/rotorfit/{name}" for name in ("pose", "command", "tracked", "alarm", "gains", "motion")}
ALARM = Alarm(3.0, ("x",), "payload", (1.0, 2.0), {"x.input": (0.8, 0.9)}, 0.9, 1e-9, "because")


class Client:
    """As much of a WebSocket as it takes."""

    def __init__(self, port: int) -> None:
        self.socket = socket.create_connection(("127.0.0.1", port), timeout=10)
        self._file = self.socket.makefile("rb")
        key = base64.b64encode(os.urandom(16)).decode()
        lines = [
            "GET / HTTP/1.1", f"Host: 127.0.0.1:{port}", "Upgrade: websocket", "Connection: Upgrade",
            f"Sec-WebSocket-Key: {key}", "Sec-WebSocket-Version: 13", f"Sec-WebSocket-Protocol: {PROTOCOLS}", "", "",
        ]  # fmt: skip
        self.socket.sendall("\r\n".join(lines).encode())
        assert b"101" in self._file.readline()
        while self._file.readline().strip():
            pass

    def send(self, mapping: dict[str, Any]) -> None:
        data, mask = json.dumps(mapping).encode(), os.urandom(4)
        length = struct.pack(">BBH", 0x81, 0x80 | 126, len(data))
        self.socket.sendall(length + mask + bytes(one ^ mask[i % 4] for i, one in enumerate(data)))

    def frames(self) -> Iterator[tuple[int, bytes]]:
        while True:
            first, length = self._file.read(2)
            if length == 126:
                (length,) = struct.unpack(">H", self._file.read(2))
            elif length == 127:
                (length,) = struct.unpack(">Q", self._file.read(8))
            yield first & 15, self._file.read(length)

    def channels(self, frames: Iterator[tuple[int, bytes]]) -> dict[str, dict[str, Any]]:
        found: dict[str, dict[str, Any]] = {}
        for kind, data in frames:
            told = json.loads(data) if kind == 1 else {}
            if told.get("op") == "advertise":
                found |= {one["topic"]: one for one in told["channels"]}
            if found.keys() >= TOPICS:
                return found
        raise AssertionError

    def close(self) -> None:
        self._file.close()
        self.socket.close()


def test_a_client_that_stalls_does_not_hold_up_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    from rotorfit.app.live import foxglove

    monkeypatch.setattr(foxglove, "PATIENCE", 0.1)
    outlet, read = foxglove.FoxgloveOutlet(0, lambda _line: None), threading.Event()
    server, outlet._server = outlet._server, SimpleNamespace(stop=lambda: read.wait(60.0))
    begun = time.monotonic()
    outlet.close()

    assert time.monotonic() - begun < 30.0
    read.set()
    server.stop()


def test_a_client_reads_all_that_is_told() -> None:
    from rotorfit.app.live.foxglove import FoxgloveOutlet

    said: list[str] = []
    outlet = FoxgloveOutlet(0, said.append)
    try:
        assert said == [f"Foxglove and PlotJuggler: ws://127.0.0.1:{outlet.port}"]
        with closing(Client(outlet.port)) as client:
            frames = client.frames()
            channels = client.channels(frames)
            assert channels.keys() == TOPICS
            assert {one["encoding"] for one in channels.values()} == {"json"}
            wanted = [{"id": number, "channelId": one["id"]} for number, one in enumerate(channels.values())]
            client.send({"op": "subscribe", "subscriptions": wanted})

            topics, heard = list(channels), dict[str, tuple[int, Any]]()
            state = Tracked(2.0, {"x": TrackedAxis()}, (ALARM,))
            pose = Sample("pose", 5, 6, (1.0, 2.0, 3.0, 1.0, 0.0, 0.0, 0.0))
            command = Sample("command", 5, 6, (0.1, 0.2, 0.3, 0.4))
            stopped = threading.Event()

            def told() -> None:
                while not stopped.wait(0.05):  # a subscription takes a moment, and what came before it is not heard
                    outlet.heard([pose, command], 7)
                    outlet.state(state, 7, 7)
                    outlet.gains({"type": "gains", "axes": {"x": {}}}, 7)
                    outlet.motion(Motion(2.0, {}), 7)

            teller = threading.Thread(target=told)
            teller.start()
            try:
                while heard.keys() < TOPICS:
                    kind, data = next(frames)
                    if kind == 2 and data[0] == 1:
                        _, number, stamp = struct.unpack("<BIQ", data[:13])
                        heard[topics[number]] = stamp, json.loads(data[13:])
            finally:
                stopped.set()
                teller.join()

        assert heard["/rotorfit/pose"][1]["z"] == 3.0
        assert heard["/rotorfit/command"] == (6, {"x": 0.1, "y": 0.2, "z": 0.3, "yaw": 0.4})
        assert heard["/rotorfit/tracked"] == (7, json.loads(json.dumps(state.to_mapping())))
        assert heard["/rotorfit/alarm"][1]["cause"] == "payload"
        assert heard["/rotorfit/gains"] == (7, {"type": "gains", "axes": {"x": {}}})
        assert heard["/rotorfit/motion"][1]["time"] == 2.0
    finally:
        outlet.close()
