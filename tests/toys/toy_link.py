"""A link to nobody."""

from rotorfit.core.card import Card
from rotorfit.core.errors import LinkError
from rotorfit.flying.links.link import Link


def open_link(address: str, card: Card) -> Link:
    raise LinkError(f"the toy at {address or 'home'} is asleep")
