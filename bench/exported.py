"""Every export, imported again and run: how to run each format, and its error."""

import importlib.util
import re
import shutil
import subprocess
import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from scipy.linalg import expm

from export_motion import Drive, integrated, reference, settled_lags, walked
from rotorfit.core.frames import AXES, Array
from rotorfit.core.laws import structure_named
from rotorfit.core.model import Model, Predictor
from rotorfit.exports import Export, export

WARNINGS = ("-Wall", "-Wextra", "-Wunused-const-variable", "-pedantic", "-Werror")
"""Of gcc; none may come. Constants of a header that nobody uses are reported by -Wall only where the header is the
compiled file."""


def loaded(made: Export, folder: Path) -> ModuleType:
    """A Python export as a module."""
    path = folder / f"{made.name}_{made.format.replace('-', '_')}.py"
    path.write_text(made.text)
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def run_numpy(made: Export, folder: Path, given: Drive) -> Array:
    module = loaded(made, folder)
    if given.dt:
        state, past = module.start(given.pose, given.velocity, given.command[0], given.dt)
        return module.rollout(state, past, given.command, given.dt)[:, :8]  # type: ignore[no-any-return]
    state = module.start(given.pose, given.velocity, given.command[0])
    times = np.concatenate([[0.0], given.time])
    return module.simulate(state, given.stamp, given.command, times, before=given.command[0])[1:, :8]  # type: ignore[no-any-return]


def run_jax(made: Export, folder: Path, given: Drive) -> Array:
    import jax

    jax.config.update("jax_enable_x64", True)
    module = loaded(made, folder)
    if given.dt:
        state, past = module.start(given.pose, given.velocity, given.command[0], given.dt)
        rollout = jax.jit(lambda state, past, commands: module.rollout(state, past, commands, given.dt))
        return np.asarray(rollout(state, past, given.command))[:, :8]
    state = module.start(given.pose, given.velocity, given.command[0])
    return walked(module.flow, state, np.array(module.DELAY), given)[:, :8]


def run_casadi(made: Export, folder: Path, given: Drive) -> Array:
    module, out = loaded(made, folder), []
    if not given.dt:
        state = np.asarray(module.start(given.pose, given.velocity, given.command[0])).ravel()
        return walked(lambda s, u, h: module.flow(h)(s, u, 0), state, np.array(module.DELAY), given)[:, :8]
    step, xi = module.predictor(given.dt), module.start(given.pose, given.velocity, given.command[0], given.dt)
    for command in given.command:
        xi = step(xi, command, 0)
        out.append(np.asarray(xi).ravel()[:8])
    return np.array(out)


def run_python_control(made: Export, folder: Path, given: Drive) -> Array:
    """At the heading of the start; the axes that are exported, states in the order of the others."""
    module = loaded(made, folder)
    axes = [AXES.index(axis) for axis in module.INPUTS]
    heading = float(given.pose[3]) if {0, 1} <= set(axes) else 0.0
    own = replace(given, command=given.command[:, axes])
    state = np.concatenate([given.pose[axes], given.velocity[axes]])
    full = np.tile(np.concatenate([given.pose, given.velocity]), (given.time.size, 1))
    if given.dt:
        plant = module.sampled(given.dt, heading)
        past = [own.command[0, i] for i, count in enumerate(module.memory(given.dt)) for _ in range(count)]
        x, states = np.concatenate([state, np.zeros(plant.nstates - state.size - len(past)), past]), []
        x[2 * len(axes) : plant.nstates - len(past)] = settled_lags(made.model, given)
        for command in own.command:
            x = plant.dynamics(0.0, x, command)
            states.append(x)
    else:
        plant = module.continuous(heading)
        block = np.block([[plant.A, plant.B], [np.zeros((len(axes), plant.nstates + len(axes)))]])
        delay = np.array([module.DELAY[k] for k in axes])

        def flow(x: Array, u: Array, h: float) -> Array:
            return (expm(h * block) @ np.concatenate([x, u]))[: plant.nstates]  # type: ignore[no-any-return]

        states = walked(flow, np.concatenate([state, settled_lags(made.model, given)]), delay, own)
    columns = [*axes, *(4 + k for k in axes)]
    full[:, columns] = np.array(states)[:, : len(columns)]
    return full


C_MAIN = """
#include <stdio.h>
#include "NAME.h"

int main(void)
{
    NAME_model model;
    double row[9], pose[4], velocity[4], command[4], duration;
    int i;

    if (fread(row, sizeof(double), 8, stdin) != 8 || fread(command, sizeof(double), 4, stdin) != 4)
        return 1;
    for (i = 0; i < 4; i++) {
        pose[i] = row[i];
        velocity[i] = row[4 + i];
    }
    NAME_start(&model, pose, velocity, command);
    while (fread(command, sizeof(double), 4, stdin) == 4 && fread(&duration, sizeof(double), 1, stdin) == 1) {
        if (duration > 0.0)
            NAME_flow(model.state, command, NULL, duration);
        else
            NAME_step(&model, command, NULL);
        fwrite(model.state, sizeof(double), 8, stdout);
    }
    return 0;
}
"""


def compiled(made: Export, folder: Path, main: str = C_MAIN, options: tuple[str, ...] = ()) -> Path:
    """A program of the header; any warning is an error."""
    (folder / f"{made.name}.h").write_text(made.text)
    source, program = folder / "main.c", folder / "main"
    source.write_text(main.replace("NAME", made.name))
    command = ["gcc", "-std=c99", "-O2", *WARNINGS, *options, "-o", str(program), str(source), "-lm"]
    subprocess.run(command, check=True, capture_output=True, text=True)
    return program


def run_c(made: Export, folder: Path, given: Drive) -> Array:
    program = compiled(made, folder)
    start = np.concatenate([given.pose, given.velocity, given.command[0]])

    def answers(rows: Array) -> Array:
        data = np.concatenate([start, rows.ravel()]).tobytes()
        printed = subprocess.run([str(program)], input=data, capture_output=True, check=True).stdout
        return np.frombuffer(printed).reshape(-1, 8)

    if given.dt:
        return answers(np.column_stack([given.command, np.zeros(len(given.command))]))
    rows: list[Array] = []

    def note(state: Array, acting: Array, duration: float) -> Array:
        rows.append(np.array([*acting, duration]))
        return state

    delay = np.array([(made.model.axes[axis].predictor or Predictor(0.0, 0.0, 0.0)).delay for axis in AXES])
    walked(note, np.zeros(8), delay, given)
    ends = np.cumsum([row[4] for row in rows])
    return answers(np.array(rows))[np.abs(ends[:, None] - given.time).argmin(axis=0)]


OCTAVE = """
data = load('given.mat');
m = NAME();
if data.dt > 0
  [state, past] = m.start(data.pose, data.velocity, data.command(1, :), data.dt);
  out = zeros(rows(data.command), 8);
  for k = 1:rows(data.command)
    [state, past] = m.step(state, past, data.command(k, :), data.dt, [0 0 0 0]);
    out(k, :) = state(1:8);
  end
else
  state = m.start(data.pose, data.velocity, data.command(1, :), 1);
  out = m.simulate(state, data.stamp, data.command, [0; data.time(:)], [0 0 0 0], data.command(1, :))(2:end, 1:8);
end
save('-v7', 'out.mat', 'out');
"""


def run_matlab(made: Export, folder: Path, given: Drive) -> Array:
    """In Octave."""
    from scipy.io import loadmat, savemat

    (folder / f"{made.name}.m").write_text(made.text)
    (folder / "go.m").write_text(OCTAVE.replace("NAME", made.name))
    savemat(folder / "given.mat", {key: getattr(given, key) for key in given.__dataclass_fields__})
    command = ["octave", "--no-gui", "--quiet", "--norc", "go.m"]
    subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True)
    return loadmat(folder / "out.mat")["out"]  # type: ignore[no-any-return]


def run_parameters(made: Export, _folder: Path, given: Drive) -> Array:
    """Read by a YAML reader of version 1.1, as ROS has; the laws integrated."""
    from ruamel.yaml import YAML

    reader = YAML(typ="safe", pure=True)
    reader.version = (1, 1)  # type: ignore[assignment]
    raw: Any = reader.load(made.text)
    raw = raw["/**"]["ros__parameters"] if made.format == "ros2" else raw
    return integrated(model_from_parameters(made.model, raw[made.name]), given)


def model_from_parameters(model: Model, raw: Any) -> Model:
    """The model with nothing of its numbers left but those that were read."""
    axes = dict(model.axes)
    for axis in AXES:
        if axis not in raw["axes"]:
            axes[axis] = replace(axes[axis], predictor=None)
            continue
        one = raw[axis]
        names = [extra.name for extra in structure_named(one["structure"]).extras]
        point = Predictor(one["input"], one["damping"], one["delay"], {name: one[name] for name in names})
        axes[axis] = replace(axes[axis], predictor=point, structure=one["structure"])
    return replace(model, axes=axes)


def run_rotorpy(made: Export, folder: Path, given: Drive) -> Array:
    """In RotorPy's own loop, by a controller that plays the commands."""
    from rotorpy.simulate import simulate as fly

    module = loaded(made, folder)
    vehicle = module.Vehicle(given.pose, given.velocity, given.command[0])

    class Player:
        def update(self, t: float, *_: Any) -> Any:
            return {"cmd_model": given.command[min(round(t / given.dt), len(given.command) - 1)]}

    class Still:
        def update(self, *_: Any) -> Any:
            return np.zeros(3)

        def measurement(self, *_: Any, **__: Any) -> Any:
            return {"x": np.zeros(3)}

        def step(self, *_: Any) -> Any:
            return {"x": np.zeros(3)}

        with_artifacts = False

    class Nowhere:
        def update(self, *_: Any) -> Any:
            return {"x": np.zeros(3)}

    from rotorpy.world import World

    still, room = Still(), World.empty((-1e3, 1e3, -1e3, 1e3, -1e3, 1e3))
    end = given.time[-1] - 0.5 * given.dt
    result = fly(
        room, vehicle.initial_state, vehicle, Player(), Nowhere(), still, still, still, still, end, given.dt, 0.25,
        False, terminate=False,
    )  # fmt: skip
    state = result[1]
    yaw = np.unwrap(2 * np.arctan2(state["q"][1:, 2], state["q"][1:, 3]))
    yaw += 2 * np.pi * round((given.pose[3] - yaw[0]) / (2 * np.pi))
    return np.column_stack([state["x"][1:], yaw, state["v"][1:], state["w"][1:, 2]])


def run_gazebo(made: Export, _folder: Path, given: Drive) -> Array:
    """What the plugin computes of its gains, for a model of 1.5 kg, its motors and its attitude loop left out."""
    root, mass, inertia = ET.fromstring(made.text), 1.5, 0.05
    own = "{http://www.ros.org/wiki/xacro}"
    values = {one.get("name", ""): float(one.get("value", "")) for one in root.iter(f"{own}property")}
    known = {"mass": mass, "inertia_z": inertia, "roll_rate_gain": 0.4, "pitch_rate_gain": 0.5}

    def numbers(tag: str) -> list[float]:
        text = next(one.text or "" for one in root.iter(tag))
        return [float(eval(part, {}, known)) for part in re.findall(r"\$\{([^}]*)\}", text)]

    gain = np.array([*(k / mass for k in numbers("velocityGain")), numbers("angularRateGain")[2] / inertia])
    scale, delay = (np.array([values[f"{made.name}_{what}_{axis}"] for axis in AXES]) for what in ("scale", "delay"))

    def flow(state: Array, acting: Array, duration: float) -> Array:
        c, s = np.cos(state[3]), np.sin(state[3])
        x, y, z, yaw = scale * acting
        wanted = np.array([c * x - s * y, s * x + c * y, z, yaw])
        left = np.exp(-gain * duration)
        way = np.where(gain > 0, (1 - left) / np.where(gain > 0, gain, 1.0), duration)
        off = state[4:] - np.where(gain > 0, wanted, 0.0)
        steady = np.where(gain > 0, wanted, 0.0)
        return np.concatenate([state[:4] + steady * duration + off * way, steady + off * left])

    return walked(flow, np.concatenate([given.pose, given.velocity]), delay, given)


RUNS: dict[str, Callable[[Export, Path, Drive], Array]] = {
    "python-control": run_python_control,
    "casadi": run_casadi,
    "numpy": run_numpy,
    "jax": run_jax,
    "matlab": run_matlab,
    "c": run_c,
    "ros1": run_parameters,
    "ros2": run_parameters,
    "rotorpy": run_rotorpy,
    "gazebo": run_gazebo,
}

STRAIGHT = ("python-control", "gazebo")
"""Formats that hold the motion at a fixed heading only."""


def missing(to: str) -> str:
    """What a format needs that is not installed; empty where it can be run."""
    module = {"python-control": "control", "casadi": "casadi", "jax": "jax", "rotorpy": "rotorpy"}.get(to)
    program = {"matlab": "octave", "c": "gcc"}.get(to)
    if module and importlib.util.find_spec(module) is None:
        return module
    return program if program and shutil.which(program) is None else ""


def deviation(model: Model, to: str, folder: Path, given: Drive, truth: Array | None = None, **options: Any) -> Array:
    """Largest deviation of an export's motion: of positions [m], heading [rad], speeds [m/s] and yaw rate [rad/s]."""
    made = export(model, to, dt=given.dt or 0.02, name="bebop", **options)
    off = np.abs(RUNS[to](made, folder, given) - (reference(made.model, given) if truth is None else truth))
    return np.array([off[:, :3].max(), off[:, 3].max(), off[:, 4:7].max(), off[:, 7].max()])
