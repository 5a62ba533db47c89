"""From sections to one self-contained HTML page: it loads nothing, and everything that is not ours is escaped."""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import TYPE_CHECKING, Any

from rotorfit.reporting.words import AXIS, TERMS, slug
from rotorfit.version import __version__

if TYPE_CHECKING:
    from jinja2 import Environment

Sections = Mapping[str, tuple[str, str, Mapping[str, Any]]]
"""Anchor to title, template and the template's values, in the order of the page."""


@dataclass(frozen=True)
class Heading:
    """The head of a page.

    Attributes:
        title: Title of the window.
        kind: Kind of page, shown beside the name of the program.
        name: What the page is about.
        origins: Pairs of a name, or an empty one, and a sentence on the origin of the results.
        first: Name of the first section, for the link that skips to it.
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
        heading: Head of the page.
        sections: Its sections.
        series: Data for zooming the charts, flight by flight.
        shared: Values for all templates.
    """
    from markupsafe import Markup

    environment = _environment()
    known = {**shared, "terms": TERMS, "slug": slug, "axis_words": AXIS}
    # Our own files and JSON without "<" are safe in <style> and <script>; everything else is escaped.
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


@cache
def _environment() -> "Environment":
    """The templates, each compiled once."""
    from jinja2 import Environment, FunctionLoader, StrictUndefined

    return Environment(
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        loader=FunctionLoader(lambda name: _file(f"templates/{name}")),
    )


def _file(name: str) -> str:
    return resources.files(__name__.rpartition(".")[0]).joinpath(*name.split("/")).read_text(encoding="utf-8")


def _plot_library() -> str:
    """uPlot, preceded by its licence; its banner, which has an address, is left out."""
    code = _file("uplot/uPlot.iife.min.js")
    banner, _, rest = code.partition("\n")
    version = banner[banner.find("(") : banner.find(")") + 1]
    return f"/* uPlot {version}\n{_file('uplot/LICENSE')}*/\n{rest}"


def _json(parts: Iterable[Any]) -> str:
    """JSON that is safe inside a script element, whatever text it has."""
    text = json.dumps(list(parts), separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")
