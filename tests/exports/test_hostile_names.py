"""Exports of hostile models: what a name, a path or a key says reaches no language; its own parser reads each file."""

import ast
import json
import re
import subprocess
import tomllib
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from models import model_of
from rotorfit.core.finding import Finding
from rotorfit.core.frames import AXES
from rotorfit.core.model import Model, Source
from rotorfit.exports import export
from rotorfit.exports.formats import FORMATS
from rotorfit.exports.gains import save_gains, tuning_mapping

HOSTILE = {
    "yaml tag": '!!python/object/apply:os.system ["touch owned"]: 1',
    "line breaks": "a\nowned: 1\r\nowned: 2\u2028owned: 3\u0085owned: 4\x0bowned: 5",
    "dashes": "flight---1----end -- --> <owned/> ]]>",
    "comments": "*/ int owned; /* // # % %{ owned %} /*/ **//",
    "quotes": '""" ; import owned \'\'\' ; """ \\',
    "substitutions": "$(eval owned) ${owned} {{ owned }} {% owned %} @owned@ %owned%",
    "backslashes": "\\\nowned ??/\nowned \\u000aowned",
    "entities": "&owned; <!DOCTYPE a [<!ENTITY owned 'x'>]> <?owned?>",
    "controls": "\x00\x07\x1b[2Jowned\x7f\ufeff\u202eowned\ud800",
    "long": "-" * 5000,
}


def hostile(text: str) -> Model:
    """A model that says a text wherever a text can stand, as a key too."""
    model = model_of()
    axes = {
        name: replace(axis, ci95={**axis.ci95, text: (1.0, 2.0)}, stderr={**axis.stderr, text: 1.0})
        for name, axis in model.axes.items()
    }
    return replace(
        model,
        axes=axes,
        card=replace(model.card, name=text),
        method=text,
        rotorfit=text,
        findings=(Finding(text, "warning", text, text, text),),
        flights=(Source(text, text, (0.0, 1.0), (), (text,)),),
    )


def python(text: str, _: Path) -> None:
    tree = ast.parse(text)
    docstring, *statements = tree.body
    assert isinstance(docstring, ast.Expr)
    for node in ast.walk(ast.Module(statements, [])):
        assert not (isinstance(node, ast.Name | ast.alias) and "owned" in ast.dump(node))
    assert "owned" not in ast.dump(ast.Module(statements, []))


def c(text: str, folder: Path) -> None:
    (folder / "model.h").write_text(text, encoding="utf-8")
    command = ["gcc", "-std=c99", "-Wall", "-pedantic", "-Werror", "-E", "-P", "model.h"]
    told = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True).stdout
    assert "owned" not in told  # what is left of the file without its comments


def yaml(text: str, _: Path) -> None:
    from ruamel.yaml import YAML

    reader = YAML(typ="safe", pure=True)
    reader.version = (1, 1)  # type: ignore[assignment]  # what ROS reads
    read: Any = reader.load(text)
    assert not any(getattr(event, "tag", None) for event in reader.parse(text))  # no unsafe reader makes objects of it
    assert "owned" not in repr(read)
    own = read["/**"]["ros__parameters"] if "/**" in read else read
    for axis in AXES:
        assert set(own["bebop"][axis]) == {
            "structure", "input", "damping", "delay", "command_limit", "input_ci95", "damping_ci95", "delay_ci95",
        }  # fmt: skip


def xml(text: str, _: Path) -> None:
    tree = ET.fromstring(text)
    assert "owned" not in ET.tostring(tree, encoding="unicode")
    for comment in re.findall(r"<!--(.*?)-->", text, re.DOTALL):
        assert "--" not in comment
        assert not comment.endswith("-")


def matlab(text: str, _: Path) -> None:
    code = [line for line in text.splitlines() if not line.startswith("%")]
    assert code[0] == "function model = bebop()"
    assert "owned" not in "\n".join(code)
    assert not any(line.strip() in ("%{", "%}") for line in text.splitlines())  # which begin and end a block


PARSERS = {".py": python, ".h": c, ".yaml": yaml, ".xacro": xml, ".m": matlab}


@pytest.mark.parametrize("to", FORMATS)
@pytest.mark.parametrize("text", HOSTILE.values(), ids=HOSTILE)
def test_the_targets_own_parser_finds_nothing_but_the_model(text: str, to: str, tmp_path: Path) -> None:
    made = export(hostile(text), to, name="bebop").text

    PARSERS[FORMATS[to].suffix](made.encode("utf-8").decode("utf-8"), tmp_path)
    assert all(sign.isprintable() or sign == "\n" for sign in made)


@pytest.mark.parametrize("name", ["true", "null", "y", "1e3", "end", "class", "~", "---", "../../etc", "a" * 200, "é"])
@pytest.mark.parametrize("to", FORMATS)
def test_a_vehicle_of_any_name_is_a_word_of_the_language(name: str, to: str) -> None:
    made = export(model_of(), to, name=name)

    assert re.fullmatch("[a-z][a-z0-9_]{0,47}", made.name)
    if FORMATS[to].suffix == ".py":
        ast.parse(made.text)
    elif FORMATS[to].suffix == ".xacro":
        ET.fromstring(made.text)
    elif FORMATS[to].suffix == ".yaml":
        from ruamel.yaml import YAML

        reader = YAML(typ="safe", pure=True)
        reader.version = (1, 1)  # type: ignore[assignment]
        read: Any = reader.load(made.text)
        own = read["/**"]["ros__parameters"] if "/**" in read else read
        assert made.name in own
    elif FORMATS[to].suffix == ".m":
        assert made.name != "end"


@pytest.mark.parametrize("suffix", [".toml", ".yaml"])
@pytest.mark.parametrize("text", HOSTILE.values(), ids=HOSTILE)
def test_gains_of_a_hostile_model_are_read_as_they_were_written(text: str, suffix: str, tmp_path: Path) -> None:
    from ruamel.yaml import YAML

    import rotorfit as rf

    model, path = hostile(text), tmp_path / f"gains{suffix}"
    tuning = rf.tune(model_of(), axes=("z",), draws=20)
    save_gains(tuning, model, path)

    written = path.read_text(encoding="utf-8")
    reader = YAML(typ="safe", pure=True)
    read: Any = tomllib.loads(written) if suffix == ".toml" else reader.load(written)
    said = json.dumps(tuning_mapping(tuning, model)["model"], ensure_ascii=False)
    if suffix == ".toml":
        said = said.encode("utf-8", "replace").decode("utf-8")  # what is no sign has no place in it
    assert read["model"] == json.loads(said)
    assert suffix == ".toml" or not any(getattr(event, "tag", None) for event in reader.parse(written))
