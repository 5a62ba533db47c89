"""Mission: what `rotorfit fly` does with a plan file, a link and a recording, from preflight to the closed log."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from rotorfit.core.card import Card
from rotorfit.core.errors import LinkError, LogError
from rotorfit.core.flight_plan import Flown, Plan
from rotorfit.core.writing import check_place
from rotorfit.files.cards import card_from_mapping, load_card
from rotorfit.files.plans import load_plan, plan_text
from rotorfit.flying.beside import Beside
from rotorfit.flying.flight_loop import OnStatus, fly
from rotorfit.flying.links.link import Link
from rotorfit.flying.links.opening import open_link, simulated_at
from rotorfit.flying.operator import operator_abort
from rotorfit.flying.preflight import Ready, preflight
from rotorfit.flying.recorder import card_as_recorded, record


@dataclass(frozen=True)
class Mission:
    """A plan and its preflight, on an open link.

    Attributes:
        plan: The plan that will be flown.
        link: The open link.
        name: The link, as given by the user.
        ready: The result of the preflight.
        output: Path of the recording.
        take_off: Whether the flight begins on the floor.
    """

    plan: Plan
    link: Link
    name: str
    ready: Ready
    output: Path
    take_off: bool


@contextmanager
def mission(
    plan: str | Plan, link: str, output: Path, card: str | Card | None = None, take_off: bool = False, seed: int = 0,
    poses: str = "",
) -> Iterator[Mission]:  # fmt: skip
    """Opens a link for a plan and makes the preflight checks; closes the link on exit.

    Args:
        plan: A plan, or its file.
        link: `NAME` or `NAME:ADDRESS`.
        output: Path of the recording, a file that does not exist yet.
        card: The vehicle's settings and connection now, as a card, its name or its file; None for the plan's card.
        take_off: Whether the flight begins on the floor.
        seed: Seed of a simulated vehicle.
        poses: `NAME:ADDRESS` of another link that gives the poses; empty for the vehicle's own.

    Raises:
        PlanError, CardError: The plan or the card cannot be used.
        LinkError: The link cannot be opened.
        LogError: The file of the recording exists already or has another suffix, or cannot be written.
    """
    named = plan.name if isinstance(plan, Plan) else plan
    plan = plan if isinstance(plan, Plan) else load_plan(plan)
    check_new(output)
    now = load_card(card) if isinstance(card, str) else card
    own = now or card_from_mapping(plan.card, f"of plan {named}")
    opened = open_link(simulated_at(link, plan.space.start, seed, not take_off), own, poses)
    try:
        yield Mission(plan, opened, link, preflight(plan, opened, now, take_off), output, take_off)
    finally:
        with suppress(LinkError):
            opened.act("close")


def flown_mission(
    wanted: Mission,
    land: bool,
    status: Callable[[], AbstractContextManager[OnStatus | None]],
    beside: Beside | None = None,
) -> Flown:
    """Flies a mission.

    Args:
        wanted: A mission that its preflight does not refuse.
        land: Whether the vehicle lands at the end.
        status: Context manager for the time of the flight; gives the function that receives reports of progress.
        beside: A tracker that is fed what is sent and received.

    Raises:
        LogError: The recording cannot be written.
        PlanError: The plan cannot be flown: it has feedback but no belief.
        CardError: The plan's card is wrong.
    """
    plan = wanted.plan
    attached = attached_to(plan, wanted.ready, wanted.name)
    with operator_abort() as abort, status() as progress:
        recorder = record(wanted.output, attached, beside)
        return fly(plan, wanted.link, recorder, land, wanted.take_off, abort, progress)


def attached_to(plan: Plan, ready: Ready, link: str) -> dict[str, str]:
    """What a recording has besides its streams: the plan and the card as TOML, and the link as given."""
    import tomli_w

    card = tomli_w.dumps(card_as_recorded(plan.card, ready.pose_clock, pose_error=ready.pose_error))
    return {"plan": plan_text(plan), "card": card, "link": link}


def check_new(output: Path) -> None:
    """Refuses a path that the recorder would refuse, before anything flies.

    Raises:
        LogError: The file exists or has another suffix, or its folder is missing or takes no file.
    """
    if output.exists():
        raise LogError(f"{output}: exists, and a recording is never overwritten; choose another name")
    if output.suffix.lower() != ".mcap":
        raise LogError(f"{output}: a recording is an MCAP file; name it {output.stem or 'flight'}.mcap")
    check_place(output)


def flown_mapping(flown: Flown, ready: Ready, live: bool) -> dict[str, Any]:
    """A flight as plain JSON types; in simulated time (not `live`) without the lateness of commands."""
    return {
        **asdict(flown),
        **({} if live else {"jitter": None, "late": None}),
        "path": str(flown.path),
        "notes": [*ready.notes, *flown.notes],
        "preflight": [asdict(check) for check in ready.checks],
    }
