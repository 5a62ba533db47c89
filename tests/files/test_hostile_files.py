"""Files that anybody may have written: what is wrong is one line with its place, and nothing is run or hangs."""

import json
import re
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from files.version_0_1.numbers_of import FOLDER
from rotorfit.core.errors import CardError, LogError, ModelError, PlanError, RotorfitError, VehicleError
from rotorfit.files.cards import load_card
from rotorfit.files.logs import read
from rotorfit.files.models import from_mapping, load
from rotorfit.files.plans import load_plan, plan_from_mapping, plan_from_text
from rotorfit.simulation.vehicle import load_vehicle

DEEP = "a" + ".a" * 3000 + " = 1\n"
TAG = '!!python/object/apply:os.system ["true"]'


def model() -> dict[str, Any]:
    raw: dict[str, Any] = json.loads((FOLDER / "model.json").read_text(encoding="utf-8"))
    return raw


def put(*places: str | int, value: object) -> Callable[[Any], object]:
    def change(raw: Any) -> None:
        for place in places[:-1]:
            raw = raw[place]
        raw[places[-1]] = value

    return change


WRONG = [
    (put("axes", "x", "ci95", "input", value=[1.0, "a"]),
     r"axes\.x\.ci95\.input\[1\]: must be a finite number, not 'a'"),
    (put("axes", "x", "ci95", "input", value=[2.0, 1.0]), r"axes\.x\.ci95\.input: 2 to 1 is not an interval"),
    (put("axes", "x", "ci95", TAG, value=[1.0, 2.0]), r"axes\.x\.ci95\.'!!python/object/apply.*': unknown key"),
    (put("axes", "x", "ci95", "inputs", value=[1.0, 2.0]), r"axes\.x\.ci95\.inputs: unknown key; nearest: 'input'"),
    (put("axes", "x", "stderr", "input", value=-1.0), r"axes\.x\.stderr\.input: must not be negative, not -1"),
    (put("axes", "x", "predictor", "delay", value=True),
     r"axes\.x\.predictor\.delay: must be a finite number, not True"),
    (put("axes", "x", "predictor", "delay", value=1e9), r"axes\.x\.predictor\.delay: 1e\+09 is beyond 60"),
    (put("axes", "x", "predictor", "input", value=10**400),
     r"axes\.x\.predictor\.input: must be a finite number, not an int"),
    (put("axes", "x", "trim", value={}), r"axes\.x\.trim: must be a list, not \{\}"),
    (put("axes", "x", "noise", "wind_power", value=-1.0), r"axes\.x\.noise\.wind_power: must not be negative"),
    (put("axes", "x", "structure", value="second"), r"axes\.x\.structure: no such structure: 'second'"),
    (put("axes", "x", "predicter", value=None), r"axes\.x\.predicter: unknown key; nearest: 'predictor'"),
    (put("axes", "roll", value=model()["axes"]["x"]), r"axes: must be x, y, z, yaw, not x, y, z, yaw, roll"),
    (put("flights", 0, "span", value=[0.0]), r"flights\[0\]\.span: must be a list of 2, not a list of 1"),
    (put("flights", 0, "path", value=3), r"flights\[0\]\.path: must be a text, not 3"),
    (put("findings", 0, "severity", value="grave"), r"findings\[0\]\.severity: must be one of info, warning, error"),
    (put("covariance", "matrix", 0, value=[]), r"covariance\.matrix: must have 12 rows of 12"),
    (put("leave_one_out", value={"flights": 1}), r"leave_one_out\.(baselines|flights): "),
    (put("rotorfit", value="1" * 200_000), r"rotorfit: must be a text, not '111.*…"),
    (put("surprise", value=1), r"surprise: unknown key"),
]  # fmt: skip


@pytest.mark.parametrize(("change", "told"), WRONG, ids=range(len(WRONG)))
def test_what_is_wrong_in_a_model_is_told_with_its_place(change: Callable[[Any], object], told: str) -> None:
    raw = model()
    change(raw)

    with pytest.raises(ModelError, match=f"here.json: damaged model file: {told}") as refused:
        from_mapping(raw, "here.json")
    assert "\n" not in str(refused.value)
    assert len(str(refused.value)) < 400


TEXTS = {
    "NaN": ("NaN", "NaN is not a number"),
    "infinity": ("-Infinity", "-Infinity is not a number"),
    "too large": ("1e999", "1e999 is more than a float holds"),
    "5,000 digits": ("1" * 5000, "an integer of more than 64 bits"),
    "deep": ("[" * 500 + "]" * 500, "nested deeper than 32 levels"),
    "very deep": ("[" * 100_000 + "]" * 100_000, "nested deeper than 32 levels"),
}


@pytest.mark.parametrize(("value", "told"), TEXTS.values(), ids=TEXTS)
def test_a_model_file_of_no_sense_is_one_line(value: str, told: str, tmp_path: Path) -> None:
    raw = model()
    raw["axes"]["x"]["predictor"]["delay"] = "HERE"
    path = tmp_path / "model.json"
    path.write_text(json.dumps(raw).replace('"HERE"', value), encoding="utf-8")

    with pytest.raises(ModelError, match=told) as refused:
        load(path)
    assert "\n" not in str(refused.value)


LOADERS = {
    "card": (load_card, FOLDER / "card.toml", CardError),
    "plan": (load_plan, FOLDER / "plan.toml", PlanError),
    "vehicle": (load_vehicle, None, VehicleError),
}
BAD = {
    "deep keys": DEEP,
    "deep lists": "a = " + "[" * 100_000 + "]" * 100_000 + "\n",
    "digits": f"a = {'1' * 5000}\n",
    "hex digits": f"a = 0x{'f' * 5000}\n",
    "nan": "a = nan\n",
    "a date": "a = 2020-01-01\n",
    "zeros": "\x00" * 100,
    "no text": "\udcff\udcfe",
    "escapes": '"\\u001b[2J\\n" = 1\n',
}


@pytest.mark.parametrize("bad", BAD.values(), ids=BAD)
@pytest.mark.parametrize("kind", LOADERS)
def test_cards_plans_and_vehicles_of_no_sense_are_one_line(kind: str, bad: str, tmp_path: Path) -> None:
    load_it, good, wrong = LOADERS[kind]
    path = tmp_path / "file.toml"
    whole = bad + (good.read_text(encoding="utf-8") if good else "")
    path.write_bytes(whole.encode("utf-8", "surrogateescape"))

    with pytest.raises(wrong) as refused:
        load_it(str(path))
    assert "\n" not in str(refused.value)
    assert str(refused.value).isprintable()


def test_a_version_that_moves_the_cursor_is_shown_as_text() -> None:
    for refused, format_ in ((ModelError, "rotorfit-model"), (PlanError, "rotorfit-plan")):
        from_it = from_mapping if refused is ModelError else plan_from_mapping
        with pytest.raises(refused, match=r"version '\\x1b\[2J\\n', this one reads 1") as told:
            from_it({"format": format_, "version": "\x1b[2J\n"}, "here")
        assert str(told.value).isprintable()


def test_axes_of_a_feedback_that_are_lists_are_one_line() -> None:
    text = (FOLDER / "plan.toml").read_text(encoding="utf-8")
    changed = re.sub(r"(\[feedback\]\naxes = \[)", r'\1["x"], ', text)
    assert changed != text

    with pytest.raises(PlanError, match=r"\[feedback\]: axes must be some of x, y, z, yaw, not a list of"):
        plan_from_text(changed, "here")


@pytest.mark.parametrize("kind", ["model", *LOADERS])
def test_a_file_that_never_ends_is_refused(kind: str) -> None:
    load_it = load if kind == "model" else LOADERS[kind][0]
    with pytest.raises(RotorfitError, match=r"MiB|neither a file"):
        load_it("/dev/zero")


def leaves(value: Any, place: tuple[str | int, ...] = ()) -> Iterator[tuple[str | int, ...]]:
    """Places of all values that hold no others, of lists those in the first part."""
    if isinstance(value, dict | list) and value:
        for key in value if isinstance(value, dict) else (0,):
            yield from leaves(value[key], (*place, key))
    else:
        yield place


def test_every_part_of_a_model_is_looked_at() -> None:
    """A wrong value in any place is refused, but for `gamma` and `physics`, which are written and not read."""
    whole = model()
    read = [place for place in leaves(whole) if place[0] not in ("gamma", "physics", "card")]
    assert len(read) > 500
    for place in read[::7]:  # some of every part
        at: Any = whole
        for key in place[:-1]:
            at = at[key]
        before, at[place[-1]] = at[place[-1]], {TAG: [TAG]}
        with pytest.raises(RotorfitError, match=r"here\.json") as refused:
            from_mapping(whole, "here.json")
        at[place[-1]] = before
        assert "\n" not in str(refused.value), place


def test_control_characters_in_a_damaged_bag_are_shown_as_text(tmp_path: Path) -> None:
    path = tmp_path / "bag.db3"
    with closing(sqlite3.connect(path)) as database:
        database.execute("CREATE TABLE topics(id INTEGER)")
        database.execute("CREATE TABLE messages(id INTEGER)")
        database.commit()
    path.write_bytes(path.read_bytes().replace(b"messages(id", b"messages\x7fid"))

    with pytest.raises(LogError) as refused:
        read(path)
    assert str(refused.value).isprintable()


def test_control_characters_in_the_name_of_an_empty_section_are_shown_as_text(tmp_path: Path) -> None:
    text = (
        "Objects\x1b[2J\n100\n,,Global Angle (Quaternion) drone:drone,,,,,,\n"
        "Frame,Sub Frame,RX,RY,RZ,RW,TX,TY,TZ\n,,,,,,mm,mm,mm\n\n"
    )
    (tmp_path / "log.csv").write_text(text, encoding="utf-8")

    with pytest.raises(LogError, match="of the Vicon export holds no frames") as refused:
        read(tmp_path / "log.csv")
    assert str(refused.value).isprintable()
