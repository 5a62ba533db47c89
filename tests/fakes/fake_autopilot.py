"""A fake autopilot on MAVLink, in the manner of PX4 or ArduPilot Copter: modes, arming, setpoints, fail-safe."""

import os
import select
from typing import Any

os.environ["MAVLINK20"] = "1"
from live_room import LiveRoom, arguments, run_until_told
from pymavlink import mavutil

from rotorfit.simulation.sensors import Mocap

MOCAP = Mocap(rate=50.0, noise=0.002, turn_noise=0.002, latency=0.01, jitter=0.001)
"""The autopilot's own estimate: 50 Hz, and the delay of a filter."""

BOOT = 123_456_789_000  # the autopilot was started so long before the room [ns]
SECOND = 1_000_000_000
AUTO, OFFBOARD, POSITION = 4, 6, 3
TAKE_OFF, LOITER, LAND = 2, 3, 6
BODY_NED, VELOCITY_AND_YAW_RATE = 8, 1479
ACCEPTED, DENIED = 0, 2  # MAV_RESULT
LANDED = {"grounded": 1, "taking_off": 3, "flying": 2, "landing": 4}


class Autopilot:
    """One vehicle. Time is the room's [ns]."""

    def __init__(self, connection: Any, room: Any, ardupilot: bool = False) -> None:
        self.connection, self._room, self.ardupilot = connection, room, ardupilot
        self.armed = room.mode() == "flying"
        self.mode = (5,) if ardupilot else (POSITION, 0)
        self._setpoints: list[int] = []
        self._beat = self._state = -SECOND
        self.killed = False  # by a switch, in the air, for tests
        self.vehicle_type = 2  # MAV_TYPE_QUADROTOR
        self.refuse: dict[int, int] = {}  # commands to the results that answer them instead of obedience
        self.mute: set[int] = set()  # commands that it neither obeys nor answers
        self.silent_about: set[int] = set()  # commands that it obeys, and whose answers are lost
        self.deaf = False  # sends nothing, for tests
        self.requests: list[int] = []
        self.goes_on = 0.5
        self.says: list[tuple[int, str]] = []  # severity and text, for tests
        self.clock = 0  # by which its clock has stepped [ns], for tests

    def step(self, wait: float = 0.002) -> None:
        ready, _, _ = select.select((self.connection.fd,), (), (), wait)
        while ready and (message := self.connection.recv_msg()) is not None:
            getattr(self, f"_on_{message.get_type().lower()}", lambda _: None)(message)
        samples = self._room.samples()
        self._fly()
        if not self.deaf:
            self._tell(samples)

    def boot_ms(self, instant: int) -> int:
        return (instant + BOOT + self.clock) // 1_000_000

    def _fly(self) -> None:
        now, flying = self._room.now(), self._room.mode()
        if self.mode == (AUTO, TAKE_OFF) and flying == "flying":
            self.mode = (AUTO, LOITER)
        # PX4: COM_OF_LOSS_T = 1 s without setpoints ends OFFBOARD; ArduPilot stops after 3 s and stays in GUIDED
        silent = not self._setpoints or now - self._setpoints[-1] > (3 if self.ardupilot else 1) * SECOND
        if self.mode == (OFFBOARD, 0) and silent:
            self.mode = (AUTO, LOITER)

    def _tell(self, samples: list[Any]) -> None:
        mav, now = self.connection.mav, self._room.now()
        for number, (severity, text) in enumerate(self.says, 1):
            parts = [text[start : start + 50] for start in range(0, len(text), 50)]
            for place, part in enumerate(parts):
                mav.statustext_send(severity, part.encode(), number if len(parts) > 1 else 0, place)
        self.says.clear()
        if now - self._beat >= SECOND:
            self._beat = now
            custom = self.mode[0] if self.ardupilot else self.mode[0] << 16 | self.mode[1] << 24
            armed = not self.killed and (self.armed or self._room.mode() != "grounded")
            mav.heartbeat_send(self.vehicle_type, 3 if self.ardupilot else 12, 1 | 128 * armed, custom, 4)
        if now - self._state >= SECOND // 2:
            self._state = now
            mav.extended_sys_state_send(0, LANDED[self._room.mode()])
        for sample in samples:
            if sample.stream == "battery":
                mav.sys_status_send(0, 0, 0, 0, 15000, -1, round(100 * sample.values[0]), 0, 0, 0, 0, 0, 0)
            elif sample.stream == "pose":
                self._tell_pose(sample)

    def _tell_pose(self, sample: Any) -> None:
        east, north, up, w, x, y, z = sample.values
        boot, half = self.boot_ms(sample.stamp), 0.5**0.5
        # the same exchange of worlds and bodies as from NED: it is its own inverse
        turned = (half * (w + z), half * (x + y), half * (x - y), half * (w - z))
        self.connection.mav.attitude_quaternion_send(boot, *turned, 0.0, 0.0, 0.0)
        self.connection.mav.local_position_ned_send(boot, north, east, -up, 0.0, 0.0, 0.0)

    def _on_set_position_target_local_ned(self, message: Any) -> None:
        now = self._room.now()
        self._setpoints = [one for one in self._setpoints if now - one < 2 * SECOND] + [now]
        fits = message.coordinate_frame == BODY_NED and message.type_mask == VELOCITY_AND_YAW_RATE
        if fits and self.mode in ((OFFBOARD, 0), (4,)) and self._room.mode() == "flying":
            self._room.send((message.vx, -message.vy, -message.vz, -message.yaw_rate))

    def _on_param_request_read(self, message: Any) -> None:
        if message.param_id in ("GUID_TIMEOUT", "COM_OF_LOSS_T"):  # as a careful owner has set it
            self.connection.mav.param_value_send(message.param_id.encode(), self.goes_on, 9, 1, 0)

    def _on_timesync(self, message: Any) -> None:
        if message.tc1 == 0:
            self.connection.mav.timesync_send(self._room.now() + BOOT + self.clock, message.ts1)

    def _on_command_long(self, message: Any) -> None:
        self.requests.append(message.command)
        if message.command in self.mute:
            return
        result = self.refuse.get(message.command)
        if result is None:
            result = ACCEPTED if self._obey(message) else DENIED
        if message.command not in self.silent_about:
            self.connection.mav.command_ack_send(message.command, result)

    def _obey(self, message: Any) -> bool:
        command = message.command
        if command == 176:  # MAV_CMD_DO_SET_MODE
            wanted = (int(message.param2),) if self.ardupilot else (int(message.param2), int(message.param3))
            now = self._room.now()
            streamed = len([one for one in self._setpoints if now - one < SECOND]) > 2 and (
                now - self._setpoints[0] > SECOND
            )
            if wanted == (OFFBOARD, 0) and not streamed:
                return False
            self.mode = wanted
        elif command == 400:
            self.armed = True
        elif command == 22:
            if not self.armed or (self.ardupilot and self.mode != (4,)):
                return False
            self.mode = self.mode if self.ardupilot else (AUTO, TAKE_OFF)
            self._room.take_off()
        elif command == 21:
            self.mode = (9,) if self.ardupilot else (AUTO, LAND)
            self._room.land()
        return True


def connect(address: str) -> Any:
    return mavutil.mavlink_connection(address, source_system=1, source_component=1)


def main() -> None:
    parser, make = arguments("bebop2", MOCAP)
    parser.add_argument("--address", default="udpout:127.0.0.1:14540")
    parser.add_argument("--ardupilot", action="store_true")
    options = parser.parse_args()
    room: LiveRoom = make(options)
    autopilot, begun = Autopilot(connect(options.address), room, options.ardupilot), room.wall(0)

    def step() -> None:
        autopilot.clock = room.wall(0) - begun  # where the clock of this process steps, so does the autopilot's
        autopilot.step()

    run_until_told(step, room, options.arrivals)


if __name__ == "__main__":
    main()
