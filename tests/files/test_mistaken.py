"""A file in the place of another: told as what it is, with the verb that takes it."""

from importlib import resources
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from flying import plan_of
from models import VEHICLE, model_of
from rotorfit.app.cli import main
from rotorfit.control.tuning import tune
from rotorfit.exports import export
from rotorfit.exports.gains import save_gains
from rotorfit.files.cards import builtin_card_text, builtin_cards
from rotorfit.files.kinds import KINDS
from rotorfit.files.mistaken import kind_of, mistaken
from rotorfit.files.models import save
from rotorfit.files.plans import save_plan
from rotorfit.simulation.vehicle import builtin_vehicles

NAMES = {
    "model": "model.json", "plan": "plan.toml", "gains": "gains.toml", "card": "card.toml", "vehicle": "mine.toml",
    "export": "model.h", "page": "report.html", "log": "flight 1.csv",
}  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One file of every kind, as rotorfit writes it."""
    path = tmp_path_factory.mktemp("kinds")
    model = model_of({"x": VEHICLE["x"]})
    save(model, path / NAMES["model"])
    save_plan(plan_of(), path / NAMES["plan"])
    save_gains(tune(model, draws=20), model, path / NAMES["gains"])
    (path / NAMES["card"]).write_text(builtin_card_text("bebop2"))
    (path / NAMES["vehicle"]).write_text(vehicle_text("bebop2"))
    export(model, "c", path / NAMES["export"])
    (path / NAMES["page"]).write_text("<!doctype html>\n<html>\n")
    rows = [f"{t:.2f},{np.sin(t):.3f},0,1,0" for t in np.arange(0, 10, 0.05)]
    (path / NAMES["log"]).write_text("\n".join(["time,x,y,z,yaw", *rows]) + "\n")
    return path


def vehicle_text(name: str) -> str:
    return resources.files("rotorfit.simulation").joinpath(f"vehicles/{name}.toml").read_text(encoding="utf-8")


def run(folder: Path, *words: str) -> Result:
    """A verb, in whose words the name of a kind in capitals stands for its file."""
    files = {kind.upper(): str(folder / name) for kind, name in NAMES.items()}
    return CliRunner().invoke(main, [files.get(word, word) for word in words])


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_is_known_by_its_content(kind: str, folder: Path) -> None:
    path = folder / NAMES[kind]

    assert kind_of(path) == kind
    assert mistaken(path, kind) == ""
    for wanted in set(KINDS) - {kind}:
        assert mistaken(path, wanted).startswith(f"{path} is {KINDS[kind].text}, not {KINDS[wanted].text}: ")


def test_gains_in_yaml_are_gains(folder: Path) -> None:
    model = model_of({"x": VEHICLE["x"]})
    save_gains(tune(model, draws=20), model, folder / "gains.yaml")

    assert kind_of(folder / "gains.yaml") == "gains"


def test_every_card_and_every_vehicle_of_ours_is_known(tmp_path: Path) -> None:
    for name in builtin_cards():
        (tmp_path / "card.toml").write_text(builtin_card_text(name))
        assert kind_of(tmp_path / "card.toml") == "card", name
    for name in builtin_vehicles():
        (tmp_path / "mine.toml").write_text(vehicle_text(name))
        assert kind_of(tmp_path / "mine.toml") == "vehicle", name


@pytest.mark.parametrize("content", [b"", b"{", b"hello\n", bytes(range(256))])
def test_what_is_of_no_known_kind_is_left_to_the_reader(content: bytes, tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(content)

    assert mistaken(tmp_path / "file", "model") == ""
    assert mistaken(tmp_path / "none", "model") == ""
    assert mistaken(tmp_path, "model") == ""


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("validate PLAN LOG", "is a plan, not a model: `rotorfit fly {plan} --link sim -o flight.mcap` flies it"),
        ("validate LOG LOG", "is a log, not a model: `rotorfit fit {log} -o model.json` makes a model of it"),
        ("validate LOG MODEL", "the model comes first: `rotorfit validate {model} {log}`"),
        ("cards CARD", "is a file, not the name of a built-in card: a card of your own is given by --card {card}"),
        (
            "validate MODEL GAINS",
            "is a file of gains, not a log: a controller reads it, and `rotorfit track LOG --tune",
        ),
        ("export GAINS --to c -o x.h", "is a file of gains, not a model: "),
        ("export EXPORT --to c -o x.h", "is an export of a model, not a model: it is for other programs"),
        ("tune CARD", "is a card, not a model: `rotorfit fit LOG --card {card}` reads a log by it"),
        ("report LOG MODEL -o x.html", "is a log, not a model: "),
        ("plan --after PLAN", "is a plan, not a model: "),
        ("plan --card MODEL", "is a model, not a card: `rotorfit validate {model} LOG`"),
        ("plan --card VEHICLE", "is a simulated vehicle, not a card: its card is sim:{vehicle}"),
        ("fly MODEL --link sim -o x.mcap", "is a model, not a plan: `rotorfit plan --after {model} -o plan.toml`"),
        ("fly CARD --link sim -o x.mcap", "is a card, not a plan: `rotorfit plan --card {card} -o plan.toml`"),
        ("fit LOG --card LOG", "is a log, not a card: `rotorfit info {log} --draft-card my-drone.toml`"),
        ("fit LOG --card PAGE", "is a page, not a card: open it in a browser"),
        ("info CARD", "is a card, not a log: `rotorfit fit LOG --card {card}`"),
        ("track MODEL", "is a model, not a log: `rotorfit validate {model} LOG`"),
        ("track LOG --card PLAN", "is a plan, not a card: "),
        ("track LOG --tune PLAN", "exists and is a plan: not overwritten"),
        ("fit LOG -o LOG", "exists and is a log: not overwritten"),
    ],
)
def test_a_file_in_the_wrong_place_is_one_line_with_the_verb_that_takes_it(words: str, told: str, folder: Path) -> None:
    shown = {kind: f"'{folder / name}'" if " " in name else str(folder / name) for kind, name in NAMES.items()}
    before = {path.name: path.read_bytes() for path in folder.iterdir()}

    result = run(folder, *words.split())

    assert result.exit_code == 1
    assert result.stderr.count("\n") == 1
    assert told.format(**shown) in result.stderr
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
