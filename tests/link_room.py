"""A room for tests of links that remembers what it was told."""

from collections.abc import Sequence

from rotorfit.core.log import Sample


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
