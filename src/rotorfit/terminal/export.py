"""What the terminal shows of exports: the formats, and what was written."""

from collections.abc import Mapping
from typing import Any

from rich.text import Text

from rotorfit.exports import Export, Format
from rotorfit.terminal.tables import View, bullets, table


def export_formats_view(formats: Mapping[str, Format]) -> View:
    """Every format with what it holds and needs."""
    out = table("--to", "file", "what it is", left=(0, 1, 2))
    for name, form in formats.items():
        out.add_row(name, form.suffix, Text(f"{form.text}; {form.needs}" if form.needs else form.text))
    yield out
    yield Text("rotorfit export model.json --to NAME -o FILE; docs/exports.md tells how exact each is.", style="dim")


def export_view(made: Export, where: str) -> View:
    """What was written, and what was left out."""
    yield Text(f"{made.format} for {', '.join(made.axes)}, named {made.name}, written to {where}.")
    yield from bullets(made.notes)


def export_mapping(made: Export, where: str) -> dict[str, Any]:
    """The same as plain JSON types, with the numbers."""
    points = {axis: made.model.axes[axis].predictor for axis in made.axes}
    return {
        "format": made.format,
        "path": where,
        "name": made.name,
        "axes": {
            axis: {
                "structure": made.model.axes[axis].structure,
                "input": point.input,
                "damping": point.damping,
                "delay": point.delay,
                **point.extra,
            }
            for axis, point in points.items()
            if point
        },
        "notes": list(made.notes),
    }
