"""Exports: each imported again, run, and held against the model's own simulation."""

import ast
import importlib
import json
import re
import subprocess
import sys
import textwrap
import tomllib
import types
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import asdict, replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from flights import CARD, by_hand
from models import demo_card, model_of
from rotorfit.app.cli import main
from rotorfit.assessment.validation import to_mapping
from rotorfit.core.errors import ExportError, ModelError
from rotorfit.core.finding import Finding
from rotorfit.core.frames import AXES
from rotorfit.core.model import Model, Predictor, unknown_axis, with_findings
from rotorfit.core.results import AxisScore, FlightScores, Horizon, Validation
from rotorfit.dynamics.other_limits import convert
from rotorfit.dynamics.trajectory import simulate
from rotorfit.exports import export
from rotorfit.exports.formats import FORMATS
from rotorfit.exports.validity import scores, trained_on
from rotorfit.files.models import save

pytestmark = pytest.mark.flights

BENCH = Path(__file__).resolve().parents[2] / "bench"
PAGE = (BENCH.parent / "docs" / "exports.md").read_text(encoding="utf-8")
POINTS = {"x": (3.7, 0.18, 0.1664), "y": (3.6, 0.41, 0.1973), "z": (2.3, 2.05, 0.0529), "yaw": (4.4, 2.7, 0.0754)}
STEPPED, EXACT = 1e-6, 1e-9  # m, rad and their rates, over 20 s: by Runge-Kutta steps, in closed form
BENT = 5e-6  # by steps across the instants at which a limit begins or ends
SLOW_TO_WALK = ("casadi", "jax")  # build a function for every stretch between two irregular events
MIXED = {
    "x": ("quadratic_drag", {"drag_share": 0.6, "reference_speed": 0.8}),
    "y": ("first_order_delay_lag", {"lag": 0.15}),
    "z": ("climb_descent", {"asymmetry": 0.2}),
    "yaw": ("dead_zone", {"dead_zone": 0.08}),
}
OTHERS = {
    "first_order": {},
    "first_order_lag": {"lag": 0.15},
    "saturation": {"level": 0.25},
    "coupled": {"cross_input": 0.5, "cross_damping": 0.15},
    "second_order": {"lag": 0.3},
    "limited_acceleration": {"lag": 0.15, "acceleration_limit": 0.6},
}


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    """How each format is driven; shared with bench/bench_exports.py."""
    monkeypatch.syspath_prepend(str(BENCH))
    yield importlib.import_module("exported")
    sys.modules.pop("exported", None)


@pytest.fixture
def motion(run: ModuleType) -> ModuleType:
    """The commands, and what they lead to."""
    return sys.modules[run.walked.__module__]


@pytest.fixture
def model() -> Model:
    return model_of(POINTS)


def with_laws(model: Model, laws: dict[str, tuple[str, dict[str, float]]]) -> Model:
    """The model with other laws on these axes; those without a delay have none."""
    axes = dict(model.axes)
    for axis, (name, extra) in laws.items():
        point = axes[axis].predictor
        assert point
        delay = 0.0 if name in ("first_order", "first_order_lag") else point.delay
        axes[axis] = replace(
            axes[axis], structure=name, extra=extra, predictor=Predictor(point.input, point.damping, delay, extra)
        )
    return replace(model, axes=axes)


def untold(model: Model, axis: str, name: str = "delay") -> Model:
    """The model with a coefficient that the data cannot tell."""
    one = model.axes[axis]
    status = {**one.status, name: "not_identifiable"}
    return replace(model, axes={**model.axes, axis: replace(one, **{name: None}, status=status)})


def needed(run: ModuleType, to: str) -> None:
    if lacking := run.missing(to):
        pytest.skip(f"{lacking} is not there, which the export to {to} is run by")


@pytest.mark.parametrize("dt", [0.02, 0.0], ids=["fixed", "irregular"])
@pytest.mark.parametrize("to", FORMATS)
def test_what_is_exported_moves_as_the_model_does(
    to: str, dt: float, run: ModuleType, motion: ModuleType, model: Model, tmp_path: Path
) -> None:
    needed(run, to)
    if to == "rotorpy" and not dt:
        pytest.skip("RotorPy has a fixed step")
    straight = to in run.STRAIGHT
    short = to in ("ros1", "ros2") or (to in SLOW_TO_WALK and not dt)
    given = motion.drive(
        3, dt, duration=4.0 if short else 20.0, turning=not straight, heading=0.0 if to == "gazebo" else 0.7
    )

    off = run.deviation(model, to, tmp_path, given)

    assert (off < (EXACT if straight else STEPPED)).all(), off


def test_what_is_exported_has_no_command_before_the_first_as_simulate_has_none(
    run: ModuleType, model: Model, tmp_path: Path
) -> None:
    needed(run, "numpy")
    save(model, tmp_path / "model.json")
    export(tmp_path / "model.json", "numpy", tmp_path / "vehicle.py")
    known: dict[str, Any] = {}
    exec((tmp_path / "vehicle.py").read_text(encoding="utf-8"), known)
    times, command = np.linspace(0.0, 3.0, 7), np.array([[0.2, -0.1, 0.1, 0.3]])

    told = known["simulate"](np.zeros(8), [0.0], command, times)
    want = simulate(model, np.array([0.0]), command, np.linspace(0.0, 3.0, 12001))
    np.testing.assert_allclose(told[:, :4], want.pose[::2000], atol=1e-6)


def test_a_command_stamped_at_the_start_was_not_held_before(model: Model) -> None:
    lagged = with_laws(model, {"x": ("first_order_lag", {"lag": 0.08})})
    times, command = np.arange(0.0, 2.0, 0.02), np.array([[0.5, 0.0, 0.0, 0.0]])

    at, after = (simulate(lagged, np.array([first]), command, times).pose[-1, 0] for first in (0.0, 1e-6))
    assert at == pytest.approx(after, rel=1e-4)


def test_the_reference_itself_agrees_with_an_integrator_that_knows_only_the_equations(
    motion: ModuleType, model: Model
) -> None:
    given = motion.drive(5, 0.0, duration=5.0)

    assert np.abs(motion.reference(model, given) - motion.integrated(model, given)).max() < 3e-8


@pytest.mark.parametrize("to", ["numpy", "jax", "casadi", "matlab", "c", "ros2", "rotorpy"])
def test_a_different_law_on_every_axis_is_exported_as_it_is(
    to: str, run: ModuleType, motion: ModuleType, model: Model, tmp_path: Path
) -> None:
    needed(run, to)
    mixed, given = with_laws(model, MIXED), motion.drive(4, 0.05, duration=5.0)

    off = run.deviation(mixed, to, tmp_path, given, motion.integrated(mixed, given))

    assert (off < STEPPED).all(), off


@pytest.mark.parametrize("name", OTHERS)
@pytest.mark.parametrize("to", ["numpy", "c", "python-control"])
def test_every_law_is_exported_exactly_or_refused(
    to: str, name: str, run: ModuleType, motion: ModuleType, model: Model, tmp_path: Path
) -> None:
    needed(run, to)
    axes = ("x", "y") if name == "coupled" else AXES
    other, linear = with_laws(model, dict.fromkeys(axes, (name, OTHERS[name]))), to == "python-control"
    given = motion.drive(6, 0.05, duration=4.0, turning=not linear)
    if linear and name in ("saturation", "limited_acceleration"):
        with pytest.raises(ExportError, match=rf"linear laws only.*x {name}.*--to casadi"):
            export(other, to)
        return

    off = run.deviation(other, to, tmp_path, given, motion.integrated(other, given))

    assert (off < (EXACT if linear else BENT if name == "limited_acceleration" else STEPPED)).all(), off


def test_the_laws_of_a_lagged_vehicle_run_in_octave_too(
    run: ModuleType, motion: ModuleType, model: Model, tmp_path: Path
) -> None:
    needed(run, "matlab")
    other = with_laws(model, dict.fromkeys(AXES, ("second_order", {"lag": 0.3})))

    assert (run.deviation(other, "matlab", tmp_path, motion.drive(7, 0.05, duration=4.0)) < STEPPED).all()


def test_steps_err_with_the_fourth_power_of_their_length(
    run: ModuleType, motion: ModuleType, model: Model, tmp_path: Path
) -> None:
    undelayed = with_laws(model, dict.fromkeys(AXES, ("first_order", {})))
    given = motion.drive(8, 0.1, duration=5.0)
    made, truth = export(undelayed, "numpy", name="bebop"), motion.integrated(undelayed, given)
    errors = []
    for longest in ("0.1", "0.05"):
        coarse = replace(made, text=made.text.replace("LONGEST = 0.037", f"LONGEST = {longest}"))
        assert coarse.text != made.text
        errors.append(np.abs(run.run_numpy(coarse, tmp_path, given) - truth).max())

    assert 12 < errors[0] / errors[1] < 20


def test_a_rounded_delay_would_be_off_by_more_than_a_thousand_times_as_much(
    run: ModuleType, motion: ModuleType, model: Model, tmp_path: Path
) -> None:
    given = motion.drive(3, 0.05, duration=5.0)
    truth = motion.reference(model, given)

    exact = run.deviation(model, "numpy", tmp_path, given, truth)
    rounded = run.deviation(model, "numpy", tmp_path, given, truth, round_delay=True)

    assert exact[0] < STEPPED
    assert rounded[0] > 1e3 * STEPPED


def test_rounding_the_delay_is_written_down_with_its_size(model: Model) -> None:
    made = export(model, "c", dt=0.05, round_delay=True)

    assert made.notes[0] == (
        "The delay of x is rounded to whole samples of 0.05 s, as was asked: 0.1664 s to 0.15 s, 16.4 ms shorter."
    )
    assert "16.4 ms shorter" in made.text
    assert "PARTS = 1" in made.text


def test_no_export_lets_a_command_act_before_it_is_sent(model: Model) -> None:
    x = model.axes["x"]
    assert x.predictor is not None
    early = replace(model, axes={**model.axes, "x": replace(x, predictor=replace(x.predictor, delay=-0.03))})

    made = export(early, "c", dt=0.02)

    assert made.notes[0] == (
        "The delay of x is negative in the model, -0.0300 s, and 0 here: no command acts before it is sent."
    )
    rows = re.findall(r"^ *\{ ((?:-?\d+, )+-?\d+) \},$", made.text, re.MULTILINE)
    ages = [int(age) for row in rows for age in row.split(",")]
    assert rows
    assert min(ages) == 0


def test_a_command_that_moves_the_vehicle_backwards_is_told(model: Model) -> None:
    z = model.axes["z"]
    assert z.predictor is not None
    turned = replace(model, axes={**model.axes, "z": replace(z, predictor=replace(z.predictor, input=-2.0))})

    assert "The input of z is negative: a positive command moves the vehicle down." in " ".join(
        export(turned, "numpy").notes
    )
    assert not any("is negative" in note for note in export(model, "numpy").notes)


def test_an_axis_that_the_data_cannot_tell_is_left_out_with_a_sentence_and_keeps_its_velocity(
    run: ModuleType, model: Model, tmp_path: Path
) -> None:
    made = export(untold(model, "z"), "numpy")
    module = run.loaded(made, tmp_path)

    assert made.axes == ("x", "y", "yaw")
    said = (
        "z is left out and keeps its velocity: the data cannot tell delay (not_identifiable), but steady gain and "
        "total lag; the option predictor exports the point that predicts best."
    )
    assert made.notes == (said,)
    assert said in " ".join(made.text.split())
    state = module.flow(module.start([0, 0, 1, 0], [0, 0, 0.3, 0]), [0, 0, 1, 0], 2.0)
    assert state[[2, 6]] == pytest.approx([1.6, 0.3])


def test_an_axis_whose_zero_may_be_none_is_exported(model: Model) -> None:
    """A zero below a bound moves the vehicle hardly otherwise than none."""
    z = model.axes["z"]
    assert z.predictor is not None
    overshooting = replace(
        z,
        structure="second_order_zero",
        extra={"lag": 0.1, "zero": None},
        predictor=replace(z.predictor, extra={"lag": 0.1, "zero": 0.01}),
        ci95={**z.ci95, "lag": (0.09, 0.11), "zero": (None, 0.03)},
        status={**z.status, "lag": "ok", "zero": "not_identifiable"},
    )
    unbounded = replace(overshooting, ci95={**overshooting.ci95, "zero": (None, None)})

    assert "z" in export(replace(model, axes={**model.axes, "z": overshooting}), "numpy").axes
    assert "z" not in export(replace(model, axes={**model.axes, "z": unbounded}), "numpy").axes


def test_errors_among_the_findings_are_told(model: Model) -> None:
    wrong = Finding("zeros_between_commands", "error", "", "", "")
    bad_z = Finding("sign_flipped", "error", "", "", "", "z")

    made = export(with_findings(model, [wrong, bad_z, wrong, replace(bad_z, severity="warning")]), "numpy")

    assert made.notes == (
        "The finding zeros_between_commands is an error: do not use any axis before it is cured.",
        "The finding sign_flipped is an error: do not use z before it is cured.",
    )


def test_it_is_exported_by_the_point_that_predicts_best_where_that_is_asked_for(model: Model) -> None:
    made = export(untold(model, "z"), "numpy", predictor=True)

    assert made.axes == AXES
    assert "z is exported by the point that predicts best, as was asked" in made.text
    assert "DAMPING_Z = 2.05  #" in made.text


def test_delays_that_hold_the_offset_of_two_clocks_are_not_told_as_the_vehicles(model: Model) -> None:
    told = Finding("clock_includes_delay", "warning", "two files", "no delay", "one clock")
    made = export(replace(untold(model, "z"), findings=(told,)), "numpy", predictor=True)

    assert any(note.startswith("The delays are not the vehicle's: two clocks recorded it") for note in made.notes)
    assert made.notes[-1] in " ".join(made.text.split())


def test_a_structures_further_parameter_that_is_not_known_leaves_the_axis_out(model: Model) -> None:
    lagged = with_laws(model, {"y": ("first_order_delay_lag", {"lag": 0.1})})
    lagged = replace(lagged, axes={**lagged.axes, "y": replace(lagged.axes["y"], extra={"lag": None})})

    made = export(lagged, "numpy")

    assert made.axes == ("x", "z", "yaw")
    assert "the data cannot tell lag" in made.notes[0]


def test_commands_of_coupled_axes_in_different_units_are_not_made_physical(model: Model) -> None:
    coupled = with_laws(model, dict.fromkeys(("x", "y"), ("coupled", OTHERS["coupled"])))
    mixed = demo_card(x="{ from = 'a', meaning = 'tilt', full_scale = 'tilt' }", y="{ from = 'b', unit = 'rad' }")

    export(coupled, "numpy", physical=True)
    with pytest.raises(ModelError, match="x also answers to the command of y"):
        export(replace(coupled, card=mixed), "numpy", physical=True)


def test_an_axis_that_is_coupled_with_one_that_is_left_out_goes_too(model: Model) -> None:
    coupled = with_laws(model, dict.fromkeys(("x", "y"), ("coupled", OTHERS["coupled"])))

    assert export(untold(coupled, "y", "input"), "casadi").axes == ("z", "yaw")


def test_where_nothing_is_left_the_error_says_what_to_try(model: Model) -> None:
    nothing = replace(model, axes={axis: unknown_axis("not_excited") for axis in AXES})
    hidden = model
    for axis in AXES:
        hidden = untold(hidden, axis)

    with pytest.raises(ExportError, match="fit a flight that moves an axis, as `rotorfit plan` designs one") as told:
        export(nothing, "c")
    assert "x, y, z and yaw: the model has no numbers for it (not_excited)" in str(told.value)
    assert str(told.value).count("no numbers") == 1
    with pytest.raises(ExportError, match="--predictor exports the point that predicts best"):
        export(hidden, "c")


def test_physical_commands_move_the_vehicle_as_their_fractions_do(
    run: ModuleType, motion: ModuleType, model: Model, tmp_path: Path
) -> None:
    given = motion.drive(9, 0.02, duration=4.0)
    made = export(model, "numpy", physical=True)
    limit = np.array([CARD.limits["tilt"], CARD.limits["tilt"], CARD.limits["vertical_speed"], CARD.limits["yaw_rate"]])

    off = run.run_numpy(made, tmp_path, replace(given, command=given.command * limit)) - motion.reference(model, given)

    assert np.abs(off).max() < STEPPED
    assert "tilt asked for [rad]" in made.text
    assert "K:" not in export(model, "ros1", physical=True).text.replace("# There is no K", "")


def test_an_export_of_a_converted_model_tells_no_limit_of_its_flights(model: Model) -> None:
    said = export(convert(model, {"vertical_speed": 0.6}), "numpy", physical=True, trained={}).text

    assert "divided by 0.6 m/s, its limit by the card of the model" in " ".join(said.replace("#", " ").split())
    assert "speeds not known: the model was converted to other limits than those of its flights" in said


def test_physical_commands_need_a_card_that_says_what_they_are(model: Model) -> None:
    vague = replace(model.card, limits={})

    with pytest.raises(ExportError, match="does not say what its limit of tilt was"):
        export(replace(model, card=vague), "c", physical=True)


def test_the_header_says_what_stamps_leave_unknown_of_the_delays(model: Model) -> None:
    effect = "delays come out up to 34 ms too short, and their intervals reach 34 ms higher"
    rows = Finding("commands_by_row", "info", "each row holds a command", effect, "log commands apart")

    assert effect in " ".join(export(replace(model, findings=(rows,)), "numpy").text.split())
    assert "stamps" not in export(model, "numpy").text.split("Validity", 1)[0]


def test_the_c_header_compiles_without_a_warning_and_allocates_nothing(
    run: ModuleType, model: Model, tmp_path: Path
) -> None:
    needed(run, "c")
    lagged = with_laws(model, MIXED)
    for number, one in enumerate((model, lagged, untold(untold(model, "x"), "yaw"), untold(lagged, "y", "damping"))):
        folder = tmp_path / str(number)
        folder.mkdir()
        program = run.compiled(export(one, "c", name="bebop"), folder, options=("-Wconversion", "-Wshadow"))
        symbols = subprocess.run(["nm", "-u", str(program)], capture_output=True, text=True, check=True).stdout
        assert not {"malloc", "calloc", "realloc"} & set(symbols.replace("@", " ").split())


@pytest.mark.parametrize("to", [name for name, form in FORMATS.items() if form.suffix == ".py"])
def test_generated_python_is_clean(to: str, model: Model, tmp_path: Path) -> None:
    for number, one in enumerate((model, with_laws(model, {"y": MIXED["y"]}), untold(model, "x"))):
        path = tmp_path / f"bebop{number}.py"
        export(one, to, path)
        ruff = [sys.executable, "-m", "ruff"]
        checked = [*ruff, "check", "--isolated", "--line-length=120", "--select=E,F,W,I,UP", str(path)]
        formatted = [*ruff, "format", "--isolated", "--line-length=120", "--check", str(path)]
        for command in (checked, formatted):
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            assert done.returncode == 0, done.stdout


@pytest.mark.parametrize("to", FORMATS)
def test_every_export_states_units_limits_validity_and_where_it_comes_from_and_no_date(
    to: str, model: Model, tmp_path: Path
) -> None:
    path = tmp_path / "model.json"
    save(model, path)

    first, second = export(path, to), export(path, to)

    assert first.text == second.text
    for said in (
        f"ritten by rotorfit export 0.1.0, format {to}.",
        "fraction of the tilt limit",
        "from -1 to 1",
        "damping 2.05",
        "delay 0.0529 (0.0429 to 0.0629) s",
        "Validity",
        "speeds not known",
        "x, y, z [m] and yaw [rad] in the world frame",
        "c is 0",
        "model.json",
    ):
        assert said in " ".join(first.text.split()), said
    digest = subprocess.run(["sha256sum", str(path)], capture_output=True, text=True, check=True).stdout.split()[0]
    assert digest in first.text
    assert export(model, to).text.count(digest) == first.text.count(digest)


def test_a_card_of_any_name_cannot_break_out_of_the_comments(run: ModuleType, model: Model, tmp_path: Path) -> None:
    vile = replace(
        model, card=replace(model.card, name='x */ """ --> \\\n#error\nimport os \x00 % ${1/0} {{ 7 * 7 }} <')
    )

    for to, form in FORMATS.items():
        text = export(vile, to, name="bebop").text
        if form.suffix == ".py":
            body = ast.parse(text).body
            assert isinstance(body[0], ast.Expr)
            assert not any(isinstance(node, ast.Import) and node.names[0].name == "os" for node in body)
        elif to == "gazebo":
            ET.fromstring(text)
        elif to == "c":
            if not run.missing("c"):
                run.compiled(export(vile, to, name="bebop"), tmp_path)
        else:
            comment = text[: text.index("fitted")].splitlines()
            assert all(line.startswith(("#", "%", "function")) for line in comment), to


def test_the_k_of_drone_dev_is_gamma_in_its_order_and_needs_all_four_axes(model: Model) -> None:
    line = next(line for line in export(model, "ros1").text.splitlines() if line.startswith("K: "))

    assert json.loads(line[3:]) == pytest.approx([value for axis in AXES for value in POINTS[axis][:2]])
    assert "There is no K" in export(untold(model, "z"), "ros1").text


def test_parameters_are_doubles_for_a_reader_of_ros() -> None:
    from ruamel.yaml import YAML

    reader = YAML(typ="safe", pure=True)
    reader.version = (1, 1)  # type: ignore[assignment]
    slow = model_of({**POINTS, "x": (3e-5, 2.0, 0.0)})
    raw: Any = reader.load(export(slow, "ros2", name="bebop").text)
    own = raw["/**"]["ros__parameters"]["bebop"]

    assert own["axes"] == list(AXES)
    assert own["x"]["input"] == 3e-5
    assert all(isinstance(own[axis][name], float) for axis in AXES for name in ("input", "damping", "delay"))


@pytest.mark.parametrize("how", [{"physical": True}, {"round_delay": True}, {}])
def test_intervals_are_given_of_what_is_exported_as_it_was_estimated(how: dict[str, bool], model: Model) -> None:
    from ruamel.yaml import YAML

    own: Any = YAML(typ="safe", pure=True).load(export(model, "ros2", name="bebop", **how).text)
    own = own["/**"]["ros__parameters"]["bebop"]["x"]
    for name in ("input", "damping", "delay"):
        low, high = own.get(f"{name}_ci95", (-np.inf, np.inf))
        assert low <= own[name] <= high
    assert ("input_ci95" in own, "damping_ci95" in own, "delay_ci95" in own) == (
        "physical" not in how, True, "round_delay" not in how
    )  # fmt: skip


def test_python_control_designs_a_regulator_that_holds_the_model(run: ModuleType, model: Model, tmp_path: Path) -> None:
    needed(run, "python-control")
    import control

    plant = run.loaded(export(model, "python-control"), tmp_path).sampled(0.05, heading=0.7)
    Q = np.diag([1.0] * 8 + [0.0] * (plant.nstates - 8))

    gain, _, poles = control.dlqr(plant, Q, np.eye(4))

    assert np.abs(poles).max() < 1
    x = np.zeros(plant.nstates)
    x[:4] = 0.5
    for _ in range(200):
        x = plant.dynamics(0.0, x, -gain @ x)
    assert np.abs(x).max() < 0.02


def test_a_pade_delay_is_an_approximation_that_its_order_improves(
    run: ModuleType, model: Model, tmp_path: Path
) -> None:
    needed(run, "python-control")
    import control

    module = run.loaded(export(model, "python-control"), tmp_path)
    time = np.linspace(0.0, 3.0, 301)
    command = np.zeros((4, time.size))
    command[0] = 0.2
    truth = simulate(model, np.array([0.0]), command[:, :1].T, time, before=command[:, 0]).pose[:, 0]
    late = np.interp(time - POINTS["x"][2], time, truth, left=0.0)
    off = []
    for order in (1, 3):
        path = control.forced_response(module.continuous(pade=order), time, command).outputs[0]
        off.append(np.abs(path - late).max())

    assert off[0] < 2e-3
    assert off[1] < off[0] / 3


def test_with_one_of_x_and_y_the_state_space_holds_along_the_heading_only(
    run: ModuleType, model: Model, tmp_path: Path
) -> None:
    needed(run, "python-control")
    module = run.loaded(export(untold(model, "y"), "python-control"), tmp_path)

    assert module.sampled(0.05).ninputs == 3
    with pytest.raises(ValueError, match="heading, which must be 0"):
        module.sampled(0.05, heading=0.1)


def test_jax_differentiates_through_the_delay(run: ModuleType, model: Model, tmp_path: Path) -> None:
    needed(run, "jax")
    import jax

    jax.config.update("jax_enable_x64", True)
    module = run.loaded(export(model, "jax"), tmp_path)
    state, past = module.start([0.0, 0.0, 1.0, 0.3], dt=0.05)

    def reach(commands: Any) -> Any:
        return module.rollout(state, past, commands, 0.05)[-1, 0]

    commands = np.full((20, 4), 0.1)
    reach = jax.jit(reach)
    slope = jax.jit(jax.grad(reach))(commands)
    nudged = commands.copy()
    nudged[2, 0] += 1e-6
    assert float(slope[2, 0]) == pytest.approx(float(reach(nudged) - reach(commands)) / 1e-6, rel=1e-4)
    assert (np.asarray(slope[-3:, 0]) == 0).all()  # still on their way at the end
    assert slope[-4, 0] > 0


def test_casadi_gives_acados_what_it_asks_for(
    run: ModuleType, model: Model, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    needed(run, "casadi")
    import casadi

    fake = types.ModuleType("acados_template")  # the real one is not on the package index
    fake.AcadosModel = type("AcadosModel", (), {})  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "acados_template", fake)
    module = run.loaded(export(model, "casadi", name="bebop"), tmp_path)

    given = module.acados_model(0.05)

    again = casadi.Function("again", [given.x, given.u, given.p], [given.disc_dyn_expr])
    xi = module.start([0, 0, 1, 0.4], [0.1, 0, 0, 0.2], dt=0.05)
    expected = module.predictor(0.05)(xi, [0.2, 0.1, 0, 0], 0)
    assert float(casadi.norm_inf(again(xi, [0.2, 0.1, 0, 0], 0) - expected)) == 0.0
    assert given.name == "bebop"


def test_numpy_moves_many_vehicles_at_once_and_a_trim_pushes_in_the_heading_frame(
    run: ModuleType, model: Model, tmp_path: Path
) -> None:
    module = run.loaded(export(model, "numpy"), tmp_path)
    starts = np.stack([module.start([0, 0, 1, heading]) for heading in (0.0, np.pi / 2)])

    ends = module.flow(starts, np.zeros((2, 4)), 1.0, trim=[0.5, 0.0, 0.0, 0.0])

    g, b = 0.5, POINTS["x"][1]
    way = g / b * (1 - (1 - np.exp(-b)) / b)
    assert ends[0, :2] == pytest.approx([way, 0.0], abs=1e-8)
    assert ends[1, :2] == pytest.approx([0.0, way], abs=1e-8)


def test_rotorpys_velocity_command_becomes_the_command_whose_steady_speed_it_is(
    run: ModuleType, model: Model, tmp_path: Path
) -> None:
    vehicle = run.loaded(export(model, "rotorpy"), tmp_path).Vehicle(pose=(0.0, 0.0, 1.0, np.pi / 2))
    state = vehicle.initial_state

    command = vehicle.command(state, {"cmd_v": np.array([0.0, 1.0, 0.5])})

    assert command == pytest.approx([0.18 / 3.7, 0.0, 0.5 * 2.05 / 2.3, 0.0], abs=1e-12)
    for _ in range(500):
        state = vehicle.step(state, {"cmd_v": np.array([0.0, 0.0, 0.5])}, 0.02)
    assert state["v"] == pytest.approx([0.0, 0.0, 0.5], abs=1e-6)


def test_a_second_run_of_rotorpy_begins_like_the_first(run: ModuleType, model: Model, tmp_path: Path) -> None:
    vehicle = run.loaded(export(model, "rotorpy"), tmp_path).Vehicle(pose=(0.0, 0.0, 1.0, 0.5))
    runs = []
    for _ in range(2):
        state = vehicle.initial_state
        for _ in range(50):
            state = vehicle.step(state, {"cmd_model": [0.2, -0.1, 0.1, 0.3]}, 0.02)
        runs.append(state["x"])

    np.testing.assert_array_equal(runs[1], runs[0])


def test_the_example_in_the_header_of_rotorpys_vehicle_runs(run: ModuleType, model: Model, tmp_path: Path) -> None:
    needed(run, "rotorpy")
    module = run.loaded(export(model, "rotorpy"), tmp_path)
    example = textwrap.dedent("    from rotorpy" + module.__doc__.split("    from rotorpy", 1)[1])

    exec(example, module.__dict__)

    state = module.result["state"]
    assert module.result["time"][-1] == pytest.approx(10.0, abs=0.02)
    assert state["w"][-1] == pytest.approx([0.0, 0.0, 0.2], abs=1e-6)


def test_gazebo_holds_the_default_law_only(model: Model) -> None:
    with pytest.raises(
        ExportError,
        match=r"gazebo holds the first-order law with a delay only, .* has y first_order_delay_lag",
    ):
        export(with_laws(model, {"y": MIXED["y"]}), "gazebo")


def test_gazebo_needs_an_axis_that_settles_wherever_it_has_a_gain(model: Model) -> None:
    with pytest.raises(ExportError, match=r"four axes, and the model does not know the .* of z; try --predictor"):
        export(untold(model, "z"), "gazebo")
    known = untold(untold(model, "z"), "yaw")
    with pytest.raises(ExportError, match=r"of z and the model does not know the .* of yaw; try --predictor, or"):
        export(known, "gazebo")
    with pytest.raises(ExportError, match="x is left out or has no positive damping; fit a flight that moves it, or"):
        export(model_of({**POINTS, "x": (3.7, -0.1, 0.1)}), "gazebo")


def test_what_the_flights_of_the_fit_cover_is_told_axis_by_axis() -> None:
    t = np.arange(0.0, 10.0, 0.02)
    flight = by_hand(t, np.outer(t, [0.5, 0.0, 0.0, 0.0]), t, np.full((t.size, 4), [0.3, 0.0, 0.0, 0.0]))

    told = trained_on([replace(flight, axes=("x",))])

    assert told == {"x": (pytest.approx(0.5), 0.3)}


def test_a_vehicle_that_mostly_hovers_was_commanded_all_the_same() -> None:
    t = np.arange(0.0, 10.0, 0.02)
    flight = by_hand(t, np.outer(t, [0.5, 0.0, 0.0, 0.0]), t, np.outer(t < 0.05, [0.3, 0.0, 0.0, 0.0]))

    assert trained_on([replace(flight, axes=("x",))])["x"][1] == 0.3


@pytest.mark.parametrize(("physical", "said"), [(False, "0.23 of the limit"), (True, "0.0803 rad")])
def test_commands_of_the_training_are_told_in_the_commands_of_the_export(
    model: Model, physical: bool, said: str
) -> None:
    assert f"commands up to {said}" in unwrapped(
        export(model, "numpy", physical=physical, trained={"x": (0.744, 0.23)}).text
    )


def unwrapped(text: str) -> str:
    return " ".join(text.replace("#", " ").split())


def test_scores_are_those_of_the_validation_or_of_the_models_own_proof(model: Model) -> None:
    axes = {axis: AxisScore({"1": Horizon(0.0123, 0.0456, 20)}, 90.0) for axis in AXES}
    flight = FlightScores("proof.csv", (0.0, 60.0), axes, "predicted", moved=("x",))

    known, proof = ({"flights": [asdict(one)]} for one in (flight, replace(flight, fitted=True)))

    (line,) = scores(known, AXES)
    assert line == "x on proof.csv: 1 s 0.0123 m/s and 0.0456 m"
    assert scores(proof, AXES) == [f"{line}; the model was fitted to part of it, which proves nothing"]
    assert scores(known, ("z",)) == ["None: no flight was long enough to be predicted."]
    assert "Not known" in scores(None, AXES)[0]
    own = f"{line}; the model was fitted to part of it, which proves nothing"
    assert own in unwrapped(export(replace(model, leave_one_out=proof), "numpy").text)


def test_an_axis_without_a_position_is_told_by_its_velocity() -> None:
    axes = {"x": AxisScore({"1": Horizon(0.0123, None, 20)}, 90.0)}
    flight = FlightScores("proof.csv", (0.0, 60.0), axes, "predicted", moved=("x",))

    assert scores({"flights": [asdict(flight)]}, AXES) == ["x on proof.csv: 1 s 0.0123 m/s"]


@pytest.mark.parametrize("physical", [False, True])
def test_what_is_scored_is_what_stands_in_the_file(model: Model, physical: bool) -> None:
    axes = {axis: AxisScore({"1": Horizon(0.0123, 0.0456, 20)}, 90.0) for axis in AXES}
    proof = Validation((FlightScores("proof.csv", (0.0, 60.0), axes, "predicted", moved=("x",)),), {}, residuals=({},))
    seen: list[Model] = []

    def score(exported: Model) -> Validation:
        seen.append(exported)
        return proof

    made = export(model, "numpy", dt=1.0, round_delay=True, physical=physical, score=score)
    known, asked = made.model.axes["x"].predictor, seen[0].axes["x"].predictor
    assert known is not None
    assert asked is not None
    assert (asked.input, asked.delay, known.delay) == (3.7, 0.0, 0.0)
    assert known.input == pytest.approx(3.7 / (np.deg2rad(20) if physical else 1))
    assert "x on proof.csv" in made.text
    old = export(model, "numpy", dt=1.0, round_delay=True, validation=to_mapping(proof)).text
    assert "x on proof.csv" not in old
    assert "x: not known: the model was scored with another delay" in unwrapped(old)


def test_unknown_formats_and_sample_periods_are_refused(model: Model, tmp_path: Path) -> None:
    with pytest.raises(ExportError, match="no such format: 'simulink'; formats are python-control"):
        export(model, "simulink")
    with pytest.raises(ExportError, match="sample period"):
        export(model, "c", dt=0.0)
    with pytest.raises(ExportError, match=r"call it my_drone\.m"):
        export(model, "matlab", tmp_path / "My-Drone.m")
    with pytest.raises(ExportError, match=r"call it model_step\.m"):
        export(model, "matlab", tmp_path / "step.m")
    for to, name in (("numpy", "numpy.py"), ("python-control", "scipy.py")):
        with pytest.raises(ExportError, match="imports a module of this name"):
            export(model, to, tmp_path / name)


@pytest.mark.parametrize(
    "name", ["ceil", "cos", "diff", "eye", "floor", "max", "numel", "repmat", "sin", "sum", "unique", "zeros"]
)
def test_no_matlab_file_hides_a_function_that_it_calls(model: Model, tmp_path: Path, name: str) -> None:
    assert f"{name}(" in export(model, "matlab").text
    with pytest.raises(ExportError, match=rf"call it model_{name}\.m"):
        export(model, "matlab", tmp_path / f"{name}.m")


def cli(*arguments: object) -> Any:
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


def test_the_verb_lists_what_there_is() -> None:
    listed, raw = cli("export"), cli("export", "--json")

    assert all(name in listed.output for name in FORMATS)
    assert list(json.loads(raw.output)["formats"]) == list(FORMATS)


def test_the_verb_writes_the_file_and_says_what_was_left_out(model: Model, tmp_path: Path) -> None:
    path, target = tmp_path / "model.json", tmp_path / "bebop.h"
    save(untold(model, "z"), path)

    said, raw = (cli("export", path, "--to", "c", "-o", target, *more) for more in ((), ("--json",)))

    assert said.exit_code == 0, said.output
    assert "z is left out" in said.output
    assert "bebop_step" in target.read_text()
    told = json.loads(raw.output)
    assert list(told["axes"]) == ["x", "y", "yaw"]
    assert told["axes"]["x"]["delay"] == POINTS["x"][2]


def test_the_verb_never_writes_over_what_is_no_export(model: Model, tmp_path: Path) -> None:
    path, log = tmp_path / "model.json", tmp_path / "flight.csv"
    save(model, path)
    log.write_text("time,x\n0,1\n")

    for target in (log, path):
        refused = cli("export", path, "--to", "c", "-o", target)
        assert refused.exit_code == 1
        assert "not overwritten" in refused.output
    assert cli("export", path, "--to", "c").exit_code == 2


def example(language: str) -> str:
    (found,) = re.findall(rf"^```{language}\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)
    return str(found)


def test_the_mpc_of_the_page_tracks_a_step_in_thirty_lines_or_so(run: ModuleType, model: Model, tmp_path: Path) -> None:
    needed(run, "casadi")
    code = example("python")
    export(model, "casadi", tmp_path / "bebop.py")
    (tmp_path / "mpc.py").write_text(code)

    done = subprocess.run([sys.executable, "mpc.py"], cwd=tmp_path, capture_output=True, text=True, check=True)

    assert sum(bool(line.strip()) for line in code.splitlines()) <= 32
    assert float(done.stdout.rpartition(":")[2]) < 0.002


def test_the_c_program_of_the_page_runs(run: ModuleType, model: Model, tmp_path: Path) -> None:
    needed(run, "c")
    program = run.compiled(export(model, "c", name="bebop"), tmp_path, example("c"))

    at, later, speed = (float(word) for word in re.findall(r"\d\.\d{3}", subprocess.check_output([program], text=True)))

    sent, hover = np.array([0.2, 0.0, 0.0, 0.0]), np.zeros(4)
    truth = simulate(model, np.array([-1.0, 0.0, 1.0]), np.array([hover, sent, hover]), np.array([0.0, 1.0, 1.5]))
    assert [at, later, speed] == pytest.approx([*truth.pose[1:, 0], truth.velocity[2, 0]], abs=6e-4)


def test_the_page_lists_every_format_and_every_extra() -> None:
    project = tomllib.loads((BENCH.parent / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    listed = re.findall(r"^\| `(\w[\w-]*)` \|", PAGE, re.MULTILINE)

    assert listed == list(FORMATS)
    for form in FORMATS.values():
        for extra in re.findall(r"rotorfit\[(\w+)\]", form.needs):
            assert extra in project["optional-dependencies"]
