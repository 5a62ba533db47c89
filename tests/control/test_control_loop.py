"""The loop in docs/control.md: from a gains file alone, it commands what the library commands."""

import re
import tomllib
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from models import VEHICLE, model_of
from rotorfit.control.controller import ReferencePath, at_rest, commanded, observe, predict_motion
from rotorfit.control.trial import controller_of
from rotorfit.control.tuning import tune
from rotorfit.dynamics.response import transition
from rotorfit.exports.gains import save_gains
from rotorfit.simulation.air import wind_of
from rotorfit.simulation.flight_room import Conditions, FlightRoom
from rotorfit.simulation.vehicle import load_vehicle

pytestmark = pytest.mark.flights

DOCUMENT = Path(__file__).resolve().parents[2] / "docs" / "control.md"


def documented() -> dict[str, Any]:
    """Names that the block of the document defines."""
    (block,) = re.findall(r"^```python\n(.*?)^```$", DOCUMENT.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    names: dict[str, Any] = {}
    exec(compile(block, str(DOCUMENT), "exec"), names)
    return names


def wanted(path: ReferencePath, t: float) -> tuple[np.ndarray, ...]:
    return tuple(part[0] for part in path.at(np.array([t])))


@pytest.mark.parametrize(("axes", "kind"), [(("x", "yaw"), "predictor"), (("y", "z"), "lqr")])
def test_the_loop_of_the_document_commands_as_the_library_does(
    axes: tuple[str, ...], kind: Any, tmp_path: Path
) -> None:
    """On a lemniscate with swinging heading, across the wrap, in wind, with late poses, and where commands are cut."""
    model = model_of({axis: VEHICLE[axis] for axis in axes})
    tuning = tune(model, kind, draws=20)
    save_gains(tuning, model, tmp_path / "gains.toml")
    gains = tomllib.loads((tmp_path / "gains.toml").read_text(encoding="utf-8"))
    vehicle = load_vehicle("bebop2")
    path = ReferencePath("lemniscate", 1.2, 1.0, 6.0, (0.0, 0.0, 1.5, 3.1))
    controller, steering = controller_of(tuning, vehicle), at_rest(np.array(path.start))
    loop = documented()["Loop"](gains, path.start)
    room = FlightRoom(vehicle, Conditions(wind=wind_of(["wind=1", "gusts=0.3"], "bebop2")), 1, path.start)

    ours, theirs = [], []
    for k in range(int(path.duration / controller.period)):
        t = k * controller.period
        if poses := [sample for sample in room.advance(round(t * 1e9)) if sample.stream == "pose"]:
            x, y, z, qw, qx, qy, qz = poses[-1].values[:7]
            yaw = float(np.arctan2(2 * (qw * qz + qx * qy), 1 - 2 * (qy * qy + qz * qz)))
            pose = np.array([x + (2.0 if 3.0 < t < 3.5 else 0.0), y, z, yaw])  # far off for a while: commands are cut
            steering = observe(controller, steering, poses[-1].stamp * 1e-9, pose, path)
            loop.seen(poses[-1].stamp * 1e-9, pose)
        steering, command = commanded(controller, steering, t, path)
        ours.append(command)
        theirs.append(loop.command(t, partial(wanted, path)))
        room.send(command.tolist())

    np.testing.assert_allclose(theirs, ours, rtol=0, atol=1e-9)
    assert steering.saturated > 0
    moved = np.abs(ours).max(axis=0) > 0.01
    assert moved.tolist() == [axis in axes for axis in ("x", "y", "z", "yaw")]


@pytest.mark.parametrize(
    ("rate", "delay", "gap"), [(120.0, 0.58, 0.0), (50.0, 0.1, 1.4)], ids=["under way", "no poses"]
)
def test_both_loops_reach_back_to_all_commands_that_still_count(
    rate: float, delay: float, gap: float, tmp_path: Path
) -> None:
    """More than 64 of them, since the last pose less the delay: at a high rate, and while poses stay away."""
    model = model_of({"x": (3.7, 0.5, delay)})
    tuning = tune(model, axes=("x",), rate=rate, draws=20)
    save_gains(tuning, model, tmp_path / "gains.toml")
    loop = documented()["Loop"](tomllib.loads((tmp_path / "gains.toml").read_text(encoding="utf-8")), np.zeros(4))
    controller, steering = controller_of(tuning, load_vehicle("bebop2")), at_rest(np.zeros(4))
    path = ReferencePath("circle", 1.0, 1.0, 20.0, (0.0, 0.0, 0.0, 0.0))
    law, acted = tuning.axes["x"].law, []
    for k in range(int((delay + gap + 0.3) * rate)):
        t = k / rate
        if not 0.1 < t < 0.1 + gap:
            pose = np.array([0.1 * np.sin(5.0 * t), 0.0, 0.0, 0.0])
            steering = observe(controller, steering, t - 0.015, pose, path)
            loop.seen(t - 0.015, pose)
        steering, command = commanded(controller, steering, t, path)
        acted.append((t, command[0]))
        np.testing.assert_allclose(loop.command(t, partial(wanted, path)), command, rtol=0, atol=1e-9)

    since, end = steering.time, t + law.delay
    edges = [since, *(when + delay for when, _ in acted if since < when + delay < end), end]
    p, v, d = steering.state[:, 0]
    for begin, until in pairwise(edges):
        u = next((u for when, u in reversed(acted) if when + delay <= begin + 1e-9), 0.0)
        f, k, h, *_ = transition(law.damping, until - begin)
        p, v = p + k * v + h * (law.input * u + d), f * v + k * (law.input * u + d)
    found = predict_motion(controller, steering, end, 0.0)
    np.testing.assert_allclose(found[:2, 0], (p, v), rtol=0, atol=1e-9)


def test_the_loop_of_the_document_turns_commands_for_a_vehicle_that_takes_them_along_the_world(tmp_path: Path) -> None:
    model = model_of()
    tuning = tune(model, draws=20)
    world = replace(model, card=replace(model.card, command_frame="world"))
    loops = []
    for name, known in (("own", model), ("world", world)):
        save_gains(tuning, known, tmp_path / f"{name}.toml")
        gains = tomllib.loads((tmp_path / f"{name}.toml").read_text(encoding="utf-8"))
        loops.append(documented()["Loop"](gains, [0.0, 0.0, 1.0, np.pi / 2]))
    there = (np.array([0.1, 0.0, 1.0, np.pi / 2]), np.zeros(4), np.zeros(4))

    own, turned = (loop.command(0.0, lambda _: there) for loop in loops)

    assert own[1] < -1e-3  # the goal is at its right
    np.testing.assert_allclose(turned[:2], [-own[1], own[0]], atol=1e-12)


def test_a_gains_file_says_what_a_command_is_and_nothing_that_its_law_does_not_use(tmp_path: Path) -> None:
    model = model_of()
    for kind, own, other in (("predictor", "observer", "filter_time"), ("linearising", "filter_time", "observer")):
        save_gains(tune(model, kind, axes=("x",), draws=20), model, tmp_path / f"{kind}.toml")  # type: ignore[arg-type]
        gains = tomllib.loads((tmp_path / f"{kind}.toml").read_text(encoding="utf-8"))
        axis = gains["axes"]["x"]
        assert (own in axis, other in axis) == (True, False)
        assert axis["command"] == "fraction of the tilt limit (20 deg), from -1 to 1"
        assert axis["full_scale"] == 1.0
        assert gains["law"].startswith("u = (r''")
        used = {gains["symbols"][letter] for letter in "bKDI" if f"{letter} " in gains["law"]}
        assert {"damping", "stiffness", "rate_gain"} <= used <= set(axis)
