"""The public interface: its names, signatures and documents; it does what the command line does."""

import ast
import inspect
import json
import pkgutil
import re
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import polars as pl
import pytest
from click.testing import CliRunner
from matplotlib import pyplot as plt

import rotorfit as rf
from flights import steps
from logs import Csv, ran
from rotorfit.app.cli import main
from rotorfit.core.frames import AXES
from rotorfit.files.models import to_mapping
from rotorfit.flying.links.sim import SimLink
from rotorfit.simulation.paper_vehicle import Truth, simulate_flight

pytestmark = pytest.mark.flights

mpl.use("agg")

NOUNS = (
    "Axis", "Card", "Finding", "Fit", "Flight", "Log", "Model", "Plan", "RotorfitError", "Sample", "Track",
    "Validation",
)  # fmt: skip

CLASSES = ("Tracker",)
"""What is made by a call and does something."""

FUNCTIONS: dict[str, str] = {
    "compare": "(models, flights, horizons=None, *, card=None, progress=None)",
    "convert": "(model, limits)",
    "diagnose": "(log, card=None, span=(None, None))",
    "export": (
        "(model, to, path=None, *, dt=0.02, predictor=False, physical=False, round_delay=False, "
        "training=None, flights=(), name=None)"
    ),
    "fit": (
        "(flights, method='ml', axes=('x', 'y', 'z', 'yaw'), *, card=None, structure='averaged', "
        "uncertainty=False, prior=False, leave_one_out=False, progress=None)"
    ),
    "flight": "(log, card=None, span=(None, None))",
    "flight_from_log": "(log, card=None, span=(None, None))",
    "fly": (
        "(plan, link, path, *, card=None, poses='', land=True, take_off=False, seed=0, real_vehicle=False, status=None)"
    ),
    "ladder": "(flights, axes=('x', 'y', 'z', 'yaw'), *, card=None, progress=None)",
    "load": "(path)",
    "load_card": "(name_or_path)",
    "load_plan": "(path)",
    "plan": (
        "(card=None, *, after=None, design=None, room=None, box=None, axes=None, open_loop=False, "
        "duration=60.0, amplitude=None, speed=None, seed=0, progress=None)"
    ),
    "read": "(path, tables=None, progress=None)",
    "report": "(models, flights=(), path='report.html', *, card=None, figures=None, progress=None)",
    "save": "(result, path)",
    "simulate": "(model, command_time, command, time, pose=None, velocity=None)",
    "state_space": "(model)",
    "studio": "(folder=None, port=0, ready=None)",
    "track": "(flight, card=None, *, structure='averaged', false_alarms_per_hour=0.1, after=None, progress=None)",
    "tune": (
        "(model, design='predictor', *, path=None, rate=None, latency=0.015, axes=('x', 'y', 'z', 'yaw'), "
        "peak=1.7, draws=200, seed=0)"
    ),
    "validate": "(model, flights, horizons=None, *, card=None, progress=None)",
}
"""A change here is a change of the public interface: see docs/api.md."""


def test_the_public_names_are_these_and_each_is_there() -> None:
    assert sorted(rf.__all__) == sorted((*NOUNS, *CLASSES, "__version__", *FUNCTIONS))
    assert {name for name in rf.__all__ if getattr(rf, name, None) is None} == set()
    assert set(rf.__all__) <= set(dir(rf))


def test_a_name_that_is_not_public_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no attribute 'no_such_name'"):
        rf.no_such_name  # noqa: B018


def test_type_checkers_are_told_the_names_from_where_they_are() -> None:
    tree = ast.parse(Path(rf.__file__).read_text(encoding="utf-8"))
    told = {
        alias.name: node.module.removeprefix("rotorfit.")
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("rotorfit.")
        for alias in node.names
    }
    homes = {name: module for module, names in rf._HOMES.items() for name in names}

    assert told == {**homes, "__version__": "version"}


def test_importing_the_package_or_naming_a_noun_imports_nothing_heavy() -> None:
    def imported(*names: str) -> list[str]:
        heavy = "{'numba', 'scipy', 'polars', 'rosbags', 'matplotlib', 'rich', 'pandas'}"
        code = f"import sys, json, rotorfit.app.cli as c, rotorfit as rf; {'; '.join(f'rf.{name}' for name in names)}"
        code += f"\nprint(json.dumps(sorted({heavy} & set(sys.modules)) + ['numpy'] * ('numpy' in sys.modules)))"
        out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
        found: list[str] = json.loads(out)
        return found

    assert imported("__version__") == []
    assert imported(*NOUNS) == ["numpy"]


def test_no_module_has_the_name_of_a_public_function() -> None:
    modules = {module.name.split(".")[-1] for module in pkgutil.walk_packages(rf.__path__, "rotorfit.")}

    assert modules & set(FUNCTIONS) == set()


@pytest.mark.parametrize("name", FUNCTIONS)
def test_the_signature_is_the_one_that_was_promised(name: str) -> None:
    assert signature_of(name) == FUNCTIONS[name]


def signature_of(name: str) -> str:
    """Names, order and defaults of the parameters."""
    signature = inspect.signature(getattr(rf, name))
    bare = [one.replace(annotation=inspect.Parameter.empty) for one in signature.parameters.values()]
    return str(signature.replace(parameters=bare, return_annotation=inspect.Signature.empty))


@pytest.mark.parametrize("name", FUNCTIONS)
def test_every_public_function_says_what_it_takes_gives_and_raises(name: str) -> None:
    function = getattr(rf, name)
    document, signature = inspect.getdoc(function), inspect.signature(function)
    sections = dict(re.findall(r"^(Args|Returns|Raises):\n((?: +.*\n?|\n)*)", document, re.MULTILINE))

    assert set(re.findall(r"^    (\w+): ", sections["Args"], re.M)) == set(signature.parameters)
    assert sections["Raises"]
    assert ("Returns" in sections) == (signature.return_annotation not in (None, "None"))


def test_the_page_on_the_library_has_every_public_name() -> None:
    page = (Path(__file__).parents[1] / "docs" / "api.md").read_text(encoding="utf-8")

    assert {name for name in (*NOUNS, *CLASSES, *FUNCTIONS) if f"`rf.{name}" not in page} == set()


@dataclass(frozen=True)
class Room:
    """Two logs, the card, and what came of the first.

    Attributes:
        train: Path of a log.
        proof: Path of another one.
        card: Path of their card.
        fit: Of the first.
    """

    train: str
    proof: str
    card: str
    fit: rf.Fit


LAW = "first_order_delay"
"""What 25 s can tell."""


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Room:
    logs = []
    for name, axes, duration, seed in (("train", AXES, 20.0, 3), ("proof", ("z", "yaw"), 8.0, 4)):
        folder = tmp_path_factory.mktemp(name)
        log, _, card = Csv(simulate_flight(Truth(), steps(axes), duration, seed)).write(folder)
        logs.append(log)
    return Room(logs[0], logs[1], card, rf.fit(logs[0], card=card, axes="z,yaw", structure=LAW))


def plain(model: rf.Model) -> Any:
    """A model as its file has it."""
    return json.loads(json.dumps(to_mapping(model)))


def test_a_fit_is_that_of_the_command_line_from_a_path_a_flight_or_a_list(room: Room) -> None:
    said = ran("fit", room.train, "--card", room.card, "--axes", "z,yaw", "--structure", LAW)
    flight = rf.flight(rf.read(room.train), rf.load_card(room.card))

    assert said["findings"]
    assert said["axes"]["z"]["profile"]
    assert plain(room.fit.model) == said
    assert plain(rf.fit(flight, axes=("z", "yaw"), structure=LAW).model) == said
    paper = ran("fit", room.train, "--card", room.card, "--axes", "z,yaw", "--method", "paper")
    for same in (room.train, flight, [flight], [Path(room.train)], (flight,)):
        assert plain(rf.fit(same, "paper", ("z", "yaw"), card=room.card).model) == paper
    assert rf.flight_from_log(rf.read(room.train), rf.load_card(room.card)).findings == flight.findings != ()


def test_validation_comparison_and_diagnosis_are_those_of_the_command_line(room: Room, tmp_path: Path) -> None:
    rf.save(room.fit, tmp_path / "model.json")
    said = ran("validate", str(tmp_path / "model.json"), room.proof)
    validation = rf.validate(room.fit, room.proof)
    flight = rf.flight(room.proof, room.card)
    paper = rf.fit(rf.flight(room.train, room.card), "paper", ("z", "yaw"))
    comparison = rf.compare([tmp_path / "model.json", paper], [flight])

    rmse = {axis: score.horizons["1"].velocity_rmse for axis, score in validation.flights[0].axes.items()}
    assert rmse == {axis: row["horizons"]["1"]["velocity_rmse"] for axis, row in said["flights"][0]["axes"].items()}
    assert rf.validate(tmp_path / "model.json", flight).flights == validation.flights
    assert comparison.validations[0].flights == validation.flights
    assert comparison.paths == (str(tmp_path / "model.json"), "model 2")
    assert comparison.to_frame()["model"].unique(maintain_order=True).to_list() == list(comparison.paths)
    assert rf.diagnose(room.train, room.card) == rf.diagnose(rf.read(room.train), rf.load_card(room.card))


def test_what_a_model_is_for_takes_fits_models_and_files(room: Room, tmp_path: Path) -> None:
    file = tmp_path / "model.json"
    rf.save(room.fit, file)
    motions = [rf.simulate(m, [0.0], [[0, 0, 0.2, 0]], [0.0, 1.0]) for m in (room.fit, room.fit.model, str(file))]
    page = rf.report(room.fit, room.proof, tmp_path / "report.html", card=room.card)

    assert np.ptp([motion.velocity for motion in motions], axis=0).max() == 0
    assert motions[0].velocity[-1, 2] > 0
    assert rf.state_space(file).axes == ("z", "yaw")
    assert rf.export(file, "numpy").axes == rf.export(room.fit, "numpy").axes == ("z", "yaw")
    assert rf.tune(room.fit, path=tmp_path / "gains.toml").axes.keys() == rf.tune(file).axes.keys()
    assert (tmp_path / "gains.toml").is_file()
    assert page.read_text(encoding="utf-8").startswith("<!doctype html")


def test_a_plan_is_made_saved_flown_and_its_recording_needs_no_card(tmp_path: Path) -> None:
    plan = rf.plan("sim:bebop2", room=(6, 6, 4), duration=15, axes="yaw")
    rf.save(plan, tmp_path / "plan.toml")
    flown = rf.fly(tmp_path / "plan.toml", "sim:bebop2", tmp_path / "flight.mcap")

    assert flown.reason == "completed"
    assert rf.flight(tmp_path / "flight.mcap").axes == ("x", "y", "z", "yaw")
    assert len(plan.plot()) == 1
    plt.close("all")


def test_a_real_vehicle_is_not_moved_unless_that_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(SimLink, "live", True)
    plan = rf.plan("sim:bebop2", room=(6, 6, 4), duration=15, axes="yaw")

    with pytest.raises(rf.RotorfitError, match="moves a real vehicle: nothing was flown"):
        rf.fly(plan, "sim:bebop2", tmp_path / "flight.mcap")
    assert not (tmp_path / "flight.mcap").exists()


@pytest.mark.parametrize("wrong", [3, None, [3], b"flight.csv"])
def test_what_is_neither_path_nor_flight_is_one_clear_error(wrong: Any, room: Room) -> None:
    for call in (rf.fit, rf.ladder, lambda flights: rf.validate(room.fit, flights)):
        with pytest.raises(TypeError, match="expected a flight, the path of a log, or a sequence of them, got"):
            call(wrong)
    for call in (rf.simulate, rf.tune, rf.state_space):
        with pytest.raises(TypeError, match="expected a model, a fit or the path of a model file, got"):
            call(wrong, *[[0.0]] * (3 if call is rf.simulate else 0))


WRONG_TYPES: dict[str, dict[str, list[Any]]] = {
    "flight": {"log": [5, None], "card": [5, []], "span": [5, None, "", (1.0,), (1, 2, 3), ("a", "b")]},
    "diagnose": {"span": [5, None, (1.0,)]},
    "fit": {"method": [5, [], None], "axes": [5, [5], None], "structure": [5, [], None], "card": [5]},
    "validate": {"horizons": [5, "1,2", ["1"], [True]]},
    "compare": {"models": [5, "model.json", [5]], "horizons": [5]},
    "simulate": {
        "command_time": [5, None, "now", {}, [[0.0]], [10**400]],
        "command": [5, None, [0.0], np.zeros((3, 4))],
        "time": [5, "now", None],
        "pose": [5, [0.0], np.zeros(5), {}],
        "velocity": [5, [0.0]],
    },
    "convert": {"limits": [5, None, []]},
    "plan": {"design": [5, []], "room": [5, [], [None]], "axes": [5], "duration": ["60", None], "seed": [1.5, None]},
    "fly": {"link": [5, None], "path": [5, None], "seed": ["a"], "poses": [5], "card": [5]},
    "tune": {"design": [5, None], "rate": ["50"], "axes": [5], "draws": [1.5], "seed": [None]},
    "export": {"to": [5, None], "path": [5], "dt": ["0.02"], "name": [5]},
    "save": {"result": [5, None, "model.json"], "path": [5]},
    "track": {
        "flight": [5, None, []],
        "card": [5],
        "structure": [5, None],
        "false_alarms_per_hour": ["0.1", None],
        "after": [5],
    },
}


@pytest.mark.parametrize("name", WRONG_TYPES)
def test_an_argument_of_another_type_is_a_type_error_that_says_what_is_wanted(
    name: str, room: Room, tmp_path: Path
) -> None:
    log, model = room.train, room.fit.model
    sound: dict[str, dict[str, Any]] = {
        "flight": {"log": log},
        "diagnose": {"log": log},
        "fit": {"flights": log},
        "validate": {"model": model, "flights": log},
        "compare": {"models": [model], "flights": log},
        "simulate": {"model": model, "command_time": [0.0, 1.0], "command": np.zeros((2, 4)), "time": [0.0, 1.0]},
        "convert": {"model": model},
        "plan": {"card": "rotorfit-demo"},
        "fly": {"plan": "plan.toml", "link": "sim", "path": tmp_path / "flight.mcap"},
        "tune": {"model": model},
        "export": {"model": model, "to": "ros-yaml"},
        "save": {"result": model, "path": tmp_path / "model.json"},
        "track": {"flight": log, "card": room.card},
    }
    for argument, values in WRONG_TYPES[name].items():
        for value in values:
            with pytest.raises(TypeError, match=r"expected|is a|are a|can be saved") as error:
                getattr(rf, name)(**{**sound[name], argument: value})
            assert "\n" not in str(error.value)
    assert not list(tmp_path.iterdir())


def test_numbers_that_nothing_has_are_one_line(room: Room) -> None:
    for value in (float("nan"), float("inf"), 10**400, 10**5000):
        with pytest.raises(rf.RotorfitError, match="finite number") as error:
            rf.validate(room.fit, room.train, [value])
        assert len(str(error.value)) < 200
        with pytest.raises(rf.RotorfitError, match="finite number"):
            rf.flight(room.train, room.card, span=(0.0, value))


def test_a_result_in_a_folder_that_is_not_there_is_one_line(room: Room, tmp_path: Path) -> None:
    place = tmp_path / "not there"
    for write in (
        lambda: rf.save(room.fit, place / "model.json"),
        lambda: rf.export(room.fit, "numpy", place / "vehicle.py"),
        lambda: rf.tune(room.fit, path=place / "gains.toml"),
    ):
        with pytest.raises(rf.RotorfitError, match=r"there is no folder .*; make it first"):
            write()


@pytest.mark.parametrize(
    ("stamps", "command", "told"),
    [([0.0], [np.nan, 0, 0, 0], "finite"), ([1.0, 0.0], [0.1, 0, 0, 0], "command_time does not increase")],
)
def test_what_cannot_be_simulated_is_one_line(stamps: list[float], command: list[float], told: str, room: Room) -> None:
    with pytest.raises(rf.RotorfitError, match=told):
        rf.simulate(room.fit, stamps, [command] * len(stamps), [0.0, 1.0])


def test_nothing_to_simulate_is_one_line(room: Room) -> None:
    with pytest.raises(rf.RotorfitError, match="time is empty: give at least one"):
        rf.simulate(room.fit, [0.0], [[0.2, 0, 0, 0]], [])
    with pytest.raises(rf.RotorfitError, match="command_time is empty: give at least one"):
        rf.simulate(room.fit, [], np.zeros((0, 4)), [0.0, 1.0])


def test_a_path_that_none_can_be_is_no_such_file() -> None:
    for path in ("a\0b", "9" * 5000, "\udcff"):
        for use in (rf.flight, rf.diagnose, rf.fit, rf.read, rf.load, rf.load_card, rf.load_plan):
            with pytest.raises(rf.RotorfitError):
                use(path)


@pytest.mark.parametrize("wrong", ["flight.csv", Path("flight.csv"), 5, None, ["flight.csv"], [5]])
def test_the_stages_take_flights_and_nothing_else(wrong: Any, room: Room) -> None:
    from rotorfit.assessment.validation import validate
    from rotorfit.estimation.fitting import fit

    with pytest.raises(TypeError, match="sequence of flights"):
        fit(wrong)
    with pytest.raises(TypeError, match="sequence of flights"):
        validate(room.fit.model, wrong)


def test_other_wrong_words_are_errors_that_say_what_is_right(room: Room) -> None:
    with pytest.raises(TypeError, match=r"make a flight of it with rotorfit\.flight"):
        rf.fit(rf.read(room.train))  # type: ignore[arg-type]
    with pytest.raises(rf.RotorfitError, match="no such method: 'best'; methods are ml, "):
        rf.fit(room.train, "best", card=room.card)
    with pytest.raises(rf.RotorfitError, match="no such axis: 'roll'; axes are x, y, z, yaw"):
        rf.fit(room.train, axes="z,roll", card=room.card)
    with pytest.raises(rf.RotorfitError, match="no axis: give at least one of x, y, z, yaw"):
        rf.fit(room.train, axes=[], card=room.card)
    with pytest.raises(TypeError, match="the path of a log, or a sequence of them, got dict"):
        rf.fit({room.train: 1})
    with pytest.raises(TypeError, match="expected a sequence of models, fits or model files, got dict"):
        rf.compare({"model.json": 1}, room.proof)
    with pytest.raises(rf.RotorfitError, match="accuracy table is of the likelihood"):
        rf.fit(room.train, "paper", card=room.card, uncertainty=True)
    with pytest.raises(TypeError, match="a model, a fit or a plan can be saved, not int 3"):
        rf.save(3, "model.json")  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="expected a sequence of models, fits or model files"):
        rf.compare(room.fit, room.proof)  # type: ignore[arg-type]
    with pytest.raises(rf.RotorfitError, match="no such structure: 'best'; structures are "):
        rf.track(room.train, room.card, structure="best")
    for rate in (0.0, -1.0, 61.0, float("nan")):
        with pytest.raises(rf.RotorfitError, match="false alarms an hour"):
            rf.track(room.train, room.card, false_alarms_per_hour=rate)


def test_texts_of_nouns_are_short_and_what_files_say_is_escaped(room: Room) -> None:
    flight = rf.flight(room.proof, room.card)
    nasty = replace(room.fit.model, card=replace(room.fit.model.card, name="<script>"))
    shown = (
        rf.read(room.train), rf.load_card(room.card), flight, room.fit, nasty, nasty.card, nasty.findings[0],
        rf.validate(room.fit, flight), rf.diagnose(room.train, room.card), rf.tune(room.fit),
        rf.plan("sim:bebop2", room="6x6x4", duration=15, axes=["yaw"]),
    )  # fmt: skip

    for value in shown:
        assert len(repr(value)) < 1500
        assert "<script>" not in value._repr_html_()  # type: ignore[attr-defined]
        assert len(value._repr_html_()) < 8000  # type: ignore[attr-defined]
    for value in (room.fit.paper, rf.validate(room.fit, flight).errors["model"][0]["1"]):
        assert "array of shape" in repr(value)
        assert len(repr(value)) < 2000
    assert "z     delay" in repr(room.fit.model)


def test_frames_hold_what_the_nouns_hold(room: Room) -> None:
    model, flight = room.fit.model, rf.flight(room.proof, room.card)
    frame = model.to_frame()
    scores = rf.validate(model, flight).to_frame()
    one = scores.filter((pl.col("axis") == "z") & (pl.col("predictor") == "hold") & (pl.col("horizon") == 1.0))

    assert frame.filter(axis="z", coefficient="delay")["estimate"].to_list() == [model.axes["z"].delay]
    assert frame.filter(axis="x")["estimate"].to_list() == [None, None, None]
    assert one.height == 1
    assert one["velocity_rmse"][0] > 0
    assert flight.to_frame().height == flight.pose_time.size
    at = int(np.searchsorted(flight.command_time, flight.pose_time[100], side="right")) - 1
    assert flight.to_frame()["command_yaw"][100] == flight.command[at, 3]


@pytest.fixture(scope="module")
def track(room: Room) -> rf.Track:
    return rf.track(rf.flight(room.proof, room.card), structure=LAW)


def test_a_track_is_that_of_the_command_line_from_a_path_a_log_or_a_flight(room: Room, track: rf.Track) -> None:
    out = CliRunner().invoke(main, ["track", room.proof, "--card", room.card, "--structure", LAW, "--jsonl"]).stdout
    said, told = [json.loads(line) for line in out.splitlines()], []
    again = rf.track(room.proof, room.card, structure=LAW, progress=lambda share, text: told.append((share, text)))

    assert said[:-1] == [json.loads(json.dumps(state.to_mapping())) for state in track.states]
    assert rf.track(rf.read(room.proof), room.card, structure=LAW).states == again.states == track.states
    assert told[-1] == (1.0, "tracked to 8 s")
    assert [share for share, _ in told] == sorted(share for share, _ in told)


def test_a_track_shows_itself_as_table_figure_and_text(track: rf.Track) -> None:
    frame, last = track.to_frame(), track.states[-1].axes["z"]
    end = frame.filter(axis="z").tail(1)

    assert frame.height == sum(len(state.axes) for state in track.states)
    assert [end[name][0] for name in ("input", "input_low", "input_high")] == [
        last.values["input"],
        *last.ci95["input"],
    ]
    assert end["state"][0] == last.state
    assert (end["wind_low"][0], end["wind_high"][0]) == last.wind_ci95
    assert frame["lag"].null_count() == frame.height
    assert repr(track) == "Track(8.0 s, 1 regime, 0 alarms)"
    assert "<table>" in track._repr_html_()
    panels = track.plot()
    assert [axes.get_title(loc="left") for axes in panels[:2]] == ["z: input", "yaw: input"]
    assert len(panels) == 3 * len(track.axes)
    plt.close("all")


def test_pandas_is_only_imported_if_asked_for_and_an_error_says_how_to_get_it(
    room: Room, monkeypatch: pytest.MonkeyPatch
) -> None:
    room.fit.model.to_frame()
    assert "pandas" not in sys.modules
    monkeypatch.setitem(sys.modules, "pandas", None)

    with pytest.raises(ModuleNotFoundError, match="pandas is not installed; install it with: pip install pandas"):
        room.fit.model.to_frame("pandas")
    with pytest.raises(rf.RotorfitError, match="no such library of data frames: 'arrow'"):
        room.fit.model.to_frame("arrow")  # type: ignore[call-overload]


def test_a_pandas_frame_is_the_same_table(room: Room) -> None:
    pandas = pytest.importorskip("pandas")
    frame = room.fit.model.to_frame("pandas")

    assert isinstance(frame, pandas.DataFrame)
    assert list(frame.columns) == room.fit.model.to_frame().columns


def test_figures_show_what_is_known(room: Room) -> None:
    flight = rf.flight(room.proof, room.card)
    model, validation = room.fit.model, rf.validate(room.fit, flight)
    coefficients, scores, motion = model.plot(), validation.plot(), flight.plot()

    assert [axes.get_title(loc="left") for axes in coefficients] == [
        "input [m/s², yaw rad/s²]", "damping [1/s]", "delay [s]",
    ]  # fmt: skip
    assert [label.get_text() for label in coefficients[2].get_yticklabels()] == ["z", "yaw"]
    assert [axes.get_ylabel() for axes in motion] == ["command", "position [m]", "yaw [rad]"]
    assert len(scores) == 2 * len(validation.flights[0].moved)
    assert all(axes.get_yscale() == "log" for axes in scores)
    plt.close("all")
