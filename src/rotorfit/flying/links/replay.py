"""A log played back as a link: poses come as recorded, commands have no effect. For rehearsing reading and guarding.

Time is that of the log and passes as fast as it is read. The end of the log is a lost link.
"""

from collections.abc import Sequence
from typing import Literal

import numpy as np

from rotorfit.core.card import Card
from rotorfit.core.errors import CardError, LinkError, LinkOverError
from rotorfit.core.frames import Array, Indices, quaternion_from_yaw, yaw_from_quaternion
from rotorfit.core.log import Log, Sample
from rotorfit.diagnosis.card_choice import another_card, card_of
from rotorfit.files.logs import read
from rotorfit.flights.assemble import flight_from_log
from rotorfit.flights.columns import card_for, column
from rotorfit.flights.stamps import stamps_of
from rotorfit.flying.links.link import Action, Silence

BEGIN = 1_577_836_800 * 10**9
"""Stamp of second 0 of a replayed flight that is listened to: 2020-01-01 [ns]."""


def open_link(address: str, card: Card) -> "ReplayLink":
    """Opens a log.

    Args:
        address: Path of the log.
        card: Used to read the log if it carries no card of its own and no built-in one fits.

    Raises:
        LinkError: The log has no poses.
        LogError: The log cannot be read.
        CardError: A column is missing.
    """
    log = read(address)
    try:
        own = card_of(log)
    except CardError:
        own = card
    own = card_for(log, own)
    samples = _poses(log, own)
    if not samples:
        raise LinkError(f"--link replay:{address}: the log holds no poses")
    return ReplayLink(samples, address)


def open_listener(address: str, card: Card) -> "ReplayLink":
    """Opens a log with the commands that were sent.

    Args:
        address: Path of the log.
        card: The card of the log.

    Raises:
        LogError, CardError, FlightError: The log holds no flight.
    """
    log = read(address)
    flight = flight_from_log(log, card)
    parts: tuple[tuple[Literal["pose", "command"], Array, Array], ...] = (
        ("pose", flight.pose_time, np.hstack([flight.position, quaternion_from_yaw(flight.yaw)])),
        ("command", flight.command_time, flight.command),
    )
    samples = [
        Sample(stream, stamp := BEGIN + round(t * 1e9), stamp, tuple(row))
        for stream, time, values in parts
        for t, row in zip(time.tolist(), values.tolist(), strict=True)
    ]
    samples.sort(key=lambda sample: sample.received)
    if told := another_card(log, card):
        samples.insert(0, Sample("said", samples[0].stamp, samples[0].received, (), told))
    return ReplayLink(samples, address)


class ReplayLink:
    """A recorded vehicle; implements `links.Link`."""

    live = False
    fail_safe, silence, undone = "A log is played back: no vehicle moves.", Silence(0.0), ""

    def __init__(self, samples: Sequence[Sample], name: str) -> None:
        self._samples, self._name, self._next = samples, name, 0
        self.now = samples[0].received - 1

    def send(self, command: Sequence[float]) -> Sequence[float]:
        """Nobody listens; see `links.Link`."""
        return command

    def receive(self, until: int) -> list[Sample]:
        """The samples up to an instant of the log; see `links.Link`."""
        if self._next == len(self._samples):
            raise LinkOverError(f"replay: {self._name} is over")
        first = self._next
        while self._next < len(self._samples) and self._samples[self._next].received <= until:
            self._next += 1
        self.now = max(self.now, until)
        return list(self._samples[first : self._next])

    def act(self, action: Action) -> None:
        """Nobody listens; see `links.Link`."""


def _poses(log: Log, card: Card) -> list[Sample]:
    """Every pose of a log as recorded, in the order of arrival; stamps of the log, ENU."""
    stamps = stamps_of(log, card.pose_time)
    series = {name: column(log, channel, len(stamps)) for name, channel in card.pose.items()}
    count = min([len(stamps), *(len(values) for values in series.values())])
    position = np.stack([series[axis][:count] for axis in "xyz"], axis=1)
    if "yaw" in series:
        attitude = quaternion_from_yaw(series["yaw"][:count])
    else:
        attitude = np.stack([series[f"q{part}"][:count] for part in "wxyz"], axis=1)
        if card.heading_offset:
            attitude = quaternion_from_yaw(yaw_from_quaternion(*attitude.T) + card.heading_offset)
    if card.frame == "NED":
        position = np.stack([position[:, 1], position[:, 0], -position[:, 2]], axis=1)
        attitude = _enu_from_ned(attitude)
    received = _arrivals(log, card, stamps[:count])
    order = np.argsort(received, kind="stable")
    rows = np.hstack([position, attitude])[order].tolist()
    pairs = zip(stamps[:count][order].tolist(), received[order].tolist(), rows, strict=True)
    return [Sample("pose", stamp, arrival, tuple(row)) for stamp, arrival, row in pairs]


def _arrivals(log: Log, card: Card, stamps: Indices) -> Indices:
    """When each pose was recorded, if the log has that time and the clocks may be one; otherwise its own stamp [ns]."""
    table = log.tables.get(str(card.pose_time.source).partition(":")[0])
    arrived = None if table is None else table.columns.get("log_time")
    return stamps if arrived is None else np.asarray(arrived[: len(stamps)], np.int64)


def _enu_from_ned(attitude: Array) -> Array:
    """Heading only: pi/2 - yaw, as the cards define NED."""
    w, x, y, z = attitude.T
    return quaternion_from_yaw(np.pi / 2 - yaw_from_quaternion(w, x, y, z))
