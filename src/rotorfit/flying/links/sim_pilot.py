"""The virtual flight room with a simulated pilot: what `rotorfit track --link sim` listens to.

The pilot flies rounds of three sines on every axis around the start, and holds the place by feedback; no real vehicle
is involved. The address is that of the link `sim`.
"""

from collections.abc import Sequence

import numpy as np

from rotorfit.core.card import Card
from rotorfit.core.errors import LinkError, PlanError
from rotorfit.core.flight_plan import AxisExcitation, Feedback, Plan, Sines, Space
from rotorfit.core.frames import AXES, yaw_from_quaternion
from rotorfit.core.log import Sample
from rotorfit.flying.links import sim
from rotorfit.flying.links.link import Action, Silence
from rotorfit.planning.belief import belief_from_card, belief_mapping
from rotorfit.planning.plan_control import begin, instants, largest_command, obeyed, observed, tracker_of

NAME = "the simulated pilot flies three sines on every axis, again and again"

RATE, ROUND, RAMP = 50.0, 60.0, 2.0
"""Command rate [1/s]; length of a round and of its ramps [s]."""

FREQUENCIES, SHARE = (1.0, 2.2, 3.7), (0.12, 0.12, 0.2, 0.2)
"""Frequencies of the sines of x, the other axes a little faster [rad/s]; amplitudes on x, y, z, yaw, as shares of the
full command."""

BOX = 3.0
"""Half width of the room [m]; the plan is not checked against it, since the feedback keeps the vehicle in place."""


def open_listener(address: str, card: Card) -> "PilotedRoom":
    """Opens the virtual flight room with a simulated pilot.

    Args:
        address: As for the link `sim`.
        card: Its commands must have the meaning that the vehicle gives them.

    Raises:
        LinkError: As for the link `sim`; or the card does not say what a command reaches.
        VehicleError: There is no such vehicle.
    """
    room = sim.room_of(address, card, "the card given", "leave --card out, or name its vehicle: --link sim:VEHICLE")
    try:
        return PilotedRoom(room, card)
    except PlanError as error:
        raise LinkError(f"sim: {str(error).partition(';')[0]}; leave --card out") from error


class PilotedRoom:
    """A simulated vehicle that a simulated pilot flies; implements `links.Link`, and takes no commands.

    Args:
        room: Where it flies.
        card: What its commands mean.
        seconds: Length of a round [s].
    """

    live = False
    fail_safe, silence, undone = "Simulated: no vehicle moves.", Silence(0.0), ""

    def __init__(self, room: sim.SimLink, card: Card, seconds: float = ROUND) -> None:
        self._room = room
        self._plan = tracker_of(_plan(card, seconds))
        self._wanted = instants(self._plan.plan, np.arange(0.0, seconds, 1 / RATE))
        self._pose: tuple[float, ...] | None = None
        self._begun = self._due = room.now
        self._number, self._state = 0, begin(np.zeros(4))

    @property
    def now(self) -> int:
        """Simulated time [ns]."""
        return self._room.now

    def send(self, _command: Sequence[float]) -> Sequence[float]:
        """Refused: the simulated pilot flies."""
        raise LinkError("sim: a listener sends nothing")

    def receive(self, until: int) -> list[Sample]:
        """Advances simulated time; returns the samples of the sensors and the commands of the pilot."""
        out: list[Sample] = []
        while self._due <= until:
            out += self._seen(self._room.receive(self._due))
            self._due += round(1e9 / RATE)
            if self._pose is not None:
                out.append(self._flown())
        return out + self._seen(self._room.receive(until))

    def act(self, _action: Action) -> None:
        """Nothing to close; see `links.Link`."""

    def _seen(self, samples: list[Sample]) -> list[Sample]:
        for sample in samples:
            if sample.stream != "pose":
                continue
            x, y, z, *quaternion = sample.values
            pose = (x, y, z, float(yaw_from_quaternion(*np.array(quaternion))))
            if self._pose is None:
                self._begun, self._state = sample.stamp, begin(np.array(pose))
            self._pose = pose
            self._state = observed(self._plan, self._state, (sample.stamp - self._begun) / 1e9, np.array(pose))
        return samples

    def _flown(self) -> Sample:
        self._state, command = obeyed(self._plan, self._state, self._wanted[self._number % len(self._wanted)])
        self._number += 1
        values = tuple(command.tolist())
        self._room.send(values)
        return Sample("command", self.now, self.now, values)


def _plan(card: Card, seconds: float) -> Plan:
    """The plan of the simulated pilot for a round of `seconds` [s]."""
    belief = {key: value for key, value in belief_mapping(belief_from_card(card)).items() if key != "covariance"}
    space = Space((-BOX, -BOX, 0.0), (BOX, BOX, BOX), (0.0, 0.0, BOX / 2, 0.0), BOX, BOX)
    axes = tuple(axis for axis in AXES if axis in card.command)
    signals = tuple(AxisExcitation(axis, "command", 0.0, seconds, _signal(card, axis)) for axis in axes)
    return Plan("pilot", "multisine", card.raw, RATE, seconds, RAMP, signals, Feedback(axes), space, belief)


def _signal(card: Card, axis: str) -> Sines:
    """The sines of an axis, at frequencies that no other axis has, so that the axes can be told apart."""
    number = AXES.index(axis)
    size = SHARE[number] * largest_command(card, axis)
    frequency = tuple((one + 0.3 * number) * 2 * np.pi / ROUND * round(ROUND / (2 * np.pi)) for one in FREQUENCIES)
    return Sines((size,) * len(frequency), frequency, tuple(float(number * k) for k in range(len(frequency))))
