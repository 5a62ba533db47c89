"""The gains file and the verb that writes it."""

import json
import re
import tomllib
from pathlib import Path

import pytest
from click.testing import CliRunner
from ruamel.yaml import YAML

from models import VEHICLE, model_of
from rotorfit.app.cli import main
from rotorfit.control.tuning import tune
from rotorfit.core.errors import ModelError
from rotorfit.exports.gains import read_gains, save_gains, tuning_mapping
from rotorfit.files.models import save


@pytest.fixture(scope="module")
def model_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("tune") / "model.json"
    save(model_of({axis: VEHICLE[axis] for axis in ("x", "yaw")}), path)
    return path


def run(*words: str | Path) -> tuple[int, str]:
    result = CliRunner().invoke(main, [*map(str, words)])
    return result.exit_code, result.output


def test_both_formats_hold_the_same_gains_with_units_and_margins(tmp_path: Path) -> None:
    model = model_of({"x": VEHICLE["x"]})
    tuning = tune(model, draws=20)
    for name in ("gains.toml", "gains.yaml"):
        save_gains(tuning, model, tmp_path / name)

    toml = tomllib.loads((tmp_path / "gains.toml").read_text())
    yaml = YAML(typ="safe").load((tmp_path / "gains.yaml").read_text())
    axis, law = toml["axes"]["x"], tuning.axes["x"].law

    assert toml == yaml
    assert (axis["stiffness"], axis["rate_gain"], axis["delay"]) == (law.stiffness, law.rate, law.delay)
    assert tuple(axis["observer"]) == law.observer
    assert axis["under_covariance"]["peak_sensitivity"] == tuning.axes["x"].robustness.peak
    assert set(axis) - {"command", "note", "nominal", "under_covariance"} <= set(toml["units"])
    assert toml["refused"].keys() == {"y", "z", "yaw"}
    assert toml["model"]["method"] == "ml"


def test_another_suffix_is_refused(tmp_path: Path) -> None:
    model = model_of({"x": VEHICLE["x"]})

    with pytest.raises(ModelError, match=r"gains.txt: gains are written as .toml"):
        save_gains(tune(model, draws=20), model, tmp_path / "gains.txt")


def test_the_verb_refuses_a_suffix_before_it_tunes(tmp_path: Path) -> None:
    code, output = run("tune", tmp_path / "not there.json", "-o", tmp_path / "gains.txt")
    assert code == 1
    assert "gains are written as .toml" in output


@pytest.mark.parametrize(
    ("suffix", "text"),
    [(".toml", "a = " + "[" * 5000), (".yaml", "a: " + "[" * 1000), (".toml", None), (".yaml", None)],
)
def test_gains_that_are_nested_without_end_or_no_numbers_are_one_line(
    suffix: str, text: str | None, model_path: Path, tmp_path: Path
) -> None:
    path = tmp_path / f"gains{suffix}"
    if text is None:
        assert run("tune", model_path, "-o", path)[0] == 0
        text = re.sub(r"(bandwidth\W+)[\d.]+", r"\1" + ("nan" if suffix == ".toml" else ".nan"), path.read_text())
    path.write_text(text)

    with pytest.raises(ModelError, match=path.name) as refused:
        read_gains(path)
    assert "\n" not in str(refused.value)


def test_the_verb_prints_writes_and_writes_again(model_path: Path, tmp_path: Path) -> None:
    gains = tmp_path / "gains.yaml"

    for _ in range(2):  # its own file may be written over
        code, text = run("tune", model_path, "-o", gains)
        assert code == 0, text
    assert "y: no gains, the model has no numbers (not_excited)" in text
    assert "none is unstable" in text
    assert gains.read_text().startswith("format: rotorfit-gains")


def test_gains_of_a_vehicle_that_takes_world_commands_or_turned_ones_say_so(tmp_path: Path) -> None:
    save(model_of({"x": VEHICLE["x"]}), tmp_path / "model.json")
    model = json.loads((tmp_path / "model.json").read_text())
    model["card"]["command"]["frame"] = "world"
    model["card"]["command"]["x"]["scale"] = -1
    (tmp_path / "model.json").write_text(json.dumps(model))

    code, text = run("tune", tmp_path / "model.json", "-o", tmp_path / "gains.toml")

    assert code == 0, text
    told = " ".join(text.split())
    assert "takes commands of x and y in the world frame: turn those of this file by yaw" in told
    assert f"x: u is the command; {model['card']['command']['x']['from']} of the log is it times -1" in told
    gains = read_gains(tmp_path / "gains.toml")
    assert gains["command_frame"] == "world"
    assert "turn those of this file by yaw" in gains["sending"]
    assert gains["axes"]["x"]["command"].endswith("of the log is it times -1")


def test_json_is_the_mapping_of_the_file(model_path: Path) -> None:
    code, text = run("tune", model_path, "--design", "linearising", "--axes", "x", "--json")

    assert code == 0
    model = model_of({axis: VEHICLE[axis] for axis in ("x", "yaw")})
    wanted = tuning_mapping(tune(model, "linearising", axes=("x",)), model)
    assert json.loads(text) == json.loads(json.dumps(wanted))


def test_errors_are_one_line_and_nothing_is_written_over(model_path: Path, tmp_path: Path) -> None:
    taken = tmp_path / "gains.toml"
    taken.write_text("mine = true\n")

    for words in (("tune", model_path, "-o", taken), ("tune", model_path, "--axes", "z"), ("tune", "no.json")):
        code, text = run(*words)
        assert code == 1
        assert text.startswith("Error: ")
        assert len(text.strip().splitlines()) == 1
    assert taken.read_text() == "mine = true\n"


def test_a_gains_file_that_is_not_there_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match=r"gone\.toml: No such file"):
        read_gains(tmp_path / "gone.toml")


def test_a_gains_file_of_another_version_or_another_file_is_one_line(model_path: Path, tmp_path: Path) -> None:
    gains, card = tmp_path / "gains.toml", tmp_path / "card.toml"
    assert run("tune", model_path, "-o", gains)[0] == 0
    gains.write_text(gains.read_text().replace("version = 1\n", "version = 8\n", 1))
    card.write_text("[command]\nx = 'x'\n[pose]\n")

    with pytest.raises(ModelError, match="gains version 8, this one reads 1; use the rotorfit that wrote it"):
        read_gains(gains)
    with pytest.raises(ModelError, match=r"card\.toml is a card, not a file of gains: `rotorfit fit LOG --card"):
        read_gains(card)
