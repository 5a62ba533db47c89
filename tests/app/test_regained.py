"""New gains are published as a message and as a file, whole; what is in the file at the start is what is flown."""

import json
import tomllib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import pytest

from models import VEHICLE, next_fit
from rotorfit.app.live.outlets import Remembering
from rotorfit.app.live.regained import Regaining
from rotorfit.control.tuning import tune
from rotorfit.core.errors import LogError, ModelError
from rotorfit.core.finding import Finding
from rotorfit.core.frames import AXES
from rotorfit.core.model import Model
from rotorfit.core.tracked import UNMOVED, Alarm, Tracked, TrackedAxis
from rotorfit.exports.gains import law_of, read_gains, save_gains
from rotorfit.tracking.earlier import Earlier

pytestmark = pytest.mark.flights

CHANGED = Alarm(3.0, ("x",), "limits", (2.0, 2.5), {}, 0.9, 1e-9, "because")


def states(*models: Model, axes: tuple[str, ...] = ("x",), **more: Any) -> list[Tracked]:
    """A state a second, each with a new fit."""
    known = {axis: TrackedAxis("known", "known") for axis in axes}
    return [Tracked(float(5 + k), known, **{"model": model, "findings": (), **more}) for k, model in enumerate(models)]


def told(
    path: Path | None, given: list[Tracked], earlier: Earlier | None = None
) -> tuple[list[Mapping[str, Any]], Regaining]:
    messages: list[Mapping[str, Any]] = []
    regaining = Regaining(path, lambda message, _now: messages.append(message), lambda _kept: None, earlier)
    for state in given:
        regaining.state(state, 0)
    return messages, regaining


def only(axis: str = "x") -> Model:
    return next_fit({axis: VEHICLE[axis]})


def test_gains_are_a_message_with_reasons_and_no_file_unless_it_is_named(tmp_path: Path) -> None:
    (message,), regaining = told(None, states(only(), only(), only()))

    assert list(message)[:4] == ["type", "time", "axes", "why"]
    assert (message["type"], message["time"], message["file"]) == ("gains", 6.0, None)
    assert message["axes"]["x"]["stiffness"] == tune(only()).axes["x"].law.stiffness
    assert "settled" in message["why"]["x"]
    assert regaining.summary == "New gains: x at 6 s."
    assert list(tmp_path.iterdir()) == []


def test_the_file_is_that_of_tune_and_says_when(tmp_path: Path) -> None:
    path = tmp_path / "gains.toml"
    told(path, states(only(), only()))
    held = tomllib.loads(path.read_text())

    assert held["axes"]["x"]["retuned_at"] == 6.0
    assert held["refused"].keys() == {"y", "z", "yaw"}
    assert law_of(read_gains(path), "x") == tune(only()).axes["x"].law


def test_each_axis_without_new_gains_has_its_reason(tmp_path: Path) -> None:
    path = tmp_path / "gains.toml"
    save_gains(tune(only()), only(), path)
    axes = {
        "x": TrackedAxis("known", "known"),
        "y": TrackedAxis("not_identifiable", "not identifiable"),
        "z": TrackedAxis("not_excited", UNMOVED),
        "yaw": TrackedAxis("not_excited", "not excited"),
    }
    given = [replace(state, axes=axes) for state in states(only(), only())]

    assert "; y: not known well enough in this flight; z: not commanded" in told(None, given[:1])[1].summary
    assert "x: its estimate has not settled" in told(None, given[:1])[1].summary
    assert "No new gains. x: the gains in use may stay; y: " in told(path, given)[1].summary
    path.unlink()
    _, regaining = told(path, given)
    assert regaining.summary == f"New gains: x at 6 s. They are in {path}."
    refused = tomllib.loads(path.read_text())["refused"]
    assert refused["z"] == "not commanded in this flight"
    assert refused["yaw"].startswith("not excited in this flight")
    assert told(None, [])[1].summary == "No new gains. Nothing was tracked."


@pytest.mark.parametrize("name", ["gains.toml", pytest.param("gains.yaml", marks=pytest.mark.slow)])
def test_gains_in_the_file_are_flown_and_axes_that_are_not_retuned_stay(name: str, tmp_path: Path) -> None:
    path, model = tmp_path / name, next_fit({axis: VEHICLE[axis] for axis in ("x", "z")})
    save_gains(tune(model, "linearising", rate=25.0), model, path)
    before = read_gains(path)
    assert told(path, states(*(only() for _ in range(3))))[0] == []
    assert read_gains(path) == before

    g, b, tau = VEHICLE["x"]
    (message,), _ = told(path, states(*(next_fit({"x": (1.6 * g, b, tau)}) for _ in range(3))))
    after = read_gains(path)
    assert (message["design"], message["rate"], list(message["axes"])) == ("linearising", 25.0, ["x"])
    assert after["axes"]["z"] == before["axes"]["z"]
    assert after["axes"]["x"]["input"] == pytest.approx(1.6 * g)
    assert (tmp_path / f"{name}~").exists()  # what somebody else wrote is kept


def test_an_alarm_of_the_pose_and_a_landing_change_no_gains() -> None:
    jump = Alarm(3.0, ("x",), "pose_jumped", (2.0, 2.5), {}, 0.9, 1e-9, "because")
    assert len(told(None, [*states(only(), only()), *states(only(), only(), alarms=(jump,))])[0]) == 1
    assert told(None, [*states(only()), *states(only(), landed=True)])[0] == []


def test_after_a_jump_of_the_heading_x_must_settle_anew() -> None:
    jump = Alarm(6.5, AXES, "pose_jumped", (6.3, 6.4), {}, 1.0, 0.0, "because", turned=True)
    g, b, tau = VEHICLE["x"]
    other = [next_fit({"x": (g, b, tau + 0.1)}) for _ in range(3)]
    _, second = told(None, [*states(only(), only()), *states(other[0], alarms=(jump,)), *states(*other[1:])])[0]

    assert second["why"]["x"].startswith("the vehicle has changed")


@pytest.mark.parametrize("code", ["yaw_offset", "mirrored_pose", None])
def test_no_gains_of_x_and_y_come_from_a_wrong_frame(code: str | None) -> None:
    findings = (Finding(code, "warning", "seen", "which does", "do this"),) if code else None
    models = [next_fit({axis: VEHICLE[axis] for axis in ("x", "z")}) for _ in range(2)]
    messages, regaining = told(None, states(*models, axes=("x", "z"), findings=findings))

    assert [list(message["axes"]) for message in messages] == ([] if code == "mirrored_pose" else [["z"]])
    why = (
        f"its numbers are not the vehicle's ({code})" if code else "it is not known yet whether its commands act along"
    )
    assert why in regaining._missing("x")


def test_after_an_alarm_the_vehicle_must_settle_anew() -> None:
    g, b, tau = VEHICLE["x"]
    other = [next_fit({"x": (g, b, tau + 0.1)}) for _ in range(3)]
    given = [*states(only(), only()), *states(other[0], alarms=(CHANGED,)), *states(*other[1:])]
    first, second = told(None, given)[0]

    assert second["why"]["x"].startswith("the vehicle has changed")
    assert first["axes"]["x"]["delay"] + 0.1 == pytest.approx(second["axes"]["x"]["delay"])


OTHER = replace(CHANGED, time=6.5, cause="another_vehicle")


def test_no_axis_takes_gains_from_an_earlier_model_that_another_axis_contradicts() -> None:
    g, b, tau = VEHICLE["x"]
    earlier = Earlier(next_fit({"x": VEHICLE["x"]}, 0.02), "m.json")
    given = states(*(next_fit({"x": (1.1 * g, b, tau)}, 0.2) for _ in range(3)))
    doubted = [replace(one, axes={**one.axes, "z": TrackedAxis(contradicts=("delay",))}) for one in given]
    alarmed = [replace(given[0], alarms=(replace(OTHER, time=4.0, axes=("z",)),)), *given[1:]]
    inputs = [told(None, each, earlier)[0][0]["axes"]["x"]["input"] for each in (given, doubted, alarmed)]

    assert inputs == pytest.approx([g, 1.1 * g, 1.1 * g])
    assert "are from m.json" in told(None, given, earlier)[0][0]["why"]["x"]


@pytest.mark.parametrize("alarm", [replace(CHANGED, time=6.5), OTHER])
def test_gains_of_before_an_alarm_are_told_as_such(alarm: Alarm) -> None:
    flown = states(only(), only())
    (message,), regaining = told(None, [*flown, replace(flown[-1], time=7.0, alarms=(alarm,), model=None)])

    assert message["axes"]["x"]["regime"] == 0
    assert regaining.summary == (
        f"New gains: x at 6 s. Those of x are of before the alarm of 6.5 s ({alarm.named}): its estimate has not "
        "settled: two fits in a row do not agree yet."
    )


def test_a_resumed_one_knows_the_gains_in_use_and_the_changes() -> None:
    g, b, tau = VEHICLE["x"]
    _, before = told(None, states(only(), only()))
    memory = json.loads(json.dumps(before.memory()))
    messages: list[Mapping[str, Any]] = []
    resumed = Regaining(None, lambda message, _now: messages.append(message), lambda _kept: None)
    resumed.recall([replace(CHANGED, time=6.5)], False, memory)
    assert "x at 6 s. Those of x are of before" in resumed.summary
    for state in states(*(next_fit({"x": (g, b, tau + 0.1)}) for _ in range(3))):
        resumed.state(replace(state, time=state.time + 5), 0)

    assert [one["why"]["x"][:23] for one in messages] == ["the vehicle has changed"]
    assert resumed.summary == "New gains: x at 6 s; x at 11 s."


def test_a_resumed_one_says_and_decides_as_if_it_had_never_stopped(tmp_path: Path) -> None:
    """The gains of 6 s are of after the alarm of 3 s, however late it is revised. The pilot's file is the backup."""
    path = tmp_path / "gains.toml"
    save_gains(tune(only()), only(), path)
    own = path.read_text()
    flown = states(*(next_fit({"x": (1.5 * VEHICLE["x"][0], *VEHICLE["x"][1:])}) for _ in range(2)))
    _, before = told(path, [replace(flown[0], alarms=(CHANGED,)), *flown[1:]])
    resumed = told(path, [])[1]
    resumed.recall([replace(CHANGED, time=20.0, revises=3.0)], False, json.loads(json.dumps(before.memory())))

    assert resumed.summary == before.summary == f"New gains: x at 6 s. They are in {path}."
    assert resumed._retuning._anew == before._retuning._anew == set()
    assert (tmp_path / "gains.toml~").read_text() == own
    for state in states(only(), only(), only()):
        resumed.state(replace(state, time=state.time + 20), 0)
    assert len(resumed.published) == 2
    assert (tmp_path / "gains.toml~").read_text() == own


def test_gains_of_an_axis_that_a_revision_named_later_are_of_before_it() -> None:
    """They were made from a fit to both vehicles."""
    flown = states(only(), only())
    first = replace(flown[0], alarms=(replace(CHANGED, axes=("z",)),))
    last = replace(
        flown[-1], time=20.0, alarms=(replace(CHANGED, time=20.0, axes=("x", "z"), revises=3.0),), model=None
    )

    assert "Those of x are of before the alarm of 3.0 s" in told(None, [first, *flown[1:], last])[1].summary


class Followed:
    """A tracker that remembers only that x has changed."""

    changes, another, origin = (replace(CHANGED, time=6.5),), False, 0

    def memory(self) -> dict[str, Any]:
        return {"origin": 0}

    def recall(self, memory: Mapping[str, Any]) -> None:
        """Has nothing to recall."""


@pytest.mark.parametrize("published", [False, True])
def test_what_a_tracker_resumes_from_has_the_gains_and_the_changes(published: bool, tmp_path: Path) -> None:
    path, tracker = tmp_path / "memory", cast(Any, Followed())
    Remembering(path, tracker, told(None, states(only(), only()))[1] if published else None).close()
    resumed = told(None, [])[1]
    again = Remembering(path, tracker, resumed)
    again.close()

    assert again.recalled
    assert again.unrevised == [*Followed.changes]
    assert resumed.summary.startswith("New gains: x at 6 s. Those of x are of" if published else "No new gains.")


@pytest.mark.parametrize(
    ("name", "text", "error", "said"),
    [
        ("gains.json", None, ModelError, "gains are written as"),
        ("gains.toml", "hello = 1\n", LogError, "not overwritten"),
        ("gains.toml", 'format = "rotorfit-gains"\ndesign = 3\n', ModelError, "no gains file"),
        ("gains.toml", 'format = "rotorfit-gains\n', ModelError, "no gains file"),
        ("gains.yaml", "format: rotorfit-gains\naxes: [\n", ModelError, "no gains file"),
    ],
)
def test_a_file_that_is_none_is_refused_and_stays(
    name: str, text: str | None, error: type[Exception], said: str, tmp_path: Path
) -> None:
    path = tmp_path / name
    if text is not None:
        path.write_text(text)
    with pytest.raises(error, match=said):
        told(path, [])
    assert text is None or path.read_text() == text
