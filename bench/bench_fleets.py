"""Several flights of one vehicle that differ: do the intervals hold, and is the law left alone?

    python bench/bench_fleets.py [SPREAD FLIGHTS SETS]...        (default: 0 4 50  1 4 50  3 4 50  3 12 24)

Flights of 16 s, each of which obeys its law (z and yaw of the paper's vehicle, random commands, wind),
are fitted together by `first_order_delay`. From flight to flight the logarithms of input and damping and the delay of
an axis vary normally by SPREAD standard errors of one flight (`ERRORS`). Listed are the shares of `ci95` that hold the
vehicle's mean and of `spread.next_flight` that hold one more flight, the median of the width of `ci95` over that of
`ci95_flight`, how many axes have evidence against the law, and how many coefficients are `refuted`. Seed: of the set.
"""

import argparse
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from rotorfit.core.flight_data import Flight
from rotorfit.core.model import COEFFICIENTS
from rotorfit.estimation.fitting import fit
from rotorfit.files.cards import load_card
from rotorfit.flights.assemble import flight_from_log
from rotorfit.simulation.paper_vehicle import GAMMA_B, Truth, as_log, simulate_flight

DURATION, SIZE, DELAY = 16.0, 0.4, 0.15
"""Length of a flight [s], largest command, and mean delay [s]."""

ERRORS = {"z": (0.023, 0.055, 0.0028), "yaw": (0.018, 0.033, 0.0024)}
"""Typical standard errors of one such flight: of the logarithms of input and damping, and of the delay [s]."""


@dataclass(frozen=True)
class Held:
    """One coefficient of a set: whether its intervals hold, their ratio of widths, and whether it was refuted."""

    vehicle: bool
    following: bool
    wider: float
    refuted: bool


def truth_of(spread: float, rng: np.random.Generator) -> Truth:
    """The vehicle on one flight."""
    gamma, delay = list(GAMMA_B), [DELAY] * 4
    for k, errors in ((2, ERRORS["z"]), (3, ERRORS["yaw"])):
        off = spread * np.array(errors) * rng.standard_normal(3)
        gamma[2 * k], gamma[2 * k + 1] = np.array(gamma[2 * k : 2 * k + 2]) * np.exp(off[:2])
        delay[k] += off[2]
    return Truth(
        gamma=tuple(gamma),
        delay=(delay[0], delay[1], delay[2], delay[3]),
        trim=(0.0, 0.0, 0.03, 0.03),
        wind_sigma=(0.05, 0.05, 0.1, 0.1),
        stale_share=0.0,
        pose_rate=60.0,
        command_rate=20.0,
    )


def flown(truth: Truth, seed: int) -> Flight:
    """A flight under commands of z and yaw that change at random every 0.5 to 1.5 s."""
    rng = np.random.default_rng([seed, 1])
    switch = np.cumsum(rng.uniform(0.5, 1.5, 40))
    level = rng.uniform(-SIZE, SIZE, (41, 4)) * [0.0, 0.0, 1.0, 1.0]
    flight = simulate_flight(truth, lambda t: level[np.searchsorted(switch, t)], DURATION, seed)
    return flight_from_log(as_log(flight), load_card("rotorfit-demo"))


def of_set(spread: float, count: int, seed: int) -> tuple[list[Held], int]:
    """What the fit of a set of flights says of each coefficient; and how many axes have evidence against the law."""
    rng = np.random.default_rng(seed)
    flights = [flown(truth_of(spread, rng), 1000 * seed + j) for j in range(count)]
    following = truth_of(spread, rng)
    model = fit(flights, axes=("z", "yaw"), structure="first_order_delay").model
    held = []
    for k, name in ((2, "z"), (3, "yaw")):
        axis = model.axes[name]
        means, others = (
            (*one.gamma[2 * k : 2 * k + 2], one.delay[k]) for one in (Truth(delay=(DELAY,) * 4), following)
        )
        for part, mean, other in zip(COEFFICIENTS, means, others, strict=True):
            ends, next_ends = axis.ci95[part], axis.spread[part].next_flight
            held.append(
                Held(
                    _holds(ends, mean),
                    _holds(next_ends, other),
                    _width(part, ends) / _width(part, axis.ci95_flight[part]),
                    axis.status[part] == "refuted",
                )
            )
    return held, sum(bool(model.axes[name].evidence) for name in ("z", "yaw"))


def _holds(ends: tuple[float | None, float | None], value: float) -> bool:
    low, high = ends
    return (low is None or low <= value) and (high is None or value <= high)


def _width(part: str, ends: tuple[float | None, float | None]) -> float:
    low, high = (np.nan if end is None else end for end in ends)
    return float(high - low if part == "delay" else np.log(high / low))


def rows(asked: list[float]) -> Iterator[tuple[float, int, int]]:
    """Spread, flights and sets, as they were asked for."""
    for place in range(0, len(asked), 3):
        spread, flights, sets = asked[place : place + 3]
        yield spread, int(flights), int(sets)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("asked", type=float, nargs="*", default=[0, 4, 50, 1, 4, 50, 3, 4, 50, 3, 12, 24])
    print("| spread | flights | the vehicle holds | the next flight | width | axes with evidence | refuted |")
    print("|---|---|---|---|---|---|---|")
    for spread, flights, sets in rows(parser.parse_args().asked):
        found = [of_set(spread, flights, seed) for seed in range(sets)]
        held = [one for each, _ in found for one in each]
        vehicle, following = (100 * np.mean([getattr(one, name) for one in held]) for name in ("vehicle", "following"))
        wider, refuted = np.nanmedian([one.wider for one in held]), sum(one.refuted for one in held)
        against = sum(axes for _, axes in found)
        print(
            f"| {spread:g} | {flights} | {vehicle:.0f} % of {len(held)} | {following:.0f} % | {wider:.2f} | "
            f"{against} of {2 * sets} | {refuted} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
