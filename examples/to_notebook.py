"""Writes each example beside it as a Jupyter notebook: python examples/to_notebook.py."""

import json
import re
from pathlib import Path
from typing import Any


def cells_of(text: str) -> list[tuple[str, str]]:
    """Kind (`markdown` or `code`) and source of each cell; `# %%` begins one, `# %% [markdown]` one of text."""
    parts = re.split(r"^# %%(.*)\n", text, flags=re.MULTILINE)[1:]
    cells = []
    for mark, body in zip(parts[::2], parts[1::2], strict=True):
        if "markdown" in mark:
            cells.append(("markdown", re.sub(r"^# ?", "", body.strip(), flags=re.MULTILINE)))
        else:
            cells.append(("code", body.strip()))
    return cells


def notebook(text: str) -> str:
    """The notebook, without outputs."""
    cells: list[dict[str, Any]] = []
    for number, (kind, source) in enumerate(cells_of(text)):
        more = {"execution_count": None, "outputs": []} if kind == "code" else {}
        cells.append(
            {
                "cell_type": kind,
                "id": f"cell-{number}",
                "metadata": {},
                **more,
                "source": source.splitlines(keepends=True),
            }
        )
    kernel = {"kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"}}
    return json.dumps({"cells": cells, "metadata": kernel, "nbformat": 4, "nbformat_minor": 5}, indent=1) + "\n"


if __name__ == "__main__":
    for example in Path(__file__).parent.glob("*.py"):
        if "# %%\n" in example.read_text(encoding="utf-8") and example.name != Path(__file__).name:
            example.with_suffix(".ipynb").write_text(notebook(example.read_text(encoding="utf-8")), encoding="utf-8")
