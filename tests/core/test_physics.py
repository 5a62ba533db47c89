"""Physics of a model: values, intervals, expectations, reasons; in the file, on the terminal, in the report."""

import json
import math
from dataclasses import replace

import pytest
from rich.console import Console

from flights import fit_as_flown, flown, steps
from models import VEHICLE, demo_card, model_of, without
from rotorfit.app.terminal.coefficients import model_view
from rotorfit.assessment.case import Case
from rotorfit.assessment.evidence import evidence_of
from rotorfit.core.frames import AXES
from rotorfit.core.limits import Figure, Quantity
from rotorfit.core.model import Model
from rotorfit.core.physics import QUANTITIES, compared, implied_limits, physics, physics_rows
from rotorfit.files.models import from_mapping, to_mapping
from rotorfit.reporting.page import page
from rotorfit.reporting.tables import physics_text
from rotorfit.simulation.paper_vehicle import GAMMA_B, Truth


def ends(figure: Figure | None) -> tuple[float, float]:
    assert figure is not None
    low, high = figure.ci95
    assert low is not None
    assert high is not None
    return low, high


# Values


def test_of_a_tilt_the_acceleration_is_compared_with_g_tan_of_the_limit() -> None:
    model = model_of()
    found = physics(model)["x"]["acceleration"]
    expected = 9.81 * math.tan(math.radians(20))

    assert found.measured == Figure(model.axes["x"].input, model.axes["x"].ci95["input"])
    assert (found.unit, found.reason) == ("m/s^2", None)
    assert found.expected == pytest.approx(expected)
    assert ends(found.ratio) == pytest.approx([end / expected for end in ends(found.measured)])
    implied = [math.degrees(end) for end in ends(found.implied_limit)]
    assert implied == pytest.approx([math.degrees(math.atan(end / 9.81)) for end in ends(found.measured)])
    assert physics(model)["x"]["steady_speed"].expected is None


@pytest.mark.parametrize(("axis", "limit"), [("z", 1.2), ("yaw", math.radians(100))])
def test_of_a_speed_and_a_rate_the_steady_one_is_compared_with_the_limit(axis: str, limit: float) -> None:
    model = model_of()
    found = physics(model)[axis]["steady_speed"]
    g, b, _ = VEHICLE[axis]

    assert found.expected == pytest.approx(limit)
    assert found.ratio is not None
    assert found.ratio.value == pytest.approx(g / b / limit)
    assert ends(found.measured) == model.axes[axis].combinations["steady_gain"].ci95
    assert found.implied_limit == found.measured
    assert compared(model, axis) == found


def test_times_are_one_over_the_damping_and_the_total_lag_with_their_intervals() -> None:
    axis = model_of().axes["z"]
    found = physics(model_of())["z"]
    low, high = (1 / end for end in axis.ci95["damping"] if end)

    assert found["time_constant"].measured == Figure(1 / VEHICLE["z"][1], (high, low))
    lag = axis.combinations["total_lag"]
    assert found["total_lag"].measured == Figure(lag.value, lag.ci95)
    assert {found[name].unit for name in ("time_constant", "total_lag")} == {"s"}


def test_commands_in_radians_and_metres_per_second_have_expectations_of_their_own() -> None:
    card = demo_card("", x="{ from = 'a', meaning = 'tilt', unit = 'deg' }", y="{ from = 'b', unit = 'm/s' }",
                     z="{ from = 'c', meaning = 'vertical_speed' }")  # fmt: skip
    found = physics(model_of({"x": (9.0, 0.5, 0.2), "y": (2.2, 2.0, 0.2), "z": (4.0, 4.0, 0.1)}, card))

    assert found["x"]["acceleration"].expected == 9.81
    assert found["x"]["acceleration"].unit == "m/s^2 per rad"
    assert found["x"]["acceleration"].implied_limit is None
    for axis, ratio in (("y", 1.1), ("z", 1.0)):
        part = found[axis]["steady_speed"]
        assert part.expected == 1.0
        assert part.ratio is not None
        assert part.ratio.value == pytest.approx(ratio)
        assert part.unit == "m/s per m/s"


# What is not known


def test_limits_that_the_card_does_not_give_are_told_from_the_gain() -> None:
    model = model_of(card=demo_card(""))
    found = physics(model)["x"]["acceleration"]

    assert (found.expected, found.ratio) == (None, None)
    assert "what tilt was set" in (found.reason or "")
    assert found.implied_limit is not None
    first, *others = implied_limits(model)
    assert first.startswith("x: equals a tilt limit of 20.7 deg (19.9 to 21.4)")
    assert [line.partition(":")[0] for line in others] == ["y", "z", "yaw"]
    assert implied_limits(model_of()) == ()


def test_without_a_meaning_only_the_times_are_physics() -> None:
    model = model_of(card=demo_card(x="'c:x'"))
    found = physics(model)["x"]

    for name in ("acceleration", "steady_speed"):
        assert found[name].measured is None
        assert "give the channel a meaning" in (found[name].reason or "")
    assert found["time_constant"].measured is not None
    assert "x" not in {row.axis for row in physics_rows(model)}


def test_an_axis_without_numbers_says_why() -> None:
    found = physics(model_of({"x": VEHICLE["x"]}))["z"]

    assert set(found) == set(QUANTITIES)
    assert {part.measured for part in found.values()} == {None}
    assert all("not_excited" in (part.reason or "") for part in found.values())


def test_a_number_that_is_not_identifiable_keeps_its_interval_and_its_open_end() -> None:
    found = physics(without(model_of(), "z", "damping"))["z"]["time_constant"]

    assert found.measured is not None
    assert found.measured.value is None
    assert found.measured.ci95[0] is None
    assert found.measured.ci95[1] == pytest.approx(math.exp(0.04) / VEHICLE["z"][1])
    assert "not_identifiable" in (found.reason or "")


def test_the_papers_model_has_a_steady_speed_without_interval_and_no_time_where_the_damping_is_negative() -> None:
    model = model_of()
    stable, unstable = (replace(model.axes["z"], combinations={}, damping=b) for b in (2.0, -0.4))
    found = [physics(replace(model, axes={**model.axes, "z": axis}))["z"] for axis in (stable, unstable)]

    steady = found[0]["steady_speed"]
    assert steady.measured == Figure(VEHICLE["z"][0] / 2.0)
    assert steady.ratio is not None
    assert steady.ratio.ci95 == (None, None)
    assert found[1]["steady_speed"].measured is None
    assert found[1]["time_constant"].measured is None
    assert "not positive" in (found[1]["time_constant"].reason or "")


# Where it is shown


def file_of(model: Model) -> dict:
    again: dict = json.loads(json.dumps(to_mapping(model), allow_nan=False))
    return again


def test_physics_stands_in_the_file_and_an_older_file_without_it_is_read() -> None:
    model = model_of({"x": VEHICLE["x"], "z": VEHICLE["z"]})
    raw = file_of(model)

    assert set(raw["physics"]) == set(AXES)
    assert set(raw["physics"]["x"]) == set(QUANTITIES)
    assert set(raw["physics"]["x"]["acceleration"]) == set(Quantity.__dataclass_fields__)
    told = raw["physics"]
    del raw["physics"], raw["conversion"]
    older = from_mapping(raw, "test")
    assert older.conversion is None
    assert file_of(older)["physics"] == told


def test_rows_hold_what_is_compared_and_times_with_yaw_in_degrees() -> None:
    rows = physics_rows(model_of())

    assert [(row.axis, row.name, row.unit) for row in rows if row.expected is not None] == [
        ("x", "acceleration", "m/s^2"),
        ("y", "acceleration", "m/s^2"),
        ("z", "steady_speed", "m/s"),
        ("yaw", "steady_speed", "deg/s"),
    ]
    assert [row.expected for row in rows if row.axis == "yaw"] == [pytest.approx(100.0), None]
    assert len(rows) == 8


def test_the_report_prints_values_with_the_digits_that_their_intervals_earn() -> None:
    text = physics_text(*evidence_of([Case("m", model_of({"x": VEHICLE["x"]}))]))

    assert text.rows[0] == ("x", "acceleration", "3.698", "3.550 to 3.846", "m/s^2", "3.57", "1.036 (0.994 to 1.077)")
    assert text.lines == ()
    assert (
        physics_text(*evidence_of([Case("m", model_of(card=demo_card(x="'a'", y="'b'", z="'c'", yaw="'d'")))])).rows
        == ()
    )
    assert len(physics_text(*evidence_of([Case("m", model_of(card=demo_card("")))])).lines) == 4


def shown(model: Model, width: int = 80) -> str:
    """What the terminal shows of the model, so wide."""
    console = Console(width=width, markup=False, highlight=False)
    with console.capture() as captured:
        for part in model_view(model, AXES):
            console.print(part)
    return captured.get()


def test_the_terminal_shows_the_table_in_80_columns_only_where_commands_have_a_meaning() -> None:
    text = shown(model_of())
    narrow, wide = (shown(model_of(card=demo_card("", x="{ from = 'a', unit = 'rad' }")), width) for width in (80, 200))
    table = text.partition("in physics")[2].partition("\n\n")[0]

    assert ["x", "acceleration", "3.70", "3.55", "to", "3.85", "m/s^2", "3.57", "1.04", "(0.99", "to", "1.08)"] in [
        line.split() for line in table.splitlines()
    ]
    assert sum("time constant" in line for line in table.splitlines()) == 4
    tables = [part.partition("in physics")[2].partition("  - ")[0] for part in (narrow, wide)]
    assert tables[0].split() == tables[1].split()
    assert len({len([line for line in part.splitlines() if line.strip()]) for part in tables}) == 1
    assert "m/s^2/rad" in wide
    assert "y: equals a tilt limit of 21.4 deg" in wide
    assert "in physics" not in shown(model_of(card=demo_card(x="'a'", y="'b'", z="'c'", yaw="'d'")))


def test_the_report_has_the_table_only_where_commands_have_a_meaning() -> None:
    with_meaning, without_meaning = (
        page(evidence_of([Case("model.json", model_of({"x": VEHICLE["x"]}, card))]))
        for card in (demo_card(""), demo_card(x="'a'", y="'b'", z="'c'", yaw="'d'"))
    )

    assert "In physics" in with_meaning
    assert "x: equals a tilt limit of 20.7 deg (19.9 to 21.4)" in with_meaning
    assert "In physics" not in without_meaning


def test_a_climb_that_follows_its_command_has_the_steady_speed_that_its_card_expects() -> None:
    model = fit_as_flown([flown(Truth(), steps(("z",), 0.4, seed=2), 20.0, 2)], axes=("z",)).model

    ratio = physics(model)["z"]["steady_speed"].ratio
    assert ratio is not None
    assert ratio.value == pytest.approx(GAMMA_B[4] / GAMMA_B[5] / 1.2, rel=0.05)
