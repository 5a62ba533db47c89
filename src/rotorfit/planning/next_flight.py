"""The next-best flight after a model: the axes known worst compared with the target, and the design that helps most."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from rotorfit.core.card import Card
from rotorfit.core.errors import PlanError
from rotorfit.core.flight_plan import Plan, Space
from rotorfit.core.frames import AXES, Array
from rotorfit.core.model import COEFFICIENTS, MEND
from rotorfit.core.progress import Progress, part_of
from rotorfit.planning.belief import Belief, belief_from_mapping, belief_mapping
from rotorfit.planning.plan_flight import TOGETHER, Fleets, plan_with_information
from rotorfit.planning.precision import inverse_of, precision_of

Table = Mapping[str, Mapping[str, float]]

WANTED = (0.02, 0.05, 0.005)
"""Target standard errors: of input and damping (relative), of the delay [s]. A judgement: a controller designed for a
phase margin of 45 degrees is insensitive to them."""

LEAST = 30.0
"""Shortest flight to which a proposal is cut [s]: the intervals of a fit of less than 20 s are optimistic."""

TRIED = ("multisine", "chirp", "optimal")
"""Designs that are compared if the user names none: those without hard steps, see `plan_flight.HARD`."""


@dataclass(frozen=True)
class NextFlight:
    """A proposed flight.

    Attributes:
        plan: The flight.
        before: Axis to coefficient to standard error in the model; where it has none, in the belief.
        after: The same with the flight added.
        wanted: The target standard errors.
        tried: Design to its result: the root mean square of error over target, over the flown axes.
        reason: Why these axes, one sentence.
    """

    plan: Plan
    before: Table
    after: Table
    wanted: Table
    tried: Mapping[str, float]
    reason: str


def next_flight(
    card: Card,
    space: Space,
    belief: Belief,
    duration: float,
    *,
    design: str | None = None,
    axes: Sequence[str] | None = None,
    frozen: Sequence[str] = (),
    amplitude: float | None = None,
    open_loop: bool = False,
    seed: int = 0,
    progress: Progress | None = None,
) -> NextFlight:
    """Proposes the flight that most reduces the standard errors that are largest compared with their targets.

    Among x with y, z and yaw it takes the group with the largest ratio of error to target; among the designs the one
    with the best result; and no more of the duration than the targets need.

    Args:
        card: Card of the model.
        space: Fence and limits.
        belief: From the model.
        duration: Largest duration [s].
        design: Requested by the user; None compares `TRIED`.
        axes: Requested by the user; None chooses.
        frozen: Axes whose pose was frozen in the flights of the model: chosen only by the user.
        amplitude: As for `plan_flight`.
        open_loop: As for `plan_flight`.
        seed: As for `plan_flight`.
        progress: Called with a fraction and a text; raising in it cancels.

    Raises:
        PlanError: As `plan_flight`; none of the designs stays in the space; all axes are frozen.
    """
    wanted = wanted_errors(belief)
    before = np.sqrt(np.diag(belief.covariance))
    free = [axis for axis in card.command if axis not in frozen]
    if not axes and not free:
        raise PlanError(f"{', '.join(frozen)}: {MEND}; --axes plans for them all the same")
    group = tuple(axes) if axes else worst_group(before / wanted, free)
    designs = (design,) if design else TRIED
    plans, errors, left, refused = {}, {}, {}, []
    shared = Fleets(belief_from_mapping(belief_mapping(belief), "the next flight"), duration, seed)

    def plan(name: str, length: float, part: Progress | None) -> tuple[Plan, Array]:
        """The flight of a design, and the standard errors with it added to the belief."""
        flight, information = plan_with_information(
            card, space, name, group, length, belief,
            amplitude=amplitude, open_loop=open_loop, seed=seed, progress=part,
            fleets=shared if length == duration else None,
        )  # fmt: skip
        return flight, errors_after(information, belief)

    for place, name in enumerate(designs):
        try:
            plans[name], errors[name] = plan(name, duration, part_of(progress, place, len(designs) + 1))
        except PlanError as error:
            refused.append(error)
            continue
        left[name] = _left(errors[name], wanted, group)
    if not plans:
        raise PlanError(f"{refused[0]}; {', '.join(frozen)}: {MEND}") if frozen else refused[0]
    best = min(left, key=lambda name: left[name])
    chosen, after = plans[best], errors[best]
    shorter = _enough(chosen, after, wanted, group)
    if shorter < duration:
        chosen, after = plan(best, shorter, part_of(progress, len(designs), len(designs) + 1))
    return NextFlight(
        plan=chosen,
        before=_table(before),
        after=_table(after),
        wanted=_table(wanted),
        tried=left,
        reason=_reason(before / wanted, group, () if axes else free, axes is not None),
    )


def wanted_errors(belief: Belief) -> Array:
    """Target standard errors of the twelve coefficients, shape (12,)."""
    scale = np.abs(belief.coefficients.reshape(4, 3)) * np.array([*WANTED[:2], 0.0])
    scale[:, 2] = WANTED[2]
    return np.asarray(scale.ravel())


def worst_group(ratio: Array, commanded: Sequence[str]) -> tuple[str, ...]:
    """Among x with y, z and yaw, if commanded, the axes with the largest ratio of error to target, ratio (12,)."""
    groups = [group for each in TOGETHER if (group := tuple(axis for axis in each if axis in commanded))]
    return max(groups, key=lambda group: max(ratio[3 * AXES.index(axis) + i] for axis in group for i in range(3)))


def errors_after(information: Array, belief: Belief) -> Array:
    """Standard errors of the twelve coefficients with a flight's `informations` added to the belief, shape (12,).

    The ratio of the model's errors to those of the planned law stays as it is: what its intervals cover besides, other
    laws above all, does not go away with more data under that law.
    """
    wider = np.outer(belief.widening, belief.widening)
    out = precision_of(information / wider, inverse_of(belief.covariance))
    return np.array([out.stderr[axis][name] for axis in AXES for name in COEFFICIENTS])


def _left(errors: Array, wanted: Array, axes: Sequence[str]) -> float:
    rows = (errors / wanted).reshape(4, 3)[[AXES.index(axis) for axis in axes]]
    return float(np.sqrt(np.mean(rows**2)))


def _enough(plan: Plan, after: Array, wanted: Array, axes: Sequence[str]) -> float:
    """Duration that reaches the targets on all axes, in steps of 10 s, as information grows with time [s]."""
    rows = (after / wanted).reshape(4, 3)[[AXES.index(axis) for axis in axes]]
    needed = 10 * np.ceil(plan.duration * float(rows.max()) ** 2 / 10)
    return float(min(max(needed, LEAST), plan.duration))


def _reason(ratio: Array, group: Sequence[str], free: Sequence[str], named: bool) -> str:
    """Why these axes: the worst known of them, and which of the others miss targets, too."""
    rows = {axis: ratio[3 * AXES.index(axis) : 3 * AXES.index(axis) + 3] for axis in (*group, *free)}
    axis = max(group, key=lambda each: float(rows[each].max()))
    name, times = COEFFICIENTS[int(np.argmax(rows[axis]))], float(rows[axis].max())
    if named:
        chosen = f"the {'axis' if len(group) == 1 else 'axes'} asked for"
    else:
        chosen = "the worst known axis" if len(group) == 1 else f"flown together, {axis} is the worst known axis"
    met = f"; {'their' if named else 'all'} targets are met, so no further flight is needed" if times <= 1 else ""
    more = [each for each in free if each not in group and float(rows[each].max()) > 1]
    too = f"; {', '.join(more)}: targets are missed, too, --axes plans for them" if more else ""
    return (
        f"{', '.join(group)}: {chosen}; the standard error of the {name} of {axis} is {times:.2g} times the "
        f"target{met}{too}"
    )


def _table(errors: Array) -> dict[str, dict[str, float]]:
    return {
        axis: {name: float(errors[3 * a + i]) for i, name in enumerate(COEFFICIENTS)} for a, axis in enumerate(AXES)
    }
