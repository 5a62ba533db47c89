"""Plans for tests of links, which read a plan's card and start only; and a room that remembers what it was told."""

from collections.abc import Mapping, Sequence
from typing import Any

from rotorfit.card import builtin_cards
from rotorfit.excitation import Sines
from rotorfit.log import Sample
from rotorfit.plan import Excitation, Plan, Space

SPACE = Space((-2.0, -2.0, 0.3), (2.0, 2.0, 2.5), (0.0, 0.0, 1.2, 0.0), 1.5, 1.0)


def plan_for(card: str | Mapping[str, Any]) -> Plan:
    """A plan of a built-in card, by its name, or of a card as parsed from TOML."""
    raw = builtin_cards()[card].raw if isinstance(card, str) else card
    excitation = Excitation("x", "command", 0.0, 5.0, Sines((0.1,), (0.5,), (0.0,)))
    return Plan("test", "two_sines", raw, 100.0, 5.0, 1.0, (excitation,), None, SPACE)


class StubRoom:
    """Looks like a FlightRoom on the wall clock; does nothing but remember, and say where it is told to be."""

    def __init__(self, mode: str = "flying") -> None:
        self.commands: list[tuple[float, ...]] = []
        self.asked: list[str] = []
        self.waiting: list[Sample] = []
        self.instant = 0
        self.flight_mode = mode

    def now(self) -> int:
        return self.instant

    def send(self, command: Sequence[float]) -> None:
        self.commands.append(tuple(command))

    def take_off(self) -> None:
        self.asked.append("take_off")
        self.flight_mode = "flying"

    def land(self) -> None:
        self.asked.append("land")

    def mode(self) -> str:
        return self.flight_mode

    def samples(self) -> list[Sample]:
        found, self.waiting = self.waiting, []
        return found
