"""The routes of the studio. Requests have ids only, never paths; every known error is one line of JSON."""

import json
import os
import shutil
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from threading import Lock
from typing import Any, BinaryIO

from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect, Request
from starlette.responses import FileResponse, Response
from starlette.routing import Route
from starlette.types import ASGIApp

from rotorfit.app.live.feed import live_routes
from rotorfit.app.loopback.files import file_of, static
from rotorfit.app.loopback.gate import SANDBOX, refused
from rotorfit.app.web.asking import check_inside, edits_from, fit_request, live_request, ranges_from, window_from
from rotorfit.app.web.following import Follower
from rotorfit.app.web.runner import BusyError, Runner
from rotorfit.app.web.shelf import Shelf
from rotorfit.app.web.windowed import Series, packed, window_of
from rotorfit.app.web.wire import PREDICTOR, constants_mapping, flight_mapping, log_mapping, raw_of, session_mapping
from rotorfit.app.web.workspace import LARGEST_LOG, FitEntry, StaleError, Upload, Workspace, WorkspaceError
from rotorfit.core.errors import ExportError, LogError, RotorfitError
from rotorfit.core.frames import AXES
from rotorfit.core.plain import line_of, plain_json, text_of
from rotorfit.diagnosis.card_draft import draft_card
from rotorfit.diagnosis.command_response import answers_of
from rotorfit.diagnosis.doctor import findings_of_flight
from rotorfit.exports import export
from rotorfit.exports.formats import FORMATS

LARGEST_REQUEST = 1 << 20
"""Largest size of a request that is not a log [bytes]."""

RESULTS = {
    "model.json": "application/json",
    "validation.json": "application/json",
    "result.json": "application/json",
    "report.html": "text/html; charset=utf-8",
}
"""Files of a fit that may be requested."""


class Studio:
    """The application that serves a workspace."""

    def __init__(self, workspace: Workspace, gated: Callable[[ASGIApp], ASGIApp]) -> None:
        self.workspace = workspace
        self.shelf = Shelf(workspace)
        self.runner = Runner(workspace)
        self.follower = Follower(workspace.recording, self._taken_in)
        left = [f"an earlier studio listened: {self._taken_in(path)}" for path in workspace.recordings()]
        workspace.notice = "; ".join(filter(None, (workspace.notice, *left)))
        self._looking = Lock()
        handlers: Any = {RotorfitError: _refusal, OSError: _refusal}
        self.app = gated(Starlette(routes=self._routes(), exception_handlers=handlers))

    def close(self) -> None:
        """Ends all running work."""
        self.follower.close()
        self.runner.close()

    def _routes(self) -> list[Route]:
        return [
            Route("/", lambda _: file_of("rotorfit.app.web", "index.html")),
            Route("/page/{name}", static("rotorfit.app.web")),
            Route("/api/constants", _reading(lambda _: constants_mapping())),
            Route("/api/session", _reading(self.session)),
            Route("/api/logs", self.upload, methods=["POST"]),
            Route("/api/logs/{log}", _reading(self.log)),
            Route("/api/logs/{log}", _changing(self.remove_log), methods=["DELETE"]),
            Route("/api/logs/{log}/flight", _reading(self.flight)),
            Route("/api/logs/{log}/findings", _reading(self.findings)),
            Route("/api/logs/{log}/motion", _drawing(self.motion)),
            Route("/api/logs/{log}/column", _drawing(self.column)),
            Route("/api/logs/{log}/ranges", _changing(self.ranges), methods=["PUT"]),
            Route("/api/card", _changing(self.card), methods=["PUT"]),
            Route("/api/card.toml", self.card_file),
            Route("/api/fits", _changing(self.fit), methods=["POST"]),
            Route("/api/fits/{fit}", _changing(self.remove_fit), methods=["DELETE"]),
            Route("/api/fits/{fit}/cancel", _changing(self.cancel), methods=["POST"]),
            Route("/api/fits/{fit}/exports/{format}", self.exported),
            Route("/api/fits/{fit}/{file}", self.result),
            Route("/api/live", _changing(self.follow), methods=["POST"]),
            Route("/api/live", _changing(self.follow_no_more), methods=["DELETE"]),
            *live_routes(lambda: self.follower.feed, "/live"),
        ]

    def session(self, request: Request) -> Any:
        """The session, unless it is unchanged since the revision that the page knows."""
        session, running = self.workspace.session, self.runner.running
        if request.query_params.get("seen") == str(session.revision):
            now: dict[str, Any] = {
                "revision": session.revision,
                "running": None if running is None else asdict(running),
            }
        else:
            now = {**session_mapping(session, running), "told": self.workspace.notice}
        return {**now, "live": self.follower.to_mapping()}

    async def upload(self, request: Request) -> Response:
        """Receives a log as the body of the request, and keeps it if it can be read."""
        name = request.query_params.get("name", "")[-200:] or "log"
        declared = request.headers.get("content-length", "")
        limit = min(LARGEST_LOG, self.workspace.room())
        if declared.isdecimal() and int(declared[:20]) > limit:
            return _too_large(name, limit)
        with self.workspace.incoming(name) as (log_id, path):
            size = 0
            try:
                with path.open("xb") as file:
                    async for chunk in request.stream():
                        size += len(chunk)
                        if size > limit:
                            return _too_large(name, limit)
                        await run_in_threadpool(file.write, chunk)
                    await run_in_threadpool(_synced, file)
            except ClientDisconnect:
                return refused(400, f"{name}: the upload was broken off")
            kept = await run_in_threadpool(self._kept, Upload(log_id, name, path.name, size, ""))
        return _json({"id": kept.id}, 201)

    def _kept(self, upload: Upload) -> Upload:
        """Reads a log that was received, and keeps it."""
        log = self.shelf.log(upload)
        if not log.tables:
            raise LogError(f"{upload.name}: holds no table of numbers")
        return self.workspace.add_log(Upload(upload.id, upload.name, upload.file, upload.size, log.format))

    def log(self, request: Request) -> Any:
        """Tables and columns."""
        upload = self._upload(request)
        return self.shelf.computed(("log", upload.id), lambda: log_mapping(self.shelf.log(upload)))

    def remove_log(self, request: Request, _: Any) -> Any:
        """Removes a log from the session."""
        upload = self._upload(request)
        self.workspace.remove_log(upload.id)
        self.shelf.forget(upload)

    def flight(self, request: Request) -> Any:
        """The flight that the card makes from a log."""
        upload, card = self._upload(request), self._card()
        return self.shelf.computed(("flight", upload.id, card), lambda: flight_mapping(self.shelf.flight(upload, card)))

    def findings(self, request: Request) -> Any:
        """The findings about a log, and the direction of each command as the motion shows it."""
        upload, card = self._upload(request), self._card()

        def make() -> Any:
            """Computes them."""
            flight = self.shelf.flight(upload, card)
            found = findings_of_flight(self.shelf.log(upload), flight)
            told = answers_of(flight).of
            return {
                "findings": [asdict(one) for one in found],
                "answers": {axis: asdict(told[axis]) for axis in flight.axes if axis in told},
            }

        with self._looking:  # one at a time: edits may come faster than the findings about a long flight
            if card != self._card():
                raise StaleError("the card has changed meanwhile")
            return self.shelf.computed(("findings", upload.id, card), make)

    def motion(self, request: Request) -> Series:
        """Command and velocity of an axis."""
        axis = request.query_params.get("axis", "")
        if axis not in AXES:
            raise WorkspaceError(f"no such axis: one of {', '.join(AXES)}")
        return self.shelf.motion(self._upload(request), self._card(), axis)

    def column(self, request: Request) -> Series:
        """A column as recorded."""
        return self.shelf.column(self._upload(request), request.query_params.get("source", ""))

    def ranges(self, request: Request, body: Any) -> Any:
        """Sets the ranges of a log for training and for validation."""
        upload = self._upload(request)
        ranges, seen = ranges_from(body)
        if (span := self._span(upload)) is not None:
            check_inside(ranges, span, upload.name)
        self.workspace.set_ranges(upload.id, ranges, seen)

    def _span(self, upload: Upload) -> tuple[float, float] | None:
        """Span of the flight in a log [s]; None while the card makes none of it, which pages and fits tell."""
        try:
            return self.shelf.flight(upload, self._card()).span
        except RotorfitError:
            return None

    def card(self, _: Request, body: Any) -> Any:
        """Changes the card by a text, single values, a built-in card or a draft for a log; returns its revision."""
        workspace = self.workspace
        if "draft" in body and body.get("seen") == 0:  # every page does so on a session without a card
            there = workspace.session
            revision = there.card_revision if there.card else workspace.first_card(self._drafted(str(body["draft"])))
        else:
            change, seen = edits_from(body, self._drafted)
            revision = workspace.set_card(change, seen)
        return {"card_revision": revision}

    def _drafted(self, log_id: str) -> str:
        """The card that a log carries, if it is valid; else one drafted from its column names and its motion."""
        log = self.shelf.log(self.workspace.upload(log_id))
        carried = log.attached.get("card", "")
        return carried if carried and raw_of(carried) is not None else draft_card(log)

    def card_file(self, _: Request) -> Response:
        """The card, for download."""
        return Response(
            self.workspace.session.card.encode("utf-8", "replace"),
            media_type="application/toml",
            headers={"content-disposition": 'attachment; filename="card.toml"'},
        )

    def fit(self, _: Request, body: Any) -> Any:
        """Starts a fit or a comparison."""
        session = self.workspace.session
        request, logs = fit_request(body, session, lambda upload: f"logs/{upload.id}/{upload.file}")
        return {"id": self.runner.start(request, session.card, logs).id}

    def cancel(self, request: Request, _: Any) -> Any:
        """Ends the running fit."""
        self.runner.cancel(self._fit(request).id)

    def remove_fit(self, request: Request, _: Any) -> Any:
        """Removes a fit from the session."""
        self.workspace.remove_fit(self._fit(request).id)

    def follow(self, _: Request, body: Any) -> Any:
        """Starts to track a vehicle."""
        self.follower.start(*live_request(body, self.workspace.session))

    def _taken_in(self, path: Path) -> str:
        """Makes a recording a log of the session, and says so in a line, or where it lies instead."""
        name, why = path.name, ""
        try:
            try:
                self._recorded(path)
            except LogError as error:  # it holds nothing, or its beginning is damaged
                path, why = self.workspace.set_aside(path), line_of(error)
        except (OSError, RotorfitError) as error:
            why = f"{line_of(error)}; the studio tries again when it starts next"
        return (
            f"what was heard is not a log yet: {why}; it lies in {path}" if why else f"what was heard is the log {name}"
        )

    def _recorded(self, path: Path) -> None:
        """Makes a recording a log of the session; its name among the recordings goes only then.

        It stays the same file, to which a tracker that outlives its studio may write on for a moment.
        """
        with self.workspace.incoming(path.name) as (log_id, place):
            try:
                place.hardlink_to(path)
            except OSError:  # a file system without links
                shutil.copyfile(path, place)
            with place.open("rb") as file:
                os.fsync(file.fileno())
            self._kept(Upload(log_id, path.name, place.name, place.stat().st_size, ""))
        path.unlink()

    def follow_no_more(self, _: Request, _body: Any) -> Any:
        """Ends the tracking."""
        self.follower.stop()

    def result(self, request: Request) -> Response:
        """A file of a fit, to show or download."""
        name, fit = request.path_params["file"], self._fit(request)
        path = self.workspace.fit_folder(fit) / name
        if name not in RESULTS or fit.status != "done" or not path.is_file():
            return refused(404, "there is no such result")
        headers = {}
        if "download" in request.query_params:
            headers["content-disposition"] = f'attachment; filename="{Path(name).stem}-{fit.id}{Path(name).suffix}"'
        if name.endswith(".html"):
            headers["content-security-policy"] = SANDBOX
            headers["x-frame-options"] = "SAMEORIGIN"
        return FileResponse(path, media_type=RESULTS[name], headers=headers)

    def exported(self, request: Request) -> Response:
        """The model of a fit, exported for a controller or a simulator, for download."""
        fit, wanted = self._fit(request), request.path_params["format"]
        folder = self.workspace.fit_folder(fit)
        path = folder / "model.json"
        if fit.status != "done" or not path.is_file():
            return refused(404, "there is no such result")
        name = f"model_{fit.id}"
        try:
            made = export(
                path, wanted, name=name, predictor="predictor" in request.query_params,
                trained=_stored(folder / "trained.json") or {}, validation=_stored(folder / "validation.json"),
            )  # fmt: skip
        except ExportError as error:
            raise ExportError(_in_words_of_the_page(str(error))) from None
        kept = {"content-disposition": f'attachment; filename="{name}{FORMATS[wanted].suffix}"'}
        return Response(made.text, media_type="text/plain; charset=utf-8", headers=kept)

    def _upload(self, request: Request) -> Upload:
        return self.workspace.upload(request.path_params["log"])

    def _fit(self, request: Request) -> FitEntry:
        return self.workspace.fit(request.path_params["fit"])

    def _card(self) -> str:
        if not self.workspace.session.card:
            raise WorkspaceError("there is no card yet")
        return self.workspace.session.card


def _stored(path: Path) -> Any:
    """What the worker wrote; None where it did not."""
    return plain_json(text_of(path)) if path.is_file() else None


def _in_words_of_the_page(refusal: str) -> str:
    """A refusal of an export, with the page's name for an option of the command line."""
    return refusal.replace("--predictor", f"'{PREDICTOR}'").replace("export --to ", "export to ")


def _json(content: Any, status: int = 200) -> Response:
    return Response(json.dumps(content, allow_nan=False), status, media_type="application/json")


def _reading(answer: Callable[[Request], Any]) -> Callable[[Request], Response]:
    """A route that answers with JSON."""
    return lambda request: _json(answer(request))


def _drawing(answer: Callable[[Request], Series]) -> Callable[[Request], Response]:
    """A route that answers with the window of a series, in bytes."""

    def endpoint(request: Request) -> Response:
        """The window that the query asks for; the headers tell how much of the series it is."""
        series = answer(request)
        start, end, width = window_from(request.query_params, series.time)
        window = window_of(series, start, end, width)
        first, last = (float(series.time[0]), float(series.time[-1])) if series.time.size else (0.0, 0.0)
        headers = {
            "x-points": str(window.time.size),
            "x-samples": str(window.count),
            "x-exact": str(int(window.exact)),
            "x-whole": f"{first!r} {last!r}",
        }
        return Response(packed(window), media_type="application/octet-stream", headers=headers)

    return endpoint


def _changing(change: Callable[[Request, Any], Any]) -> Callable[[Request], Any]:
    """A route that changes the session by a small JSON body."""

    async def endpoint(request: Request) -> Response:
        """Reads a body of bounded size and applies the change."""
        body = b""
        async for chunk in request.stream():
            body += chunk
            if len(body) > LARGEST_REQUEST:
                return refused(413, "the request is too large")
        try:
            asked = plain_json(body) if body else {}
        except ValueError:
            asked = None
        if not isinstance(asked, dict):
            return refused(400, "the request is no JSON object")
        return _json(await run_in_threadpool(change, request, asked) or {})

    return endpoint


def _synced(file: BinaryIO) -> None:
    """Flushes a received file to the disk."""
    file.flush()
    os.fsync(file.fileno())


def _too_large(name: str, limit: int) -> Response:
    return refused(413, f"{name}: larger than {limit >> 20} MiB, which is all that fits; cut the log, or remove others")


def _refusal(_: Request, error: Exception) -> Response:
    """A known error as one line."""
    if isinstance(error, OSError):
        return refused(507, f"{error.strerror or 'the disk refused'}; check the room on the disk of the workspace")
    status = 409 if isinstance(error, StaleError | BusyError) else 422
    return refused(status, line_of(error))
