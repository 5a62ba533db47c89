"""Opens a link by name, optionally with the poses of another link."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module

from rotorfit.core.card import Card
from rotorfit.core.errors import LinkError
from rotorfit.core.flight_plan import Four
from rotorfit.flying.links import LINKS
from rotorfit.flying.links.link import Link
from rotorfit.flying.links.poses_apart import join


def open_link(text: str, card: Card, poses: str = "") -> Link:
    """Opens a link.

    Args:
        text: `NAME`, `NAME:ADDRESS` or `NAME,OPTION=VALUE`; each link defines its addresses.
        card: Meaning and unit of the commands; for links with named messages, also their names.
        poses: `NAME:ADDRESS` of another link that gives the poses; empty for the vehicle's own.

    Raises:
        LinkError: There is no such link, a package is missing, nobody answers, or the card turns the heading.
    """
    name, address = _known(text)
    _check_heading(name, card)
    with _explained_if_missing(name):
        link: Link = import_module(LINKS[name].module).open_link(address, card)
    if not poses:
        return link
    try:
        with _explained_if_missing(poses.partition(":")[0]):
            return join(link, poses)
    except LinkError:
        link.act("close")
        raise


def open_listener(text: str, card: Card) -> Link:
    """Opens a link that only listens to the vehicle and to whoever commands it; its `send` refuses.

    Its samples include the commands of others: forward, left, up, counter-clockwise after the card's scale.

    Args:
        text: As for `open_link`.
        card: Meaning of the commands and of the poses.

    Raises:
        LinkError: There is no such link, it cannot be shared, a package is missing, nothing is received, or the card
            turns the heading.
    """
    check_listens(text)
    name, address = split(text)
    _check_heading(name, card)
    with _explained_if_missing(name):
        link: Link = import_module(LINKS[name].listens).open_listener(address, card)
        return link


def _check_heading(name: str, card: Card) -> None:
    """Refuses a card that turns the heading: only a log that is played back is read with it."""
    if card.heading_offset and name != "replay":
        raise LinkError(
            f"card {card.name}: a link takes the quaternion as it is: turn the rigid body's axes in the motion capture "
            "software, and leave heading_offset out"
        )


def check_listens(text: str) -> None:
    """Refuses a link that does not exist, or cannot be shared with whoever commands the vehicle.

    Raises:
        LinkError: The link is one of these.
    """
    name, _ = _known(text)
    if not LINKS[name].listens:
        raise LinkError(f"--link {text}: nobody can listen to it: {LINKS[name].alone}")


def simulated_at(text: str, start: Four, seed: int = 0, flying: bool = True) -> str:
    """The link with start, seed and state of its simulated vehicle as options; any other link unchanged.

    Args:
        text: As for `open_link`; its own options take precedence.
        start: World x, y, z [m] and yaw [rad].
        seed: Seed of wind, noise and radio.
        flying: Whether the vehicle is already in the air.
    """
    name, _ = split(text)
    if name not in LINKS or not LINKS[name].simulated:
        return text
    place = "/".join(repr(float(value)) for value in start)
    return f"{text},start={place},seed={seed},flying={'yes' if flying else 'no'}"


def split(text: str) -> tuple[str, str]:
    """Name and address; options may follow the name itself, as in `sim,wind=2`."""
    name = re.split("[:,]", text, maxsplit=1)[0]
    return name, text[len(name) :].removeprefix(":")


def _known(text: str) -> tuple[str, str]:
    """Name and address of a link; refuses one that does not exist, or lacks a required address."""
    name, address = split(text)
    if name not in LINKS:
        raise LinkError(f"--link {text}: no link {name!r}; links are {', '.join(LINKS)}")
    if LINKS[name].example and not address:
        raise LinkError(f"--link {text}: {name} needs a file: --link {LINKS[name].example}")
    return name, address


@contextmanager
def _explained_if_missing(name: str) -> Iterator[None]:
    """Turns a missing package into a `LinkError` of one line that says how to install it."""
    try:
        yield
    except ModuleNotFoundError as error:
        remedy = (LINKS[name].install if name in LINKS else "") or f"pip install {error.name}"
        raise LinkError(f"link {name} needs the Python package {error.name}: {remedy}") from error
