"""A fake Tello on UDP: text commands on port 8889, a state packet at 10 Hz with whole centimetres and degrees."""

import math
import select
import socket
from typing import Any

from live_room import LiveRoom, arguments, run_until_told, yaw_of

from rotorfit.simulation.sensors import Mocap

SIGHT = Mocap(rate=500.0, noise=0.002, turn_noise=0.005, latency=0.0, jitter=0.0)
MOCAP = Mocap(rate=10.0, noise=0.0035, turn_noise=0.007, latency=0.0, jitter=0.0)
"""What the camera sees, and what is left of it in the state packet: 10 Hz, whole centimetres and degrees."""

SECOND = 1_000_000_000
PERIOD = SECOND // 10


class Tello:
    """One vehicle. Time is the room's [ns]."""

    def __init__(self, room: Any, host: str, state_port: int, pads: bool = True) -> None:
        self._room, self._state_port, self._pads = room, state_port, pads
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind((host, 8889))
        self._client = ""
        self._looking = False
        self._told = 0
        self._pose: tuple[float, ...] | None = None
        self._charge = 1.0
        self.pad = 1  # its number, for tests
        self.deaf = False  # sends nothing, for tests
        self.heard: list[str] = []
        self.mute: set[str] = set()  # words that it neither obeys nor answers, for tests
        self.says: dict[str, str] = {}  # words to the answers that they get instead, for tests

    def step(self, wait: float = 0.002) -> None:
        ready, _, _ = select.select((self.socket,), (), (), wait)
        for one in ready:
            packet, client = one.recvfrom(2048)
            self._answer(packet.decode("ascii"), client)
        for sample in self._room.samples():
            if sample.stream == "pose":
                self._pose = sample.values
            elif sample.stream == "battery":
                self._charge = sample.values[0]
        now = self._room.now()
        if self._client and not self.deaf and now - self._told >= PERIOD:
            self._told = now if now - self._told > 2 * PERIOD else self._told + PERIOD
            self.socket.sendto(self._state().encode("ascii"), (self._client, self._state_port))

    def _answer(self, text: str, client: tuple[str, int]) -> None:
        self.heard.append(text)
        word, *numbers = text.split()
        if word == "rc":
            right, forward, up, clockwise = (int(number) / 100 for number in numbers)
            self._room.send((forward, -right, up, -clockwise))
            return  # a Tello does not answer these
        if word in self.mute:
            return
        self._client = client[0] if word == "command" else self._client
        self._looking = self._looking or (word == "mon" and self._pads)
        if word in ("takeoff", "land"):
            {"takeoff": self._room.take_off, "land": self._room.land}[word]()
        known = word in ("command", "takeoff", "land", "mdirection") or (word == "mon" and self._pads)
        if not self.deaf:
            answer = self.says.get(word, "ok" if known else f"unknown command: {text}")
            self.socket.sendto(answer.encode("ascii"), client)

    def _state(self) -> str:
        mid, x, y, z, yaw = -2, -200, -200, -200, 0
        if self._looking:
            mid, x, y, z = -1, -100, -100, -100
        if self._looking and self._pose is not None:
            mid, (x, y, z) = self.pad, (round(100 * one) for one in self._pose[:3])
            yaw = round(math.degrees(-yaw_of(self._pose)))
        return (
            f"mid:{mid};x:{x};y:{y};z:{z};mpry:0,0,{yaw};pitch:0;roll:0;yaw:{yaw};vgx:0;vgy:0;vgz:0;templ:60;temph:62;"
            f"tof:{max(z, 10)};h:{max(z, 0)};bat:{round(100 * self._charge)};baro:163.98;time:0;"
            "agx:0.00;agy:0.00;agz:-998.00;\r\n"
        )


def main() -> None:
    parser, make = arguments("bebop2", SIGHT)
    parser.add_argument("--host", default="127.0.0.2")
    parser.add_argument("--state-port", type=int, default=8890)
    options = parser.parse_args()
    room: LiveRoom = make(options)
    run_until_told(Tello(room, options.host, options.state_port).step, room, options.arrivals)


if __name__ == "__main__":
    main()
