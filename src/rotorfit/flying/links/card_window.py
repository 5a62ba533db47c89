"""The window of a card, live: commands count while its conditions hold and the vehicle obeys, as in a log.

A condition on a state holds according to its last message, and not before the first. A condition on events holds
according to the last event that opens or closes it, and before any event.
"""

import math
from collections.abc import Callable, Mapping

from rotorfit.core.card import Card, Condition
from rotorfit.core.errors import LinkError
from rotorfit.core.log import Sample
from rotorfit.flights.columns import split_source
from rotorfit.flying.links.card_fields import channel_value


class Obedience:
    """Tracks whether the received commands count, and gives a sample of the stream `obeys` whenever that changes.

    Args:
        conditions: Conditions of the card by table; all must hold.

    Attributes:
        conditions: Table to its conditions.
    """

    def __init__(self, conditions: Mapping[str, tuple[Condition, ...]]) -> None:
        self.conditions = conditions
        self._holds = {one: bool(one.opens) or one.optional for each in conditions.values() for one in each}
        self._obeys = True
        self._last: bool | None = None

    def reported(self, obeys: bool, received: int) -> list[Sample]:
        """Takes a report of the vehicle, or an order to it.

        Args:
            obeys: Whether the vehicle now obeys commands.
            received: Time of arrival [ns].

        Returns:
            A sample if the answer has changed, or is the first; otherwise none.
        """
        self._obeys = obeys
        return self._news(received)

    def heard(self, table: str, read: Callable[[str], float], received: int) -> list[Sample]:
        """Takes a message.

        Args:
            table: Its topic or name.
            read: Name of a field to its value.
            received: Time of arrival [ns].

        Returns:
            A sample if the answer has changed, or is the first; otherwise none.
        """
        for one in self.conditions.get(table, ()):
            value = channel_value(one.channel, lambda source: read(split_source(source)[1]))
            if not one.opens:
                self._holds[one] = _state_holds(one, value)
            elif value in (*one.opens, *one.closes):
                self._holds[one] = value in one.opens
        return self._news(received) if table in self.conditions else []

    def begun(self, received: int) -> list[Sample]:
        """The answer before the first message [ns]; no sample if the card has no window."""
        return self._news(received) if self.conditions else []

    def _news(self, received: int) -> list[Sample]:
        """A sample if the answer differs from the last."""
        now = self._obeys and all(self._holds.values())
        if now == self._last:
            return []
        self._last = now
        return [Sample("obeys", received, received, (float(now),))]


def obedience(card: Card) -> Obedience:
    """The window of a card, for live messages.

    Raises:
        LinkError: A condition names no message.
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
