"""Tests of the flights that stand out: seed of each flight beside it."""

from dataclasses import replace

import numpy as np
import pytest

from flights import flown, steps
from rotorfit.assessment.advice import findings_of_fit
from rotorfit.core.finding import Finding
from rotorfit.core.flight_data import Flight
from rotorfit.estimation.fitting import fit
from rotorfit.simulation.paper_vehicle import GAMMA_B, Truth


def flights(axes: tuple[str, ...]) -> list[Flight]:
    return [flown(Truth(), steps(axes, seed=seed), 25.0, seed) for seed in (30, 31, 32, 33)]


def told(flights: list[Flight], axes: tuple[str, ...]) -> dict[tuple[str, str | None], Finding]:
    known = fit(flights, axes=axes, structure="first_order_delay")
    return {(one.code, one.axis): one for one in findings_of_fit(known)}


def scaled(flight: Flight, factor: float, path: str = "other.csv") -> Flight:
    """The flight with its z command times a factor."""
    return replace(flight, path=path, command=flight.command * np.array([1.0, 1.0, factor, 1.0]))


def test_flights_that_are_alike_have_none_of_the_findings() -> None:
    found = told(flights(("z", "yaw")), ("z", "yaw"))

    assert not {code for code, _ in found} & {"sign_flipped", "flights_disagree"}


@pytest.mark.parametrize("turned", [(3,), (2, 3), (1, 2, 3)])
def test_flights_whose_command_has_the_other_sign_are_named(turned: tuple[int, ...]) -> None:
    """Also where all together have no gain, or the wrong one."""
    whole = [scaled(one, -1.0 if i in turned else 1.0, f"{i}.csv") for i, one in enumerate(flights(("z",)))]
    found = told(whole, ("z",))

    assert {axis for code, axis in found if code in ("not_excited", "weak_excitation", "flights_disagree")} == set()
    assert found["sign_flipped", "z"].severity == "error"
    backwards, forwards = found["sign_flipped", "z"].evidence.split(" and forwards in ")
    assert all((f"{i}.csv" in backwards) == (i in turned) != (f"{i}.csv" in forwards) for i in range(4))


def test_one_of_two_flights_whose_command_has_the_other_sign_is_told() -> None:
    first, second, *_ = flights(("z",))
    found = told([first, scaled(second, -1.0)], ("z",))

    assert "backwards in other.csv (-1.1" in found["sign_flipped", "z"].evidence


def test_a_flight_in_another_unit_is_told_as_that() -> None:
    """Commands that are logged six times as large as they were look like a sixth of the gain."""
    *alike, _ = flights(("z",))
    weak = Truth(gamma=(*GAMMA_B[:4], GAMMA_B[4] / 6, *GAMMA_B[5:]))
    found = told([*alike, flown(weak, steps(("z",), seed=34), 25.0, 34)], ("z",))["flights_disagree", "z"]

    assert "stands out" in found.evidence
    assert found.remedy.startswith("compare units and scales")


def test_flights_that_only_seem_to_hold_an_axis_beside_one_in_another_unit_are_named() -> None:
    *alike, last = flights(("z",))
    found = told([*alike, scaled(last, 100.0)], ("z",))["card_differs", "z"]

    assert found.severity == "error"
    assert found.evidence.startswith("a command of z moves simulated-")
    assert "101 times as far as other.csv: the one or the other is in another unit" in found.evidence
    assert "z was fitted to other.csv alone" in found.effect


def test_a_flight_whose_answers_are_late_on_all_axes_is_told_as_one_of_another_clock() -> None:
    *alike, last = flights(("z", "yaw"))
    late = replace(last, path="other.csv", command_time=last.command_time - 0.15)
    found = told([*alike, late], ("z", "yaw"))

    for axis in ("z", "yaw"):
        assert "the answers of z and yaw of other.csv come 0.15 s later alike" in found["flights_disagree", axis].remedy
