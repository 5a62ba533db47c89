"""What a change is called: by which coefficients move together, and which stay."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from rotorfit.core.tracked import Alarm
from rotorfit.tracking.alarms import sizes, with_sizes
from rotorfit.tracking.causes import Diagnosis, _intervals, diagnosis
from rotorfit.tracking.changes import Contrast
from rotorfit.tracking.scores import EXPECTED, Scores

KNOWN = ("x.input", "x.damping", "x.delay"), ("y.input", "y.damping", "y.delay"), (
    "z.input", "z.damping", "z.delay", "z.trim",
), ("yaw.input", "yaw.damping", "yaw.delay", "yaw.trim")  # fmt: skip


def shifted(moved: Mapping[str, float], sharp: float = 400.0, freedom: float = 40.0) -> list[tuple[Scores, Contrast]]:
    """Shifts by logarithms, seconds or accelerations, each known to 1/20 of what is looked for."""
    parts = []
    for names in KNOWN:
        scale = np.array([EXPECTED[name.split(".")[1]] for name in names])
        shift = np.array([moved.get(name, 0.0) for name in names]) / scale
        empty = {"time": np.empty(0), "innovation": np.empty(0), "free": np.empty((0, 0)), "names": names}
        fields = {**empty, "tested": np.empty((0, len(names))), "scale": scale, "doubt": np.zeros(len(names))}
        missing = {name: np.empty((0, 0)) for name in Scores.__dataclass_fields__ if name not in fields}
        scores = Scores(**fields, **missing)  # type: ignore[arg-type]
        precision = sharp * np.eye(len(names))
        parts.append(
            (scores, Contrast(10.0, shift, precision, float(shift @ precision @ shift), len(names), 1e-9, freedom))
        )
    return parts


def named(moved: Mapping[str, float], sharp: float = 400.0, freedom: float = 40.0) -> Diagnosis:
    """The diagnosis of such shifts."""
    return diagnosis(shifted(moved, sharp, freedom))


@pytest.mark.parametrize(
    ("moved", "cause", "axes"),
    [
        ({"z.trim": -1.2}, "payload", ("z",)),
        ({"z.trim": -0.6, "yaw.trim": 1.5}, "thrust", ("z", "yaw")),
        ({f"{axis}.delay": 0.05 for axis in ("x", "y", "z", "yaw")}, "delay", ("x", "y", "z", "yaw")),
        ({"x.input": 0.4, "y.input": 0.4}, "limits", ("x", "y")),
        ({"x.damping": 0.6, "x.delay": -0.06}, "other", ("x",)),
        ({"x.damping": 0.6, "y.delay": -0.06}, "other", ("x", "y")),
    ],
)
def test_a_cause_is_named_by_what_moves_together(moved: dict[str, float], cause: str, axes: tuple[str, ...]) -> None:
    found = named(moved)

    assert found.cause == cause
    assert found.axes == axes
    assert found.confidence > 0.8
    for name, value in moved.items():
        low, high = found.change[name]
        added = name.endswith((".delay", ".trim"))
        expected = value if added else 1 + value if name.endswith(".input") else np.exp(value)
        assert low < expected < high


def test_a_weak_rotor_also_tilts_the_vehicle_which_is_no_change_of_x_and_y() -> None:
    tilt = {"x.input": 0.3, "x.delay": -0.03, "y.input": -0.2, "y.damping": 0.5}
    found = named({"z.trim": -0.6, "yaw.trim": 1.5, **tilt})

    assert (found.cause, found.axes) == ("thrust", ("z", "yaw"))
    assert found.change.keys() == {"z.trim", "yaw.trim"}


@pytest.mark.parametrize("name", ["yaw.delay", "x.input", "z.delay"])
def test_a_coefficient_that_moves_by_chance_does_not_hide_the_cause(name: str) -> None:
    chance = 2.5 / 20 * EXPECTED[name.split(".")[1]]  # standard errors
    found = named({"z.trim": -1.2, name: chance})

    assert (found.cause, found.axes) == ("payload", ("z",))
    assert found.confidence > 0.5


def test_the_fewer_seconds_tell_the_variance_the_less_certain_is_a_cause() -> None:
    moved = {"z.trim": -0.6, "yaw.trim": 0.2}
    many, few = (named(moved, freedom=freedom).confidence for freedom in (40.0, 8.0))

    assert few < many


def test_what_is_told_badly_is_named_with_little_confidence() -> None:
    assert named({"z.trim": -0.3, "yaw.trim": 0.3}, sharp=4.0).confidence < 0.8


def test_an_alarm_as_json_has_the_promised_keys() -> None:
    alarm = Alarm(41.3, ("x", "y"), "limits", (38.9, 40.2), {"x.input": (0.78, 0.86)}, 0.9, 1e-8, "because")

    told = alarm.to_mapping()
    assert list(told)[:7] == ["type", "time", "axes", "cause", "since", "change", "confidence"]
    assert told["type"] == "alarm"
    assert told["change"] == {"x.input": [0.78, 0.86]}
    assert told["revises"] is None


def test_what_may_be_zero_is_told_by_its_difference() -> None:
    """A zero, an asymmetry or an input across the axes has no ratio; a lag has one, but after another vehicle none."""
    size, change = np.array([-0.4, 0.3, 0.1, 0.1]), ("z.zero", "z.asymmetry", "z.lag", "z.delay")
    told = _intervals(change, size, np.full(4, 1e-3), np.full(4, 0.5))
    alarm = Alarm(41.3, ("z",), "other", (38.9, 40.2), told, 0.9, 1e-8, "because")

    assert told["z.zero"] == pytest.approx((-0.2, -0.2), abs=0.01)
    assert told["z.asymmetry"] == pytest.approx((0.15, 0.15), abs=0.01)
    assert told["z.lag"] == pytest.approx((np.exp(0.05),) * 2, abs=0.01)
    assert [alarm.is_ratio(name) for name in change] == [False, False, True, False]
    assert [alarm.unit(name) for name in change] == ["s", "", "", "s"]
    another = replace(alarm, cause="another_vehicle")
    assert (another.is_ratio("z.lag"), another.unit("z.lag")) == (False, "s")


def test_what_hardly_moved_since_a_change_has_no_part_in_it() -> None:
    """Rounding, divided by rounding, gave an input of which nothing was commanded a ratio of -1e11."""
    (scores, y), *rest = shifted({"z.trim": -1.2})[1:]
    precision = np.diag([1e-24, 400.0, 400.0])
    found = diagnosis([(scores, replace(y, shift=np.array([-5e11, 0.0, 0.0]), precision=precision)), *rest])

    assert (found.cause, found.axes) == ("payload", ("z",))


def test_a_size_that_the_flight_does_not_tell_is_left_out_and_said() -> None:
    found = named({"x.input": 0.4, "y.input": 0.4}, sharp=0.03)
    other = replace(found, cause="other", shifted=(), change={"x.input": (-0.2, 3.0)})
    alarm = Alarm(41.3, ("x", "y"), "limits", (38.9, 40.2), {}, 0.9, 1e-8, "because")

    assert found.shifted
    assert not found.change
    assert sizes(other, {}, (38.9, 40.2), 39.0) == {}
    assert with_sizes(alarm, replace(found, shifted=("x.input", "y.input")), {"x.input": (1.2, 1.4)}, 40.3).why == (
        "because; by how much y.input changed, the flight does not tell"
    )


def test_the_evidence_of_all_instants_counts_not_that_of_the_likeliest_alone() -> None:
    """At one instant a push of z explains a little more than one factor on all gains does at each of the others."""
    pushed = shifted({"z.trim": 1.22}, 10.0)
    fallen = shifted({f"{axis}.input": -0.3 for axis in ("x", "y", "z", "yaw")}, 10.0)

    assert diagnosis(pushed, fallen).cause == "payload"
    assert diagnosis(pushed, *[fallen] * 3).cause == "limits"
    assert diagnosis(pushed, *[fallen] * 3).confidence < diagnosis(fallen).confidence
