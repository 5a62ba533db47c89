"""A session: connects a link, a tracker and the outlets."""

import hashlib
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from rotorfit.core.card import Card
from rotorfit.core.errors import CardError, RotorfitError
from rotorfit.core.log import Sample
from rotorfit.core.model import Model, Source
from rotorfit.core.tracked import Track, Tracked
from rotorfit.files.cards import builtin_cards, card_from_mapping, load_card
from rotorfit.flying.links.opening import check_listens, split
from rotorfit.flying.listening import Listening
from rotorfit.flying.recorder import was_ended
from rotorfit.tracking.flight_so_far import UNRECORDED
from rotorfit.tracking.growing_flight import Part
from rotorfit.tracking.tracker import Tracker

if TYPE_CHECKING:
    from rotorfit.app.live.outlets import Moving, Outlet

KEPT = 4000
"""Largest number of states kept for the timeline of a flight; beyond it, every second one is dropped."""


def card_for_link(text: str, card: str | None) -> Card:
    """The card of a link's commands and poses.

    Args:
        text: `NAME:ADDRESS` of the link.
        card: Name or file; None for the link's own card.

    Raises:
        LinkError: There is no such link, or only a card can name its topics.
    """
    name, address = split(text)
    check_listens(text)
    if card is not None:
        return load_card(card)
    if name == "sim":
        from rotorfit.flying.links.sim import VEHICLE
        from rotorfit.simulation.vehicle import load_vehicle

        vehicle = load_vehicle(address.partition(",")[0] or VEHICLE)
        return card_from_mapping(vehicle.card(), vehicle.name)
    if name == "replay":
        from rotorfit.diagnosis.card_choice import card_of
        from rotorfit.files.logs import read

        return card_of(read(address))
    if name == "mavlink":
        return builtin_cards()["mavlink"]
    raise CardError(f"--link {text}: name the card of the vehicle with --card; it says on which topics to listen")


def track_link(
    tracker: Tracker,
    listening: Listening,
    outlets: Sequence["Outlet"],
    report: Callable[[Tracked, int], None],
    news: Callable[[str], None],
    moving: Sequence["Moving"] = (),
) -> Track:
    """Tracks a vehicle until the link ends.

    Args:
        tracker: A tracker, new or resumed.
        listening: The link.
        outlets: Outlets of samples and states; they are closed at the end, whatever ends it.
        report: Called with each new state and the link's clock [ns].
        news: Called with a line whenever the link is lost or back.
        moving: Called with the motion after each pose that counts.

    Returns:
        The states, thinned if there are more than `KEPT`, and the regimes.
    """
    now, moved = 0, -math.inf
    states: list[Tracked] = []

    def tell(state: Tracked) -> None:
        """Keeps a state, and hands it to all outlets."""
        if len(states) > KEPT:
            states[:] = [one for number, one in enumerate(states) if number % 2 == 0 or one.alarms]
        states.append(state)
        held = now if tracker.origin is None else tracker.origin + round(1e9 * state.time)
        for outlet in outlets:
            outlet.state(state, now, held)
        report(state, now)

    with ExitStack() as closing:
        for outlet in outlets:
            closing.callback(outlet.close)
        closing.callback(tracker.close)  # the last comes first
        for heard in listening:
            now = heard.now
            for outlet in outlets:  # first, so that whatever happens is recorded
                outlet.heard(heard.samples, now)
            if heard.news:
                news(heard.news)
            for sample in heard.samples:
                if sample.stream == "said":
                    news(sample.text)
                tracker.update(sample)
                if moving and sample.stream == "pose" and (motion := tracker.motion()) and motion.time > moved:
                    moved = motion.time
                    for mover in moving:
                        mover(motion, sample.received)
            for text in tracker.remarks():
                news(text)
                for outlet in outlets:
                    outlet.heard([Sample("said", now, now, (), text)], now)
            for state in tracker.news():
                tell(state)
        news(f"{'lost' if listening.lost else 'ended'}: {listening.ended}; fitting the flight once more")
        last, regimes = tracker.finish()
        for state in (*tracker.news(), last):
            tell(state)
    return Track(tuple(states), regimes)


def with_recordings(track: Track, parts: Sequence[Part]) -> Track:
    """The track with models that know their recordings: to a report these are the flights that they were fitted to.

    Args:
        track: Its models name spans of the whole flight.
        parts: The recordings of the flight; in each, seconds count from its own first command.
    """
    parts = [held for part in parts for held in _held(part)]
    digests: dict[str, str] = {}
    for path in {part.path for part in parts}:
        if Path(path).is_file():  # else it was not recorded, or no pose was heard
            with Path(path).open("rb") as file:
                digests[path] = hashlib.file_digest(file, "sha256").hexdigest()

    def recorded(source: Source) -> Iterator[Source]:
        for part in parts:
            start, end = max(source.span[0], part.begin), min(source.span[1], part.end)
            if start < end:
                span = start - part.begin, end - part.begin
                yield replace(source, path=part.path, sha256=digests.get(part.path, ""), span=span)

    def known(model: Model) -> Model:
        return replace(model, flights=tuple(part for source in model.flights for part in recorded(source)))

    regimes = (replace(one, model=known(one.model)) if one.model else one for one in track.regimes)
    return replace(track, regimes=tuple(regimes))


def _held(part: Part) -> tuple[Part, ...]:
    """A part as its file holds it, and the rest, which no file has where a full disk or a kill ended the recording."""
    from rotorfit.diagnosis.card_choice import card_of
    from rotorfit.files.logs import read
    from rotorfit.flights.assemble import flight_from_log

    if not Path(part.path).is_file() or was_ended(part.path):  # a long flight is not read for nothing
        return (part,)
    try:
        log = read(part.path)
        until = min(part.begin + flight_from_log(log, card_of(log)).span[1], part.end)
    except RotorfitError:  # it holds no flight
        until = part.begin
    return replace(part, end=until), Part(UNRECORDED, until, part.end)
