"""Flights whose clocks only the answer to their commands relates -> the same flights, answering equally late.

Such a flight is placed to 0.3 s when it is read. One flight needs no more: its delay takes what is left. Of several
flights, or a flight and a model, the delays would differ by that and be taken for a vehicle that changed. So the
commands of a flight, those of all axes by one time, are moved to where its likelihood is highest under the coefficients
that it shares with the others.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rotorfit.core.flight_data import Flight, Note
from rotorfit.core.frames import Array
from rotorfit.core.laws import DELAY_RANGE, FIRST_ORDER_DELAY
from rotorfit.estimation.likelihood.axis_estimate import Estimate
from rotorfit.estimation.likelihood.blocks import Record, record
from rotorfit.estimation.likelihood.fisher_scoring import Optimum, maximise
from rotorfit.estimation.likelihood.likelihood import inverted
from rotorfit.estimation.likelihood.optima import start_point
from rotorfit.estimation.likelihood.parameters import Point
from rotorfit.flights.clocks.placement import with_later_commands

MOST_ROUNDS = 8
"""Largest number of moves of a flight."""

COARSE = np.array(sorted(np.linspace(-0.6, 0.6, 25), key=abs))
"""Moves among which the likeliest is where the fine ones begin [s], the smallest first: the delay of a model may lie
anywhere in the range of the search."""

FARTHEST = 0.5
"""Move of one of several flights beyond which none is moved [s]: no flight is read as far off."""

LEAST_SHARE = 1e-6
"""Share of the information on a move that must remain when the common coefficients follow."""

PLACED = 1e-4
"""Move that is not worth another [s]: moves converge by squares."""


def placed_alike(
    flights: Sequence[Flight], estimates: Callable[[Sequence[Flight]], Mapping[str, Estimate]]
) -> list[Flight]:
    """Flights that answer equally late, if their clocks do not tell their delays; their mean placement stays.

    Args:
        flights: Flights of one vehicle, as `check_clocks` lets them pass.
        estimates: The estimates of flights together.
    """
    by, moved = np.zeros(len(flights)), list(flights)
    if len(flights) < 2 or not answer_placed(flights):
        return moved
    for _ in range(MOST_ROUNDS):
        late = _latenesses(moved, {id(one.optimum): one for one in estimates(moved).values()}.values())
        if np.abs(late).max() < PLACED:
            break
        by += late
        if np.abs(by).max() > FARTHEST:
            text = (
                f"no move up to {FARTHEST:g} s makes the flights answer alike: the commands stay where they were placed"
            )
            return [replace(one, notes=(*one.notes, Note("clocks_placed", text, 0))) for one in flights]
        moved = [with_later_commands(one, d, "those of the other flights") for one, d in zip(flights, by, strict=True)]
    return moved


def placed_by(flight: Flight, expected: Callable[[Flight], Iterable[tuple[Record, Point]]]) -> Flight:
    """The flight, moved to where it answers when expected.

    Args:
        flight: The flight.
        expected: Its axes, or x with y, as moved, and their parameters as expected; trims, start velocities and levels
            are the flight's own.
    """
    known = list(expected(flight))
    by = max(map(float, COARSE), key=lambda late: sum(_likelihood(rec, point, late) for rec, point in known))
    moved = with_later_commands(flight, by, "the model says") if by else flight
    for _ in range(MOST_ROUNDS):
        told = [_told(rec, point) for rec, point in expected(moved)]
        power = sum(one.information[-1, -1] for one in told)
        late = float(sum(one.gradient[-1] for one in told) / power) if power else 0.0
        if abs(late) < PLACED:
            break
        by += late
        moved = with_later_commands(flight, by, "the model says")
    return moved


def _likelihood(rec: Record, point: Point, late: float) -> float:
    """Log-likelihood of a flight that answers later than expected [s]; none where the delay leaves its range."""
    delay = point.delay + late
    if delay.min() < DELAY_RANGE[0] or delay.max() > DELAY_RANGE[1]:
        return -np.inf
    return with_own(rec, replace(point, delay=delay), ()).score.log_likelihood


def answer_placed(flights: Sequence[Flight]) -> bool:
    """Whether only the answers to the commands of these flights relate their clocks."""
    return all(flight.clocks is not None and flight.clocks.includes_delay for flight in flights)


def delays(rec: Record, point: Point) -> list[int]:
    """Places of the delays that commands of a flight tell, among its parameters."""
    laws = point.structures or (FIRST_ORDER_DELAY,) * point.gain.size
    told = np.ptp(rec.command, axis=0) * point.gain != 0
    return [point.place("delay", k) for k, law in enumerate(laws) if law.delayed and told[k]]


def with_own(rec: Record, point: Point, places: Sequence[int], levels: bool = True) -> Optimum:
    """A flight at given coefficients, with its own trim and start; with its own levels and further parameters likewise.

    Args:
        rec: The flight.
        point: The coefficients, and where the climb starts.
        places: The coefficients that are its own, too.
        levels: Whether the disturbance levels are.
    """
    free = np.zeros(point.flat().size, bool)
    free[point.coefficients : None if levels else point.n] = True
    free[list(places)] = True
    return maximise([rec], point, free)


@dataclass(frozen=True)
class _Told:
    """What a flight tells of the coefficients and, in the last place, of a delay more of all its axes.

    Attributes:
        gradient: Of its log-likelihood, shape (C + 1,).
        information: About both, without what its own trim, start and levels take, shape (C + 1, C + 1).
    """

    gradient: Array
    information: Array


def _told(rec: Record, point: Point) -> _Told:
    """What a flight tells at given coefficients."""
    best = with_own(rec, point, ())
    C, information = point.coefficients, best.score.information
    taken = information[:C, C:] @ inverted(information, best.free)[C:, C:] @ information[C:, :C]
    turn = np.vstack([np.eye(C), np.isin(np.arange(C), delays(rec, point))])
    return _Told(turn @ best.score.gradient[:C], turn @ (information[:C, :C] - taken) @ turn.T)


def _latenesses(flights: Sequence[Flight], estimates: Iterable[Estimate]) -> Array:
    """By how much each flight answers later than the others, while their common coefficients follow, shape (F,) [s].

    Their mean, which common delays follow, is zero; so is what no other flight tells.
    """
    F = len(flights)
    gradient, information, alone = np.zeros(F), np.zeros((F, F)), np.zeros(F)
    for one in estimates:
        axes, point = one.records[0].axes, one.optimum.point
        told = {f: _told(*known) for f, flight in enumerate(flights) if (known := _expected(flight, axes, point))}
        if not told:
            continue
        for f, own in told.items():
            gradient[f] += own.gradient[-1]
            information[f, f] += own.information[-1, -1]
            alone[f] += own.information[-1, -1]
        beside = np.zeros((point.coefficients, F))
        beside[:, list(told)] = np.transpose([own.information[:-1, -1] for own in told.values()])
        common = sum(own.information[:-1, :-1] for own in told.values())
        followed = beside.T @ np.linalg.pinv(common, hermitian=True)
        gradient -= followed @ sum(own.gradient[:-1] for own in told.values())
        information -= followed @ beside
    scale = np.sqrt(np.where(alone > 0, alone, 1.0))
    share, along = np.linalg.eigh(information / np.outer(scale, scale))
    sure = share > LEAST_SHARE
    late: Array = along[:, sure] / share[sure] @ (along[:, sure].T @ (gradient / scale)) / scale
    return np.asarray(np.where(alone > 0, late - late[alone > 0].mean(), 0.0) if np.any(alone > 0) else late)


def _expected(flight: Flight, axes: tuple[str, ...], point: Point) -> tuple[Record, Point] | None:
    """The axes of a flight at common coefficients, by poses alone where there are some; None if it commands none."""
    rec = record(flight if flight.velocity_only else replace(flight, velocity=None), axes)
    if rec is None or not set(axes) & set(flight.moved):
        return None
    own = start_point([rec], 0.0, 1.0, point.levels[:, :4])
    return rec, replace(point, trim=own.trim, start=own.start, levels=own.levels, measured=own.measured)
