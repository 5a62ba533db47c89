"""The notebook of the examples: it is what its script says, and its cells run, without Jupyter."""

import json
import sys
from pathlib import Path

import matplotlib as mpl
import pytest
from matplotlib import pyplot as plt

ROOT = Path(__file__).resolve().parents[1]
sys.path.append(str(ROOT / "examples"))

from to_notebook import cells_of, notebook  # noqa: E402

pytestmark = pytest.mark.flights

SCRIPT = (ROOT / "examples" / "quickstart.py").read_text(encoding="utf-8")


def test_the_notebook_is_that_of_the_script() -> None:
    assert (ROOT / "examples" / "quickstart.ipynb").read_text(encoding="utf-8") == notebook(SCRIPT)
    assert json.loads(notebook(SCRIPT))["nbformat"] == 4


def test_the_notebook_reads_fits_proves_plots_and_simulates_in_fifteen_lines(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    mpl.use("agg")
    code = [source for kind, source in cells_of(SCRIPT) if kind == "code"]
    names: dict[str, object] = {}
    for source in code:
        exec(compile(source.replace("duration=20", "duration=10"), "quickstart", "exec"), names)  # half as long

    assert sum(bool(line.strip()) for source in code for line in source.splitlines()) <= 15
    assert len(plt.get_fignums()) == 3
    plt.close("all")
    assert {path.name for path in tmp_path.iterdir()} == {"train.mcap", "proof.mcap"}
    assert 0.2 < names["motion"].velocity[-1, 0] < 4.0  # type: ignore[attr-defined]
