"""The recipes of CONTRIBUTING: one file and one row, and the new thing is in command line, studio and documents.

The toys in `toys/` are one format, one estimator, one export and one link. Tables are read when the command line is
imported, so the questions are asked of a process of its own.
"""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from models import model_of
from rotorfit.core.laws import STRUCTURES
from rotorfit.files.models import save
from test_documents import undocumented

pytestmark = pytest.mark.flights

HERE = Path(__file__).parent

CARD = """
name = "toy"
frame = "ENU"
[command]
frame = "heading"
time = "time"
z = { from = "command", meaning = "vertical_speed" }
[pose]
time = "time"
x = 0
y = 0
z = "position"
yaw = 0
"""


FIT = "fit flight.toy --card card.toml --method toy --json"
LADDER = "ladder flight.toy --card card.toml --json"
STUDIO, MISSED = "studio lists", "not documented"
LINES = (
    "formats --json", FIT, "fit --help", LADDER, "export model.json --json", "export model.json --to toy -o toy.txt",
    "fly --help", STUDIO, MISSED,
)  # fmt: skip
"""What is asked: all of one process, which takes longer to start than to answer."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A toy log of a vehicle that climbs by steps, its card, and a model."""
    place = tmp_path_factory.mktemp("toys")
    time = np.arange(0.0, 16.0, 0.02)
    command = np.sign(np.sin(0.9 * time)) * 0.5
    velocity = np.zeros(time.size)
    for k in range(1, time.size):
        velocity[k] = velocity[k - 1] + 0.02 * (4 * command[max(0, k - 5)] - 3 * velocity[k - 1])
    rows = np.column_stack([time, command, np.cumsum(velocity) * 0.02])
    (place / "flight.toy").write_text("TOY\n" + "\n".join(" ".join(map(repr, row)) for row in rows.tolist()))
    (place / "card.toml").write_text(CARD)
    save(model_of(), place / "model.json")
    return place


@pytest.fixture(scope="module")
def told(folder: Path) -> dict[str, str]:
    """What rotorfit with the toys prints for each line, errors of known kinds too."""
    words = (sys.executable, str(HERE / "toys/with_toys.py"), *LINES)
    printed = subprocess.run(words, capture_output=True, text=True, cwd=folder, check=True).stdout
    return dict(zip(LINES, json.loads(printed), strict=True))


def test_a_format_is_listed_and_read_and_an_estimator_fits_it(told: dict[str, str]) -> None:
    assert "Toy log: .toy" in json.loads(told["formats --json"])["formats"]["toy"]

    model = json.loads(told[FIT])

    assert model["method"] == "toy"
    assert model["axes"]["z"]["input"] == 4.0
    assert model["axes"]["z"]["ci95"]["damping"] == pytest.approx([2.98, 3.02], abs=1e-3)


def test_an_estimator_is_a_choice_of_the_command_line_and_a_row_of_the_comparison(told: dict[str, str]) -> None:
    assert "toy" in told["fit --help"]
    assert '"method": "toy"' in told[LADDER]


def test_an_export_is_listed_and_written(folder: Path, told: dict[str, str]) -> None:
    assert json.loads(told["export model.json --json"])["formats"]["toy"]["text"] == "a toy"
    assert "a toy of 4 axes" in (folder / "toy.txt").read_text()


def test_a_link_is_in_the_help_and_opened(told: dict[str, str]) -> None:
    assert "toy:ADDRESS" in told["fly --help"].replace("\n", " ")


def test_the_studio_offers_them_all(told: dict[str, str]) -> None:
    lists = json.loads(told[STUDIO])

    assert "Toy log" in lists["formats"]
    assert lists["exports"]["toy"] == "a toy"
    assert lists["methods"]["toy"] == "faith in round numbers (toy)"


def test_what_has_no_row_in_the_documents_is_missed(told: dict[str, str]) -> None:
    assert undocumented() == set()
    assert json.loads(told[MISSED]) == ["export toy", "format toy", "link toy", "method toy"]


def test_a_law_is_a_row_in_the_documents_too() -> None:
    text = (HERE.parent / "docs/structures.md").read_text(encoding="utf-8")

    assert {name for name in STRUCTURES if f"`{name}`" not in text} == set()
