"""Every figure that rotorfit gives for fixed flights, to the last bit: does a refactoring change a number?

    python bench/golden.py write FILE [--only NAME]
    python bench/golden.py compare A B [--tolerance 0] [--rename OLD=NEW ...]

`write` plans, flies, surveys, fits, validates, compares, tunes and exports, on flights of both simulators and on the
recorded flights beside the project; `--only` selects the cases whose names begin with NAME. `compare` lists the figures
that differ by more than a relative tolerance and the keys that only one file has. In texts only the numbers are
compared, so that a better sentence is no difference. `--rename` is for a word in the keys of A that has another name in
B.

Kernels round differently in the process that compiles them than in processes that load them from the cache, probably
because `fastmath` contracts other products and sums where more is inlined: the first run of a fresh installation
differs from all later ones in the last bits. Compare second runs.
"""

import os

os.environ |= dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
# before numpy is imported: sums are always taken in the same order

import argparse
import hashlib
import json
import math
import re
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import chdir, nullcontext
from dataclasses import fields, is_dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from rotorfit.app.comparison import compare_logs, comparison_mapping
from rotorfit.app.demo import FLIGHTS, Demo, demo, demo_mapping
from rotorfit.app.workflows import (
    fit_logs,
    ladder_logs,
    leave_one_out_logs,
    load_flight,
    training_flights,
    validate_logs,
)
from rotorfit.assessment.innovations import residuals
from rotorfit.assessment.method_comparison import to_mapping as ladder_mapping
from rotorfit.assessment.validation import to_mapping as validation_mapping
from rotorfit.control.trial import scores_mapping, try_tuning
from rotorfit.control.tuning import tune
from rotorfit.core.card import Card
from rotorfit.core.frames import AXES, Array
from rotorfit.core.laws import STRUCTURES
from rotorfit.core.limits import limits_from_text
from rotorfit.core.model import Model
from rotorfit.core.results import Fit
from rotorfit.diagnosis.survey import survey_logs
from rotorfit.dynamics.other_limits import convert
from rotorfit.dynamics.trajectory import simulate
from rotorfit.exports import FORMATS, export
from rotorfit.exports.gains import tuning_mapping
from rotorfit.exports.validity import trained_on
from rotorfit.files.cards import card_from_mapping, load_card
from rotorfit.files.log_span import parse_log
from rotorfit.files.logs import read
from rotorfit.files.models import load
from rotorfit.files.models import to_mapping as model_mapping
from rotorfit.files.plans import save_plan
from rotorfit.flying.mission import flown_mission, mission
from rotorfit.planning.request import Request, planned, plans_mapping
from rotorfit.planning.signals import two_sines
from rotorfit.simulation.air import Gusts, Wind
from rotorfit.simulation.flight_room import Conditions, fly_commands
from rotorfit.simulation.paper_vehicle import GAMMA_A, Controller, Truth, simulate_flight, write_bag
from rotorfit.simulation.vehicle import load_vehicle
from rotorfit.version import __version__

Figures = Mapping[str, Any]

RECORDED = Path(__file__).resolve().parents[2] / "shared" / "data"
SETS: Mapping[str, tuple[Sequence[str], Sequence[str]]] = {
    "bebop2-wsu/x": (["Training_CT_TestDay_X.mat@:84"], ["Training_CT_TestDay_X.mat@84:"]),
    "bebop2-wsu/z": (["Training_CT_TestDay_Z.mat@:68"], ["Training_CT_TestDay_Z.mat@68:"]),
    "bebop2-optitrack/pitch": (["monster_pitch_trn.bag"], ["monster_pitch_tst.bag"]),
    "bebop2-optitrack/vert": (["monster_vert_trn.bag"], ["monster_vert_tst.bag"]),
    "bebop2-joystick": (["record_velocity.csv@:45"], ["record_velocity.csv@45:"]),
    "dji-hexarotor": ([f"Datos_Prueba{i}.mat" for i in (1, 2, 3, 4)], [f"Datos_Prueba{i}.mat" for i in (5, 6)]),
    "ardrone2-optitrack": (
        ["THETA_02_Feb_2022_11_49_20_LARANJA_COMPLETO.mat", "ZDOT_02_Feb_2022_10_39_58_LARANJA_COMPLETO.mat"],
        ["ZDOT_02_Feb_2022_10_43_56_LARANJA_COMPLETO_bonito.mat"],
    ),
    "px4-s500": (["TestFlight1.ulg"], ["TestFlight1.ulg"]),
    "arducopter": (["2014-10-18_20-04-24.bin"], ["2014-10-18_20-04-24.bin"]),
    "arducopter-sitl/links": (["s01.mcap"], ["s02.mcap"]),
    "arducopter-sitl/onboard": (["s01.BIN"], []),
    "tello": (["demo_spotlight.txt"], ["demo_spotlight.txt"]),
    "motive": (["pathviewr_motive_example_data.csv"], []),
}
"""Folder to what is fitted and what validates; without that, to what is surveyed only."""

ROOM_FLIGHTS = {"crazyflie": ("chirp", ",wind=0.5,gusts=0.2"), "m100": ("ident", ",gusts=0.5"), "tello": ("3211", "")}
"""Vehicle of the flight room to the design that it flies and the air."""

METHODS = ("ml", "robust", "paper", "svf", "weak", "iv", "oe")
STRUCTURE_AXES = {"first_order_delay_lag": AXES, "coupled": ("x", "y"), "auto": ("x", "y", "z")}
"""Others are fitted to z alone."""

PRIOR = {"x": {"input": {"mean": 3.5, "sd": 0.2}}, "z": {"damping": {"mean": 2.0, "sd": 0.3}}}
VERSIONED = ("rotorfit", "sha256", "written")
"""Keys that a new version changes: its number, digests of the files that hold it."""

LONGEST, SHOWN = 64, 40
"""Values of an array that are written one by one; differences that are shown."""

NUMBER = re.compile(r"(?<![\w.])[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")


def flat(value: Any, key: str) -> Iterator[tuple[str, Any]]:
    """Every number, word and truth value of nested values, with the path to it."""
    if is_dataclass(value):
        value = {field.name: getattr(value, field.name) for field in fields(value)}
    elif isinstance(value, str) and " " in value:
        value = numbers(value)
    elif isinstance(value, np.ndarray) and value.size > LONGEST:
        value = digest(value)
    if isinstance(value, Mapping):
        for name in value:
            if name not in VERSIONED:
                yield from flat(value[name], f"{key}/{name}")
    elif isinstance(value, list | tuple | np.ndarray):
        yield f"{key}/count", len(value)
        for place, part in enumerate(value):
            yield from flat(part, f"{key}/{place}")
    elif isinstance(value, np.generic):
        yield from flat(value.item(), key)
    else:
        plain = value is None or isinstance(value, int) or (isinstance(value, float) and math.isfinite(value))
        yield key, value if plain else str(value)


def numbers(text: str) -> list[float]:
    return [float(found) for found in NUMBER.findall(text)]


def digest(values: Any) -> Figures:
    """What tells two long arrays apart, and two sums that tell by how much."""
    known = np.nan_to_num(np.asarray(values, np.float64).ravel()) if values.dtype.kind in "biuf" else np.zeros(1)
    return {
        "shape": list(values.shape),
        "digest": hashlib.sha256(values.tobytes()).hexdigest(),
        "norm": math.sqrt(math.fsum(known**2)),
        "ramp": math.fsum(known * np.linspace(0.5, 1.5, known.size)),
    }


def fitted(*logs: str, card: Card | str | None = None, **options: Any) -> Fit:
    return fit_logs([parse_log(log) for log in logs], card, **options)


def of_fit(fit: Fit) -> Figures:
    names = ("span", "axes", "command_time", "command", "pose_time", "position", "yaw", "segments", "notes")
    flights = [{name: getattr(flight, name) for name in names} for flight in fit.flights]
    return {"model": model_mapping(fit.model), "remarks": fit.remarks, "outliers": fit.outliers, "flights": flights}


def scored(model: Model, *logs: str, horizons: Sequence[float] = (0.5, 1.0, 5.0)) -> Figures:
    return validation_mapping(validate_logs(model, [parse_log(log) for log in logs], horizons=horizons)[0])


def steered(t: Array) -> Array:
    """Commands that excite all axes at once while the vehicle turns."""
    x, y, z, yaw = 0.2 * np.sin(1.1 * t), 0.2 * np.cos(1.7 * t), 0.3 * np.sin(2.3 * t), 0.1 + 0.2 * np.sin(t)
    return np.stack([x, y, z, yaw], axis=1)


@cache
def paper_flight(name: str) -> str:
    """A bag of the paper's vehicle: in open loop, turning, in a feedback loop, or in gusts with delays of its own."""
    rough = Truth(GAMMA_A, (0.1, 0.12, 0.2, 0.05), trim=(0.05, -0.1, 0.02, 0.01), wind_sigma=(0.2, 0.2, 0.1, 0.05))
    fly = {
        "open": partial(simulate_flight, Truth(), two_sines, 50.0, 1),
        "turning": partial(simulate_flight, Truth(), steered, 40.0, 2, initial_yaw=0.7),
        "closed": partial(simulate_flight, Truth(), steered, 40.0, 3, controller=Controller()),
        "gusty": partial(simulate_flight, rough, steered, 40.0, 4, controller=Controller(stiffness=0.3, damping=0.5)),
    }
    write_bag(fly[name](), Path(f"{name}.bag"))
    return f"{name}.bag"


@cache
def demonstrated() -> Demo:
    """Six flights of the flight room, planned, flown and recorded; models by two methods, and the proof."""
    return demo(Path("demo"))


def demo_files() -> tuple[str, list[str]]:
    """The model, and the flights that no model was fitted to."""
    return "demo/model.json", [flight.path for flight in demonstrated().validation.flights]


def demonstration() -> Figures:
    found, time = demonstrated(), np.linspace(0.0, 10.0, 101)
    return {
        **demo_mapping(found),
        "models": [model_mapping(found.ml), model_mapping(found.paper)],
        "logs": {name: read(Path("demo", f"{name}.mcap")).tables for name in FLIGHTS},
        "residuals": residuals(found.ml, load_flight(parse_log("demo/validate_xy.mcap"))),
        "simulated": simulate(found.ml, time, steered(time), time + 0.03),
    }


def room_kernel() -> Figures:
    stamps = np.arange(0, 20 * 10**9, 2 * 10**7)
    air = Conditions(Wind((0.5, -0.2, 0.0), Gusts((0.3, 0.3, 0.1)), ((8.0, (0.5, 0.0, 0.0)),)))
    return vars(fly_commands(load_vehicle("ardrone2"), air, stamps, steered(stamps * 1e-9), 20.0, 7))


def room_flight(vehicle: str) -> Figures:
    """Planned, flown, recorded, surveyed, fitted."""
    (design, air), plan, log = ROOM_FLIGHTS[vehicle], f"{vehicle}.toml", f"{vehicle}.mcap"
    plans, _ = planned(Request(f"sim:{vehicle}", design=design, room="8x8x4", duration=40.0, seed=5))
    save_plan(plans[0], plan)
    with mission(plan, f"sim:{vehicle}{air}", Path(log), seed=6) as wanted:
        flown_mission(wanted, True, nullcontext)
    return {"plan": plans_mapping(plans, (), (), None), "survey": survey_logs([log]), "fit": of_fit(fitted(log))}


def paper_fit(name: str, **options: Any) -> Figures:
    return {"survey": survey_logs([paper_flight(name)]), "fit": of_fit(fitted(paper_flight(name), **options))}


def recorded(name: str) -> Figures:
    folder = Path("recorded", name.partition("/")[0])
    own = folder / "card.toml"
    card = str(own) if own.exists() and folder.name != "arducopter-sitl" else None  # those logs carry theirs
    training, others = ([str(folder / log) for log in logs] for logs in SETS[name])
    found: dict[str, Any] = {"survey": survey_logs(training, card)}
    if others:
        fit = fitted(*training, card=card)
        found |= {"fit": of_fit(fit), "validation": scored(fit.model, *others)}
    return found


def several() -> Figures:
    logs = [paper_flight(name) for name in ("open", "turning", "closed")]
    left_out, _ = leave_one_out_logs(fitted(*logs, axes=("z",), uncertainty=True), ("z",))
    compared = ladder_logs([parse_log(log) for log in logs], axes=("x", "yaw"))
    return {"fit": of_fit(fitted(*logs)), "left_out": of_fit(left_out), "ladder": ladder_mapping(compared)}


def comparison() -> Figures:
    path, proof = demo_files()
    return {
        "methods": comparison_mapping(compare_logs([path, "demo/paper.json", *proof])),
        "horizons": scored(load(path), proof[0], horizons=(0.2, 3.0)),
        "converted": model_mapping(convert(load(path), limits_from_text("tilt=15deg,yaw_rate=60deg/s"))),
    }


def plans() -> Figures:
    card = "sim:bebop2"
    asked = {
        "multisine": Request(card, duration=40.0, seed=3),
        "doublets": Request(card, design="doublets", axes=("z",), duration=40.0),
        "prbs": Request(card, design="prbs", axes=("x", "y"), duration=40.0, seed=4),
        "separate": Request(card, design="two_sines", separate=True, room="6x6x4"),
        "open_loop": Request(card, axes=("yaw",), open_loop=True, duration=15.0, box="-8,-8,0.5,8,8,4"),
        "optimal": Request(card, design="optimal", axes=("x",), duration=30.0),
        "after": Request(after=demo_files()[0], room="6x6x4", duration=20.0),
    }
    made = {name: planned(request) for name, request in asked.items()}
    return {name: plans_mapping(found, (), (), proposal) for name, (found, proposal) in made.items()}


def gains() -> Figures:
    model = load(demo_files()[0])
    tunings = {
        "predictor": tune(model, "predictor"),
        "lqr": tune(model, "lqr", rate=100.0),
        "linearising": tune(model, "linearising", latency=0.03, peak=1.9, seed=1),
    }
    trial = try_tuning(tunings["predictor"], model, "bebop2,wind=1,gusts=0.3", 1)
    return {"trial": scores_mapping(trial), **{name: tuning_mapping(made, model) for name, made in tunings.items()}}


def exported() -> Figures:
    path, proof = demo_files()
    model, lagged = load(path), fitted(paper_flight("turning"), structure="first_order_delay_lag").model
    trained, logs = trained_on(training_flights(model)[0]), [parse_log(log) for log in proof]
    found: dict[str, Figures] = {}
    for to, form in FORMATS.items():
        made = {
            "proven": export(model, to, trained=trained, score=lambda exported: validate_logs(exported, logs)[0]),
            "rounded": export(model, to, dt=0.01, physical=True, round_delay=True),
            **({} if form.plain else {"lag": export(lagged, to, predictor=True)}),
        }
        for name, one in made.items():
            text = re.sub(r"\b[0-9a-f]{64}\b", "", one.text).replace(f" {__version__}", "")  # what a version changes
            code = {"digest": hashlib.sha256(text.encode()).hexdigest(), "numbers": numbers(text)}
            found[f"{to}/{name}"] = {"axes": one.axes, "notes": one.notes, **code}
    return found


CASES: Mapping[str, Callable[[], Figures]] = {
    "demo": demonstration, "several": several, "compare": comparison, "plan": plans, "tune": gains, "export": exported,
    **{f"paper/{name}": partial(paper_fit, name) for name in ("open", "turning", "closed", "gusty")},
    "prior": lambda: paper_fit(
        "gusty", card=card_from_mapping({**load_card("rotorfit-demo").raw, "prior": PRIOR}, "golden"), prior=True
    ),
    **{f"method/{name}": partial(paper_fit, "closed", method=name) for name in METHODS},
    **{
        f"structure/{name}": partial(paper_fit, "turning", structure=name, axes=STRUCTURE_AXES.get(name, ("z",)))
        for name in (*STRUCTURES, "auto")
    },
    "room/kernel": room_kernel, **{f"room/{name}": partial(room_flight, name) for name in ROOM_FLIGHTS},
    **{f"recorded/{name}": partial(recorded, name) for name in SETS},
}  # fmt: skip


def write(path: Path, only: str) -> None:
    wanted = [name for name in CASES if name.startswith(only)]
    left = [name for name in wanted if name.startswith("recorded/") and not RECORDED.is_dir()]
    if left:
        print("the recorded flights are not there; left out:", *left, file=sys.stderr)
    wanted = [name for name in wanted if name not in left]
    found: dict[str, Any] = {}
    target = path.resolve()
    with tempfile.TemporaryDirectory() as folder, chdir(folder):  # paths in results are the same wherever this runs
        if RECORDED.is_dir():
            Path("recorded").symlink_to(RECORDED)
        for name in wanted:
            begun = time.process_time()
            found |= flat(CASES[name](), name)
            print(f"{name}: {time.process_time() - begun:.1f} s, {len(found)} figures", file=sys.stderr, flush=True)
    target.write_text(json.dumps(dict(sorted(found.items())), indent=0, allow_nan=False) + "\n")


def difference(one: Any, other: Any) -> float:
    """Relative difference of two figures; infinite where they differ and are not both numbers."""
    if type(one) is type(other) and one == other:
        return 0.0
    if {type(one), type(other)} <= {int, float}:
        return float(abs(one - other) / max(abs(one), abs(other), sys.float_info.min))
    return math.inf


def compare(a: Figures, b: Figures, tolerance: float) -> int:
    """Prints what differs, keys that only one has last; with a tolerance a digest says nothing."""
    far = {key: difference(a.get(key, "absent"), b.get(key, "absent")) for key in {*a, *b}}
    apart = [key for key in far if far[key] > tolerance and not (tolerance and key.endswith("/digest"))]
    apart.sort(key=lambda key: (key not in a or key not in b, key))
    for key in apart[:SHOWN]:
        print(f"{key}: {a.get(key, 'absent')!r}, {b.get(key, 'absent')!r}, relative {far[key]:.2g}")
    print(f"{len(apart)} of {len(far)} figures differ by more than {tolerance:g}")
    return 1 if apart else 0


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    verbs = parser.add_subparsers(dest="verb", required=True)
    writing, comparing = verbs.add_parser("write"), verbs.add_parser("compare")
    writing.add_argument("file", type=Path)
    writing.add_argument("--only", default="", metavar="NAME")
    comparing.add_argument("files", type=Path, nargs=2, metavar="FILE")
    comparing.add_argument("--tolerance", type=float, default=0.0)
    comparing.add_argument("--rename", action="append", default=[], metavar="OLD=NEW")
    asked = parser.parse_args()
    if asked.verb == "write":
        write(asked.file, asked.only)
        return 0
    a, b = (json.loads(path.read_text()) for path in asked.files)
    for old, _, new in (pair.partition("=") for pair in asked.rename):
        a = {key.replace(old, new): value for key, value in a.items()}
    return compare(a, b, asked.tolerance)


if __name__ == "__main__":
    sys.exit(main())
