"""The window of a card, live: commands count while its conditions hold and the vehicle obeys, as in a log.

A state holds from its message on, and does not hold before the first. Of events the last that opens or closes tells;
before any the condition holds.
"""

import math
from collections.abc import Callable, Mapping

from rotorfit.core.card import Card, Condition
from rotorfit.core.errors import LinkError
from rotorfit.core.log import Sample
from rotorfit.flights.columns import split_source
from rotorfit.flying.links.card_fields import channel_value


class Obedience:
    """Whether what is heard counts; tells it at first, and when that changes.

    Args:
        conditions: Of the card; all must hold.

    Attributes:
        conditions: Table to its conditions.
    """

    def __init__(self, conditions: Mapping[str, tuple[Condition, ...]]) -> None:
        self.conditions = conditions
        self._holds = {one: bool(one.opens) or one.optional for each in conditions.values() for one in each}
        self._obeys = True
        self._last: bool | None = None

    def told(self, obeys: bool, received: int) -> list[Sample]:
        """Takes what the vehicle, or an order to it, says.

        Args:
            obeys: Whether it obeys commands.
            received: When that came [ns].
        """
        self._obeys = obeys
        return self._news(received)

    def heard(self, table: str, read: Callable[[str], float], received: int) -> list[Sample]:
        """Takes a message.

        Args:
            table: Its topic or name.
            read: Name of a field to its value.
            received: When it came [ns].
        """
        for one in self.conditions.get(table, ()):
            value = channel_value(one.channel, lambda source: read(split_source(source)[1]))
            if not one.opens:
                self._holds[one] = _state_holds(one, value)
            elif value in (*one.opens, *one.closes):
                self._holds[one] = value in one.opens
        return self._news(received) if table in self.conditions else []

    def begun(self, received: int) -> list[Sample]:
        """What is known before the first message: a window is closed, and without one nothing is said."""
        return self._news(received) if self.conditions else []

    def _news(self, received: int) -> list[Sample]:
        """A sample where the answer is another than the last."""
        now = self._obeys and all(self._holds.values())
        if now == self._last:
            return []
        self._last = now
        return [Sample("obeys", received, received, (float(now),))]


def obedience(card: Card) -> Obedience:
    """What a card asks of live messages.

    Raises:
        LinkError: A condition that names no message.
    """
    found: dict[str, tuple[Condition, ...]] = {}
    for one in card.window:
        table = split_source(one.channel.source)[0]
        if not table:
            raise LinkError(
                f"card {card.name}, [window]: a link needs a message, as in '/topic:field'; here: {one.channel.source}"
            )
        found[table] = (*found.get(table, ()), one)
    return Obedience(found)


def _state_holds(condition: Condition, value: float) -> bool:
    if condition.equals:
        return value in condition.equals
    if condition.above is not None:
        return value > condition.above
    return not math.isnan(value) and value != 0
