"""Request: options of `plan` as on the command line -> plans, with their reasons.

Also conversion of a user's description of a room to the fence of a plan.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from rotorfit.core.card import Card
from rotorfit.core.errors import PlanError
from rotorfit.core.flight_plan import Plan, Space
from rotorfit.core.frames import AXES
from rotorfit.core.frozen import frozen_axes
from rotorfit.core.limits import meaning_of
from rotorfit.core.model import Model
from rotorfit.core.progress import Progress
from rotorfit.files.cards import card_from_mapping, load_card
from rotorfit.files.models import load
from rotorfit.files.plans import WIDEST, plan_from_mapping, plan_mapping
from rotorfit.planning.belief import Belief, belief_from_card, belief_from_model
from rotorfit.planning.next_flight import NextFlight, next_flight
from rotorfit.planning.plan_flight import TOGETHER, plan_flight, plan_flights
from rotorfit.simulation.vehicle import load_vehicle

ROOM = "6x4x3"
"""Default room: the size of a small motion-capture laboratory [m]."""

MARGIN, FLOOR = 0.3, 0.5
"""Distance of the fence from walls and ceiling, and from the floor [m]: half of a Bebop 2 with its guards is 0.2 m, and
below half a metre it flies in ground effect."""

SPEED, CLIMB = 1.5, 1.0
"""Largest horizontal speed, x and y combined, and largest vertical speed [m/s]."""


def space_of_room(text: str, speed: float = SPEED, climb: float = CLIMB) -> Space:
    """The fence in a room `6x4x3` with the origin at the middle of its floor: start in the middle, heading along x.

    Raises:
        PlanError: Not three sizes, or no space left between the margins.
    """
    try:
        x, y, z = (float(part) for part in text.lower().split("x"))
    except ValueError:
        raise PlanError(f"room {text!r} is not length x width x height in m, such as {ROOM}") from None
    return _space(
        (MARGIN - x / 2, MARGIN - y / 2, FLOOR), (x / 2 - MARGIN, y / 2 - MARGIN, z - MARGIN), speed, climb, text
    )


def space_of_box(text: str, speed: float = SPEED, climb: float = CLIMB) -> Space:
    """The fence itself, `x0,y0,z0,x1,y1,z1` in the frame of the poses: start in its middle, heading along x.

    Raises:
        PlanError: Not six numbers, or an empty box.
    """
    try:
        x0, y0, z0, x1, y1, z1 = (float(part) for part in text.split(","))
    except ValueError:
        raise PlanError(f"box {text!r} is not x0,y0,z0,x1,y1,z1 in m, such as -2.7,-1.7,0.5,2.7,1.7,2.7") from None
    return _space((x0, y0, z0), (x1, y1, z1), speed, climb, text)


def _space(
    lower: tuple[float, float, float], upper: tuple[float, float, float], speed: float, climb: float, text: str
) -> Space:
    finite = all(abs(end) < 1e6 for end in (*lower, *upper))
    if not (finite and all(high - low >= 0.2 for low, high in zip(lower, upper, strict=True))):
        raise PlanError(
            f"{text!r} leaves no room to fly: plans keep {MARGIN:g} m from walls and ceiling of a room and {FLOOR:g} m "
            "from its floor, and 0.2 m must be left each way"
        )
    if (longest := max(high - low for low, high in zip(lower, upper, strict=True))) > WIDEST:
        raise PlanError(f"{text!r} leaves {longest:g} m to fly: a plan has at most {WIDEST:g} m each way; give less")
    if not (0 < speed < 100 and 0 < climb < 100):
        raise PlanError(f"speed limits of {speed:g} and {climb:g} m/s cannot be flown; give positive ones below 100")
    x, y, z = ((low + high) / 2 for low, high in zip(lower, upper, strict=True))
    return Space(lower, upper, (x, y, z, 0.0), speed, climb)


DESIGN = "multisine"
"""Default design: gentle, and never far from the best of the designs with a fixed form."""


BEYOND = 2.0
"""Command from which on it is no fraction of a full one."""


@dataclass(frozen=True)
class Request:
    """A request for plans.

    Attributes:
        card: A card, its name or its file; None with `after`.
        after: A model whose next flight is wanted, or its file; None with `card`.
        design: A name of `signals.DESIGNS`; None for the default, or after a model for the most informative one.
        room: Size of the room, `6x4x3`; None for the default, or with `box`.
        box: The fence, `x0,y0,z0,x1,y1,z1`; None with `room`.
        axes: Axes to excite; None for all that the card commands, or after a model for those known worst.
        separate: Whether to plan separate flights of x with y, z, yaw.
        open_loop: No feedback.
        duration: Largest duration of each flight [s].
        amplitude: Factor on the full amplitude; None for what fits.
        speed: Largest horizontal speed [m/s]; None for `SPEED`.
        seed: Seed of sequences and draws.
    """

    card: str | Card | None = None
    after: str | Path | Model | None = None
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
    """Makes the requested plans; after a model, unless in separate flights, also the proposal with its reason.

    Raises:
        PlanError: Neither or both of card and model; or refused by `plan_flight`.
        CardError: The card is invalid.
        ModelError: The model file is invalid.
    """
    card, belief, frozen = _believed(request)
    space = _space_of_request(request)
    chosen: dict[str, Any] = {
        "amplitude": request.amplitude, "open_loop": request.open_loop, "seed": request.seed, "progress": progress
    }  # fmt: skip
    if request.after and not request.separate:
        proposal = next_flight(
            card, space, belief, request.duration, design=request.design, axes=request.axes, frozen=frozen, **chosen
        )  # fmt: skip
        proposal = replace(proposal, plan=_with_room_note(proposal.plan, request))
        return [_flyable(proposal.plan)], proposal
    axes = tuple(request.axes or (axis for axis in AXES if axis in card.command))
    make = plan_flights if request.separate else _one
    plans = make(card, space, request.design or DESIGN, axes, request.duration, belief, **chosen)
    return [_flyable(_with_room_note(plan, request)) for plan in plans], None


def _flyable(plan: Plan) -> Plan:
    """The plan, unless `load_plan` would refuse it as a file."""
    plan_from_mapping(plan_mapping(plan), plan.name)
    return plan


def _one(*asked: Any, **chosen: Any) -> list[Plan]:
    return [plan_flight(*asked, **chosen)]


def _with_room_note(plan: Plan, request: Request) -> Plan:
    """The plan with a note on the assumed room, if the user has given none."""
    if request.room or request.box:
        return plan
    note = f"no --room or --box: assumed is a room of {ROOM} m, the origin in the middle of its floor"
    return replace(plan, predicted={**plan.predicted, "notes": [note, *plan.predicted.get("notes", ())]})


def _believed(request: Request) -> tuple[Card, Belief, tuple[str, ...]]:
    """Card, belief, and the axes whose pose was frozen in the flights of the model."""
    if (request.card is None) == (request.after is None):
        raise PlanError("give --card with the limits of the vehicle, or --after with a model of it, and not both")
    if request.card is not None:
        card = request.card if isinstance(request.card, Card) else _card(request.card)
        return card, belief_from_card(card), ()
    if isinstance(request.after, Model):
        model, where = request.after, "a model in memory"
    else:
        model, where = load(str(request.after)), str(request.after)
    _check_full_commands(model, where)
    return model.card, belief_from_model(model, where), frozen_axes(model.findings)


def _check_full_commands(model: Model, where: str) -> None:
    """Refuses a model whose flights commanded far more than the full command that its card leaves a plan to assume."""
    for axis in AXES:
        flown = max((source.commanded.get(axis, 0.0) for source in model.flights), default=0.0)
        if meaning_of(model.card, axis).asked is None and flown > BEYOND:
            raise PlanError(
                f"{where}: its flights commanded {axis} up to {flown:.3g}, while a full command is 1 by card "
                f"{model.card.name}: state commands as fractions of the full one, such as `scale = 0.01` for per cent, "
                "or their unit and [limits], and fit again"
            )


def _card(name: str) -> Card:
    """A card by name or file; `sim:VEHICLE` is that of a simulated vehicle."""
    link, colon, vehicle = name.partition(":")
    if link == "sim" and colon:
        return card_from_mapping(load_vehicle(vehicle).card(), name)
    return load_card(name)


def _space_of_request(request: Request) -> Space:
    if request.room and request.box:
        raise PlanError("give --room or --box, not both")
    speed = SPEED if request.speed is None else request.speed
    climb = min(CLIMB, speed)
    return space_of_box(request.box, speed, climb) if request.box else space_of_room(request.room or ROOM, speed, climb)


def destinations(path: Path, request: Request) -> list[Path]:
    """File of each plan, or its picture: the path, or for separate flights `NAME-xy`, `NAME-z`, `NAME-yaw`."""
    if not request.separate:
        return [path]
    axes = tuple(request.axes or _believed(request)[0].command)
    groups = ["".join(axis for axis in group if axis in axes) for group in TOGETHER]
    return [path.with_stem(f"{path.stem}-{group}") for group in groups if group]


def plans_mapping(
    plans: Sequence[Plan], files: Sequence[Path], pictures: Sequence[Path], proposal: NextFlight | None
) -> dict[str, Any]:
    """The plans as plain JSON types, with their files and, after a model, the proposal."""
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
