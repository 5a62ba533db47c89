"""Files that version 0.1 wrote load and give the same numbers: models, plans, gains, cards."""

import json
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rotorfit as rf
from files.version_0_1.numbers_of import FOLDER, numbers_of
from rotorfit.core.flight_plan import command_at, reference_at
from rotorfit.exports.gains import tuning_mapping
from rotorfit.files.cards import builtin_cards
from rotorfit.files.models import to_mapping
from rotorfit.files.plans import plan_mapping

CARDS_OF_0_1 = (
    "ardrone-odometry", "ardrone-optitrack", "ardrone-vicon", "ardrone2-optitrack", "arducopter", "arducopter-3.2",
    "arducopter-3.2-guided", "arducopter-3.3", "arducopter-4.0", "arducopter-guided", "bebop2", "bebop2-drone-dev",
    "bebop2-joystick", "bebop2-odometry", "bebop2-optitrack", "bebop2-vrpn", "bebop2-wsu", "crazyflie-cfclient",
    "crazyswarm2-hover", "crazyswarm2-world", "dji-hexarotor", "dji-sdk", "mavlink", "mavros-raw-body",
    "mavros-raw-world", "mavros-velocity", "px4", "px4-offboard", "rotorfit-demo", "tello", "tello-telemetry",
)  # fmt: skip
ROUNDING = 1e-9
"""Other systems have an `exp` of their own, sums by BLAS differ from processor to processor, and kernels round products
otherwise in the process that compiles them than in those that load them: relative differences of 1e-14 were seen."""
STEPS = 5e-6
"""Version 0.1 knew no command before the first. Stating one adds a step of the motion, at which the heading is taken
anew: differences of 2e-6 m were seen where it turns."""


def flat(value: Any) -> list[float]:
    """All numbers of nested lists and mappings, in order."""
    if isinstance(value, dict):
        return [number for part in value.values() for number in flat(part)]
    if isinstance(value, list):
        return [number for part in value for number in flat(part)]
    return [np.nan if value is None else float(value)]


def test_models_cards_and_flights_of_version_0_1_give_the_numbers_that_it_gave() -> None:
    before = json.loads((FOLDER / "numbers.json").read_text(encoding="utf-8"))
    now = json.loads(json.dumps(numbers_of()))

    assert now.keys() == before.keys()
    assert now["flight"] == pytest.approx(before["flight"], rel=ROUNDING)
    for name in before.keys() - {"flight"}:
        for part, atol in (("pose", STEPS), ("velocity", STEPS), ("predictions", 0.0)):
            np.testing.assert_allclose(
                flat(now[name][part]), flat(before[name][part]), rtol=ROUNDING, atol=atol, err_msg=f"{name}: {part}"
            )


@pytest.mark.parametrize("path", sorted(FOLDER.glob("model*.json")), ids=lambda path: path.stem)
def test_a_model_of_version_0_1_is_written_again_as_it_was(path: Path) -> None:
    assert json.loads(json.dumps(to_mapping(rf.load(path)))) == json.loads(path.read_text(encoding="utf-8"))


@pytest.mark.parametrize("path", sorted(FOLDER.glob("plan*.toml")), ids=lambda path: path.stem)
def test_a_plan_of_version_0_1_is_the_same_plan(path: Path) -> None:
    plan = rf.load_plan(path)
    t = np.arange(0.0, plan.duration, 0.1)
    said = tomllib.loads(path.read_text(encoding="utf-8"))

    assert {**json.loads(json.dumps(plan_mapping(plan))), "rotorfit": said["rotorfit"]} == said
    stored = np.load(FOLDER / "commands.npz")[path.stem]
    np.testing.assert_allclose(
        np.hstack([command_at(plan, t), reference_at(plan, t)[0]]), stored, rtol=1e-12, atol=1e-14
    )


def test_gains_of_a_model_of_version_0_1_are_those_that_it_wrote() -> None:
    said = tomllib.loads((FOLDER / "gains.toml").read_text(encoding="utf-8"))
    model = rf.load(FOLDER / "model.json")
    now = tuning_mapping(rf.tune(model), model)

    assert now["axes"].keys() == said["axes"].keys()
    for axis, one in said["axes"].items():
        for name in ("bandwidth", "input", "damping", "delay", "stiffness", "rate_gain", "observer"):
            np.testing.assert_allclose(now["axes"][axis][name], one[name], rtol=1e-9, err_msg=f"{axis}.{name}")


def test_every_card_of_version_0_1_loads() -> None:
    assert set(CARDS_OF_0_1) <= set(builtin_cards())
    complete = rf.load_card(FOLDER / "card-complete.toml")
    assert complete.raw == tomllib.loads((FOLDER / "card-complete.toml").read_text(encoding="utf-8"))
