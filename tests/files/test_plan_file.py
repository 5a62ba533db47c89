"""Plan files: what is written is read again, and every mistake is told in one line with its place."""

import math
import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from rotorfit.core.errors import PlanError
from rotorfit.core.flight_plan import AxisExcitation, Chirp, Feedback, Plan, Sines, Space, Steps
from rotorfit.files.cards import load_card
from rotorfit.files.plans import load_plan, plan_from_mapping, plan_from_text, plan_mapping, plan_text, save_plan
from rotorfit.planning.belief import belief_from_card, belief_mapping

CARD = load_card("rotorfit-demo")
SPACE = Space((-2.7, -1.7, 0.5), (2.7, 1.7, 2.7), (0.1, 0.0, 1.6, 0.3), 1.5, 1.0)
PLAN = Plan(
    name="everything", design="by hand", card=CARD.raw, rate=50.0, duration=30.0, ramp=2.0,
    excitations=(
        AxisExcitation("x", "command", 1.0, 20.0, Sines((0.1, 0.05), (1.0, 1.0 / 3.0), (0.0, math.pi / 2))),
        AxisExcitation("y", "command", 1.0, 20.0, Steps((0.0, 0.7, 1.4), (0.2, -0.2, 0.0))),
        AxisExcitation("z", "position", 2.0, 25.0, Chirp(0.3, (0.5, 5.0), 25.0)),
    ),
    feedback=Feedback(("x", "z", "yaw"), (0.3, 0.3, 0.6, 0.6), (0.5, 0.5, 1.0, 1.0), 0.07),
    space=SPACE, belief=belief_mapping(belief_from_card(CARD)),
    predicted={"stderr": {"x": {"input": 0.01}}, "notes": ["a note"]}, seed=4,
)  # fmt: skip


@pytest.mark.parametrize("plan", [PLAN, replace(PLAN, feedback=None, excitations=PLAN.excitations[:1], predicted={})])
def test_a_plan_is_read_as_it_was_written(plan: Plan, tmp_path: Path) -> None:
    save_plan(plan, tmp_path / "plan.toml")
    assert load_plan(tmp_path / "plan.toml") == plan


def test_the_file_says_at_its_head_what_it_is() -> None:
    text = plan_text(PLAN)
    assert text.startswith("# A flight for `rotorfit fly`.")
    assert b'"rotorfit-plan"' in text.encode()[:4096].lower()


def edited(change: Callable[[dict[str, Any]], object]) -> dict[str, Any]:
    raw = tomllib.loads(plan_text(PLAN))
    change(raw)
    return raw


def put(*places: str | int, value: object) -> Callable[[dict[str, Any]], object]:
    def change(raw: Any) -> None:
        for place in places[:-1]:
            raw = raw[place]
        raw[places[-1]] = value

    return change


WRONG = [
    (put("duratoin", value=3.0), "plan p.toml: unknown key 'duratoin'; nearest: 'duration'"),
    (put("space", "speeds", value=3.0), r"plan p.toml, \[space\]: unknown key 'speeds'; nearest: 'speed'"),
    (put("feedback", "stifness", value=3.0), r"\[feedback\]: unknown key 'stifness'; nearest: 'stiffness'"),
    (put("excitations", 0, "amplitudes", value=[1.0]), "excitation 1: unknown key 'amplitudes'; nearest: 'amplitude'"),
    (put("excitations", 1, "frequency", value=[1.0]), "excitation 2: unknown key 'frequency'"),
    (put("excitations", 0, "axis", value="pitch"), "excitation 1, axis: 'pitch' is not one of x, y, z, yaw"),
    (put("excitations", 0, "signal", value="sine"), "'sine' is not one of sines, chirp, steps; nearest: 'sines'"),
    (put("excitations", 0, "phase", value=[0.0]), "must have the same length"),
    (put("excitations", 1, "time", value=[0.0, 2.0, 1.0]), "time must increase"),
    (put("excitations", 1, "time", value=[0.0, 1.0, 1.0]), "time must increase"),
    (put("excitations", 1, "level", value=[0.0, math.nan, 1.0]), "must be a list of finite numbers"),
    (put("excitations", 1, "target", value="position"), "must move smoothly"),
    (put("excitations", 2, "sweep", value=10.0), "excitation 3, frequency: 158.114 "),  # 0.5 rad/s times 10 ** 2.5
    (put("excitations", 2, "sweep", value=1e-3), "excitation 3, frequency: "),
    (put("excitations", 0, "duration", value=40.0), "it ends at 41 s, after the plan, which lasts 30 s"),
    (put("excitations", value=[]), "no excitation"),
    (put("feedback", "axes", value=["x"]), r"a position on z needs \[feedback\]"),
    (put("feedback", "damping", value=[1.0, -1.0, 1.0, 1.0]), "drives the vehicle away"),
    (put("space", "start", value=[3.0, 0.0, 1.0, 0.0]), "the start x = 3 is not inside -2.7 to 2.7"),
    (put("space", "lower", value=[0.0, 0.0]), "lower: must have 3 numbers, not 2"),
    (put("rate", value=0.0), "rate: 0 commands a second cannot be flown; give 5 to 500"),
    (put("rate", value=5000), "rate: 5000 commands a second cannot be flown; give 5 to 500"),
    (put("rate", value="fast"), "rate: must be a finite number, not 'fast'"),
    (put("ramp", value=-1.0), "ramp: must not be negative"),
    (put("seed", value=1.5), "seed: must be a whole number"),
    (put("version", value=2), "version 2, this one reads 1"),
    (put("format", value="something"), "not a rotorfit plan"),
    (put("card", "comand", value={}), "unknown key 'comand'"),
    (put("belief", value={}), r"feedback needs gamma under \[belief\]"),
    (lambda raw: raw.pop("space"), "key 'space' is missing"),
    (lambda raw: raw["card"]["command"].pop("y"), "it excites y, for which its card has no command"),
]


@pytest.mark.parametrize(("change", "told"), WRONG, ids=range(len(WRONG)))
def test_a_mistake_is_told_with_file_and_place(change: Callable[[dict[str, Any]], object], told: str) -> None:
    with pytest.raises(PlanError, match=told) as error:
        plan_from_mapping(edited(change), "p.toml")
    assert str(error.value).startswith("plan p.toml")
    assert "\n" not in str(error.value)


def test_a_file_that_is_missing_no_text_or_no_toml_is_told(tmp_path: Path) -> None:
    with pytest.raises(PlanError, match=r"cannot be read"):
        load_plan(tmp_path / "none.toml")
    (tmp_path / "bytes.toml").write_bytes(b"\xff\x00\xfe")
    with pytest.raises(PlanError, match="not a text file"):
        load_plan(tmp_path / "bytes.toml")
    with pytest.raises(PlanError, match="not readable as TOML"):
        plan_from_text("rate = = 3", "p.toml")


def test_the_mapping_of_a_plan_is_plain() -> None:
    assert plan_from_mapping(plan_mapping(PLAN), "memory") == PLAN
