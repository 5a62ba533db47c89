"""Request: what a user asks of `plan`, in the words of the command line -> plans, and why."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from rotorfit.belief import Belief, belief_from_card, belief_from_model
from rotorfit.card import Card
from rotorfit.card_file import card_from_mapping, load_card
from rotorfit.errors import PlanError
from rotorfit.frames import AXES
from rotorfit.model_file import load
from rotorfit.next_flight import NextFlight, next_flight
from rotorfit.plan import Plan, Space
from rotorfit.plan_file import plan_mapping
from rotorfit.planning import TOGETHER, plan_flight, plan_flights
from rotorfit.space import CLIMB, ROOM, SPEED, space_of_box, space_of_room
from rotorfit.vehicle import load_vehicle

Progress = Callable[[float, str], None]

DESIGN = "multisine"
"""Where the user names none: gentle, and never far from the best of the designs with a fixed form."""


@dataclass(frozen=True)
class Request:
    """What is asked.

    Attributes:
        card: Name or file of a card; None with `after`.
        after: Model file whose next flight is wanted; None with `card`.
        design: A name of `excitation.DESIGNS`; None for the default, or after a model for the one that tells most.
        room: Size of the room, `6x4x3`; None for that, or with `box`.
        box: The fence, `x0,y0,z0,x1,y1,z1`; None with `room`.
        axes: To excite; None for all that the card commands, or after a model for those that are worst known.
        separate: Separate flights of x with y, z, yaw.
        open_loop: No feedback.
        duration: Of each flight, at most [s].
        amplitude: Factor on the full amplitude; None for what fits.
        speed: Largest along x and y [m/s]; None for `space.SPEED`.
        seed: Of sequences and draws.
    """

    card: str | None = None
    after: str | Path | None = None
    design: str | None = None
    room: str | None = None
    box: str | None = None
    axes: Sequence[str] | None = None
    separate: bool = False
    open_loop: bool = False
    duration: float = 60.0
    amplitude: float | None = None
    speed: float | None = None
    seed: int = 0


def planned(request: Request, progress: Progress | None = None) -> tuple[list[Plan], NextFlight | None]:
    """Makes the plans that are asked for; after a model and not in separate flights, with the reason for the one.

    Raises:
        PlanError: Neither or both of card and model; what `plan_flight` refuses.
        CardError: The card is wrong.
        ModelError: The model file is.
    """
    card, belief = _believed(request)
    space = _space(request)
    chosen: dict[str, Any] = {
        "amplitude": request.amplitude, "open_loop": request.open_loop, "seed": request.seed, "progress": progress
    }  # fmt: skip
    if request.after and not request.separate:
        proposal = next_flight(
            card, space, belief, request.duration, design=request.design, axes=request.axes, **chosen
        )  # fmt: skip
        proposal = replace(proposal, plan=_with_room_note(proposal.plan, request))
        return [proposal.plan], proposal
    axes = tuple(request.axes or (axis for axis in AXES if axis in card.command))
    make = plan_flights if request.separate else _one
    plans = make(card, space, request.design or DESIGN, axes, request.duration, belief, **chosen)
    return [_with_room_note(plan, request) for plan in plans], None


def _one(*asked: Any, **chosen: Any) -> list[Plan]:
    return [plan_flight(*asked, **chosen)]


def _with_room_note(plan: Plan, request: Request) -> Plan:
    """The plan with a note of the room, where the user has named none."""
    if request.room or request.box:
        return plan
    note = f"no --room or --box: assumed is a room of {ROOM} m, the origin in the middle of its floor"
    return replace(plan, predicted={**plan.predicted, "notes": [note, *plan.predicted.get("notes", ())]})


def _believed(request: Request) -> tuple[Card, Belief]:
    if (request.card is None) == (request.after is None):
        raise PlanError("give --card with the limits of the vehicle, or --after with a model of it, and not both")
    if request.card is not None:
        card = _card(request.card)
        return card, belief_from_card(card)
    model = load(str(request.after))
    return model.card, belief_from_model(model, str(request.after))


def _card(name: str) -> Card:
    """A card by name or file; `sim:VEHICLE` is that of a simulated vehicle."""
    link, colon, vehicle = name.partition(":")
    if link == "sim" and colon:
        return card_from_mapping(load_vehicle(vehicle).card(), name)
    return load_card(name)


def _space(request: Request) -> Space:
    if request.room and request.box:
        raise PlanError("give --room or --box, not both")
    speed = SPEED if request.speed is None else request.speed
    climb = min(CLIMB, speed)
    return space_of_box(request.box, speed, climb) if request.box else space_of_room(request.room or ROOM, speed, climb)


def destinations(path: Path, request: Request) -> list[Path]:
    """Where each plan, or its picture, goes: the path, or for separate flights `NAME-xy`, `NAME-z`, `NAME-yaw`."""
    if not request.separate:
        return [path]
    axes = tuple(request.axes or _believed(request)[0].command)
    groups = ["".join(axis for axis in group if axis in axes) for group in TOGETHER]
    return [path.with_stem(f"{path.stem}-{group}") for group in groups if group]


def plans_mapping(
    plans: Sequence[Plan], files: Sequence[Path], pictures: Sequence[Path], proposal: NextFlight | None
) -> dict[str, Any]:
    """The plans as plain JSON types, with their files and, after a model, what they change."""
    named: list[str | None] = [*map(str, files)] or [None] * len(plans)
    out: dict[str, Any] = {
        "plans": [{"path": name, **plan_mapping(plan)} for name, plan in zip(named, plans, strict=True)],
        "pictures": list(map(str, pictures)),
        "next": None,
    }
    if proposal:
        out["next"] = {
            "reason": proposal.reason, "tried": dict(proposal.tried), "before": _plain(proposal.before),
            "after": _plain(proposal.after), "wanted": _plain(proposal.wanted),
        }  # fmt: skip
    return out


def _plain(table: Mapping[str, Mapping[str, float]]) -> dict[str, dict[str, float]]:
    return {axis: dict(row) for axis, row in table.items()}
