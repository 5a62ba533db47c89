"""Serves the files of a page, by name."""

from collections.abc import Callable
from importlib import resources

from starlette.requests import Request
from starlette.responses import Response

from rotorfit.app.loopback.gate import refused

KINDS = {"html": "text/html", "css": "text/css", "js": "text/javascript"}
"""Suffix of a page's file to its media type."""

UPLOT = ("uPlot.iife.min.js", "uPlot.min.css")
"""The plotting library; its files are those of the report."""


def file_of(package: str, name: str) -> Response:
    """A file of a package's folder `page`."""
    data = resources.files(package).joinpath("page", name).read_bytes()
    return Response(data, media_type=KINDS[name.rpartition(".")[2]])


def static(package: str) -> Callable[[Request], Response]:
    """The endpoint of `/page/{name}`: files of a package's folder `page` (no HTML), and the plotting library."""

    def endpoint(request: Request) -> Response:
        """The file, or a refusal."""
        name = request.path_params["name"]
        if name in UPLOT:
            data = resources.files("rotorfit.reporting").joinpath("uplot", name).read_bytes()
            return Response(data, media_type=KINDS[name.rpartition(".")[2]])
        known = {entry.name for entry in resources.files(package).joinpath("page").iterdir()}
        if name not in known or name.endswith(".html"):
            return refused(404, "there is no such file")
        return file_of(package, name)

    return endpoint
