"""Proposal: the card with which a log is read if none is given, and the reason."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from rotorfit.core.card import Card
from rotorfit.core.errors import CardError, FlightError
from rotorfit.core.flight_data import Flight
from rotorfit.core.log import Log
from rotorfit.core.plain import plain_toml
from rotorfit.diagnosis.recognition import commands_in, lacking, pose_in
from rotorfit.files.cards import card_from_mapping
from rotorfit.flights.assemble import flight_from_log
from rotorfit.flights.columns import fitting_cards


@dataclass(frozen=True)
class Proposal:
    """A card proposed for a log.

    Attributes:
        name: Name of the built-in card; None for the card attached to the log.
        card: The card.
        why: The reason, one line.
        rivals: Names of the other built-in cards whose columns are all in the log.
    """

    name: str | None
    card: Card
    why: str
    rivals: tuple[str, ...] = ()


def proposal(log: Log) -> Proposal:
    """The card attached to the log, as in recordings of `rotorfit fly`; else the built-in card that fits best.

    Among the built-in cards whose columns are all in the log, those that yield a flight are kept; among these, those
    that no other card overrides (`over` of a card: commands as sent override what the vehicle made of them, motion
    capture overrides the vehicle's own estimate); then the one with the most commanded axes, then with the longest
    flight.

    Raises:
        CardError: The attached card is damaged; no built-in card fits; or several fit equally well.
    """
    if "card" in log.attached:
        try:
            raw = plain_toml(log.attached["card"])
        except ValueError as error:
            raise CardError(f"{log.path}: the card in it is damaged ({error}); name one with `--card`") from error
        return Proposal(None, card_from_mapping(raw, f"attached to {log.path}"), "the log carries it")
    fitting = fitting_cards(log)
    if not fitting:
        lacks = lacking(log)
        raise CardError(
            f"{log.path}: no built-in card fits{', and ' if lacks else ''}{lacks}; draft one with "
            f"`rotorfit info {log.path} --draft-card FILE`, or name one with `--card`"
        )
    if len(fitting) == 1:
        return Proposal(*next(iter(fitting.items())), "the only one whose columns are all there")
    flights = _flights(log, fitting)
    return _best(log, fitting, flights) if flights else _first(log, fitting)


def joined_by_plus(logs: Sequence[Log]) -> str:
    """Advice, in one line, if one log holds commands and another poses; else empty."""
    known = [(log, commands_in(log).channels, pose_in(log).channels.keys() & {"x", "y", "z"}) for log in logs]
    commands = [log.path for log, told, seen in known if told and not seen]
    poses = [log.path for log, told, seen in known if seen and not told]
    if not commands or not poses:
        return ""
    both = f"{commands[0]}+{poses[0]}"
    return (
        f"{commands[0]} holds commands and {poses[0]} poses; if they are of one flight, join them by a plus: "
        f"`rotorfit info {both} --draft-card FILE`, then `rotorfit fit {both} --card FILE`"
    )


def another_card(log: Log, card: Card) -> str:
    """States, in one line, that a log carries another card than the one that reads it; empty where it does not."""
    try:
        own = card_of(log) if "card" in log.attached else card
    except CardError:
        return ""
    if own.raw == card.raw:
        return ""
    return f"read with the card {card.name}, as asked, and not with the one that the log carries, {own.name}"


def card_of(log: Log) -> Card:
    """The card of `proposal`.

    Raises:
        CardError: As `proposal`.
    """
    return proposal(log).card


def _flights(log: Log, cards: Mapping[str, Card]) -> dict[str, Flight]:
    """The flight that each card yields; cards that yield none are left out."""
    flights = {}
    for name, card in cards.items():
        try:
            flights[name] = flight_from_log(log, card)
        except (CardError, FlightError):
            continue
    return flights


def _best(log: Log, cards: Mapping[str, Card], flights: Mapping[str, Flight]) -> Proposal:
    beaten = {other for name in flights for other in cards[name].over}
    left = {name: flight for name, flight in flights.items() if name not in beaten}
    rank = {name: (len(flight.axes), flight.duration) for name, flight in left.items()}
    best = max(rank.values())
    equal = [name for name in left if rank[name] == best]
    if len(equal) > 1:
        raise CardError(f"{log.path}: several built-in cards fit ({', '.join(equal)}); name one with `--card`")
    others = [f"{name} ({_against(name, equal[0], flights, cards, rank)})" for name in cards if name != equal[0]]
    rivals = tuple(name for name in cards if name != equal[0])
    return Proposal(equal[0], cards[equal[0]], f"before {', '.join(others)}", rivals)


def _against(
    name: str,
    best: str,
    flights: Mapping[str, Flight],
    cards: Mapping[str, Card],
    rank: Mapping[str, tuple[int, float]],
) -> str:
    """Why a card that fits was not chosen."""
    if name not in flights:
        return "gives no flight"
    if name not in rank:
        return f"{next(other for other in flights if name in cards[other].over)} goes before it where both fit"
    if rank[name][0] < rank[best][0]:
        return f"{rank[name][0]} commanded axes, not {rank[best][0]}"
    return f"{rank[name][1]:.0f} s of flight, not {rank[best][1]:.0f}"


def _first(log: Log, cards: Mapping[str, Card]) -> Proposal:
    """The card that no other overrides: it reports why there is no flight.

    Raises:
        CardError: There is no single such card.
    """
    beaten = {other for card in cards.values() for other in card.over}
    left = [name for name in cards if name not in beaten]
    if len(left) != 1:
        raise CardError(f"{log.path}: several built-in cards fit ({', '.join(cards)}); name one with `--card`")
    return Proposal(left[0], cards[left[0]], f"none of {', '.join(cards)}, whose columns are all there, gives a flight")
