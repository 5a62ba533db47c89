"""Sections -> one self-contained HTML page: nothing in it is fetched, and everything that is not ours is escaped."""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from typing import Any

from rotorfit.reporting.words import AXIS, TERMS, slug
from rotorfit.version import __version__

Sections = Mapping[str, tuple[str, str, Mapping[str, Any]]]
"""Anchor to title, template and what the template speaks of, in the order of the page."""


@dataclass(frozen=True)
class Heading:
    """The head of a page.

    Attributes:
        title: Of the window.
        kind: What page it is, beside the name of the program.
        name: What it is about.
        origins: A name, or none, and a sentence on where what is shown comes from.
        first: What the first section is, for those who skip to it.
    """

    title: str
    kind: str
    name: str
    origins: tuple[tuple[str, str], ...]
    first: str


def document(
    heading: Heading, sections: Sections, series: Sequence[Mapping[str, Any]], shared: Mapping[str, Any]
) -> str:
    """The whole page.

    Args:
        heading: Of it.
        sections: Of it.
        series: What the charts need to zoom, flight by flight.
        shared: What all templates speak of.
    """
    from jinja2 import Environment, FunctionLoader, StrictUndefined
    from markupsafe import Markup

    environment = Environment(
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        loader=FunctionLoader(lambda name: _file(f"templates/{name}")),
    )
    known = {**shared, "terms": TERMS, "slug": slug, "axis_words": AXIS}
    # Our own files and JSON without "<" may stand in <style> and <script> as they are; everything else is escaped.
    text = environment.get_template("page.html.j2").render(
        **known,
        heading=heading,
        style=Markup(_file("uplot/uPlot.min.css") + _file("templates/page.css")),
        plot_library=Markup(_plot_library()),
        script=Markup(_file("templates/figures.js") + _file("templates/zoom.js")),
        series=Markup(_json(series)),
        version=__version__,
        sections={anchor: title for anchor, (title, _, _) in sections.items()},
        parts=[
            Markup(environment.get_template(template).render(**known, **content))
            for _, template, content in sections.values()
        ],
    )
    return text.lstrip() + "\n"


def _file(name: str) -> str:
    return resources.files(__name__.rpartition(".")[0]).joinpath(*name.split("/")).read_text(encoding="utf-8")


def _plot_library() -> str:
    """uPlot with its licence in front; its banner, an address, is left out."""
    code = _file("uplot/uPlot.iife.min.js")
    banner, _, rest = code.partition("\n")
    version = banner[banner.find("(") : banner.find(")") + 1]
    return f"/* uPlot {version}\n{_file('uplot/LICENSE')}*/\n{rest}"


def _json(parts: Iterable[Any]) -> str:
    """JSON that may stand inside a script element, whatever text it holds."""
    text = json.dumps(list(parts), separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")
