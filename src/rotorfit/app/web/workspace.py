"""The workspace: a folder with a whole session: logs, card, ranges, fits. Pages come and go, the folder stays.

Every change increments a revision, by which pages see that something is new. Card and ranges have revisions of their
own: a change names the revision it is based on, and is refused if another page was faster.
"""

import fcntl
import json
import os
import re
import shutil
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field, replace
from hashlib import sha256
from pathlib import Path
from threading import RLock
from typing import Any, Literal, TypeVar, get_args

from rotorfit.core.errors import RotorfitError
from rotorfit.core.plain import LARGEST_JSON, is_number, line_of, plain_json, shown, text_of
from rotorfit.core.writing import sync_folder, write_whole

MOST_LOGS = 50
"""Largest number of logs in a session."""

MOST_FITS = 100
"""Largest number of fits in a session."""

LARGEST_LOG = 2 << 30
"""Largest size of one log [bytes]."""

LARGEST_WORKSPACE = 16 << 30
"""Largest size of all logs together [bytes]."""

CONTENT = ("session.json", "session.new", "lock", "logs", "fits", "recordings", "set-aside")
"""Names of everything in the folder of a workspace."""

VERSION = 1

Role = Literal["train", "validate"]

Status = Literal["running", "done", "failed", "stopped"]


class WorkspaceError(RotorfitError):
    """The workspace cannot be used: it is in use, damaged or full, or lacks the requested log or fit."""


class StaleError(RotorfitError):
    """Another page has changed the same thing in the meantime."""


@dataclass(frozen=True)
class Range:
    """A part of a log and its role; an open end is that of the flight [s]."""

    role: Role
    start: float | None = None
    end: float | None = None

    @property
    def words(self) -> str:
        """Such as `5 s to the end`."""
        start, end = (None if end is None else f"{end:g} s" for end in (self.start, self.end))
        return f"{start or 'start'} to {end or 'end'}" if start or end else "all"


@dataclass(frozen=True)
class Upload:
    """A log of the session.

    Attributes:
        id: Its id in the API, and the name of its folder.
        name: Name of the user's file: text, never used as a path.
        file: Name of the file in its folder: safe characters only.
        size: Size [bytes].
        format: Name of its format in `files.logs.formats.FORMATS`.
        ranges: The parts of it that are used.
        revision: Revision of the ranges.
    """

    id: str
    name: str
    file: str
    size: int
    format: str
    ranges: tuple[Range, ...] = ()
    revision: int = 0


@dataclass(frozen=True)
class FitEntry:
    """A fit of the session.

    Attributes:
        id: Its id in the API, and the name of its folder.
        settings: The requested settings.
        logs: Names and ranges of the logs, for the user.
        status: `running`, `done`, `failed`, or `stopped` by the user or with the studio.
        text: One line about the result.
    """

    id: str
    settings: Mapping[str, Any]
    logs: tuple[str, ...]
    status: Status = "running"
    text: str = ""


@dataclass(frozen=True)
class Running:
    """Progress of the running fit."""

    id: str
    fraction: float
    text: str
    pid: int


@dataclass(frozen=True)
class Session:
    """The state of a session; all else that a page shows is computed from it.

    Attributes:
        revision: Incremented by every change.
        uploads: Logs, in the order of arrival.
        card: Text of the card as edited; empty before there is one.
        card_revision: Revision of that text.
        fits: Fits, in the order in which they were started.
        next_log: Id of the next log.
        next_fit: Id of the next fit.
    """

    revision: int = 0
    uploads: tuple[Upload, ...] = ()
    card: str = ""
    card_revision: int = 0
    fits: tuple[FitEntry, ...] = ()
    next_log: int = 1
    next_fit: int = 1
    version: int = field(default=VERSION)

    @property
    def marked(self) -> tuple[str, ...]:
        """The ranges of the logs in words."""
        return tuple(
            f"{'training' if part.role == 'train' else 'validation'}: {part.words} of {upload.name}"
            for upload in self.uploads
            for part in upload.ranges
        )

    @property
    def card_sha256(self) -> str:
        """By which a text is known again that was changed and changed back."""
        return sha256(self.card.encode("utf-8", "replace")).hexdigest()

    def changed_since(self, fit: FitEntry) -> list[str]:
        """What is no longer as a fit had it: card, ranges; not known of comparisons and of fits by earlier studios."""
        if "card_sha256" not in fit.settings:
            return []
        pairs = {"card": (fit.settings["card_sha256"], self.card_sha256), "ranges": (fit.logs, self.marked)}
        return [name for name, (then, now) in pairs.items() if then != now]


Entry = TypeVar("Entry", Upload, FitEntry)


class Workspace:
    """A session and its folder.

    Args:
        folder: The folder; created if it is missing, for its owner only.

    Attributes:
        notice: One line about a session that had to be set aside and recordings that were left; empty without either.

    Raises:
        WorkspaceError: Another studio uses the folder, a newer one wrote it, or it cannot hold a workspace.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder.resolve()
        self.notice = ""
        self._lock = RLock()
        try:
            self.folder.mkdir(parents=True, exist_ok=True, mode=0o700)
            content = [entry for entry in self.folder.iterdir() if not entry.name.startswith(".session.json.")]
            strangers = [entry.name for entry in content if entry.name not in CONTENT]
            if strangers and not (self.folder / "session.json").exists():
                raise WorkspaceError(
                    f"{folder}: holds other things ({strangers[0]}); name an empty folder or a workspace"
                )
            self._held = (self.folder / "lock").open("w")
            self._take(folder)
            self._session = self._loaded()
            for place in ("logs", "fits", "recordings"):
                (self.folder / place).mkdir(exist_ok=True)
        except OSError as error:
            raise WorkspaceError(
                f"{folder}: no workspace can be here ({error.strerror}); name another folder"
            ) from None
        left = tuple(
            replace(fit, status="stopped", text="stopped: the studio was closed") if fit.status == "running" else fit
            for fit in self._session.fits
        )
        self._happened(fits=left)
        self._sweep()

    def _take(self, folder: Path) -> None:
        try:
            fcntl.flock(self._held, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            self._held.close()
            raise WorkspaceError(f"{folder}: another studio uses this workspace; close it, or name another") from None

    def close(self) -> None:
        """Releases the folder for another studio."""
        self._held.close()

    @property
    def session(self) -> Session:
        """The current session."""
        return self._session

    def upload(self, log_id: str) -> Upload:
        """A log of the session.

        Raises:
            WorkspaceError: There is none of that id.
        """
        return _one_of(self._session.uploads, log_id, "log")

    def fit(self, fit_id: str) -> FitEntry:
        """A fit of the session.

        Raises:
            WorkspaceError: There is none of that id.
        """
        return _one_of(self._session.fits, fit_id, "fit")

    def path_of(self, upload: Upload) -> Path:
        """Path of a log."""
        return self.folder / "logs" / upload.id / upload.file

    def fit_folder(self, fit: FitEntry) -> Path:
        """Folder of a fit."""
        return self.folder / "fits" / fit.id

    @contextmanager
    def incoming(self, name: str) -> Iterator[tuple[str, Path]]:
        """An id and a path for a log that is being received; it is removed unless `add_log` keeps it.

        Raises:
            WorkspaceError: The session is full.
        """
        with self._lock:
            self._check_number(name)
            log_id = str(self._session.next_log)
            self._changed(next_log=self._session.next_log + 1)
        folder = self.folder / "logs" / log_id
        folder.mkdir()
        try:
            yield log_id, folder / safe_name(name)
        finally:
            if all(upload.id != log_id for upload in self._session.uploads):
                shutil.rmtree(folder, ignore_errors=True)

    def recording(self) -> Path:
        """A path for a new recording: it lies apart, where nothing removes it, until it is a log of the session.

        Raises:
            WorkspaceError: The session is full.
        """
        taken = {upload.name for upload in self._session.uploads} | {path.name for path in self.recordings()}
        name = next(new for n in range(1, sys.maxsize) if (new := f"live-{n}.mcap") not in taken)
        self._check_number(name)
        return self.folder / "recordings" / name

    def recordings(self) -> list[Path]:
        """The recordings that are no log of the session yet."""
        return sorted((self.folder / "recordings").glob("*.mcap"))

    def set_aside(self, path: Path) -> Path:
        """Moves a recording that cannot be read out of the way; its new path."""
        return path.rename(self._aside() / path.name)

    def _check_number(self, name: str) -> None:
        if len(self._session.uploads) >= MOST_LOGS:
            raise WorkspaceError(f"{name}: a session holds at most {MOST_LOGS} logs; remove one first")

    def add_log(self, upload: Upload) -> Upload:
        """Keeps a received log: the first is for training, later ones are for validation.

        Raises:
            WorkspaceError: The session is full.
        """
        with self._lock:
            if len(self._session.uploads) >= MOST_LOGS or upload.size > self.room():
                raise WorkspaceError(
                    f"{upload.name}: other uploads have filled the session meanwhile; remove one first"
                )
            taken = any(part.role == "train" for one in self._session.uploads for part in one.ranges)
            upload = replace(upload, ranges=(Range("validate" if taken else "train"),))
            for place in (self.path_of(upload).parent, self.folder / "logs"):
                sync_folder(place)
            self._changed(uploads=(*self._session.uploads, upload))
            return upload

    def remove_log(self, log_id: str) -> None:
        """Removes a log and its file."""
        with self._lock:
            folder = self.path_of(self.upload(log_id)).parent
            self._removed(folder, uploads=tuple(one for one in self._session.uploads if one.id != log_id))

    def set_ranges(self, log_id: str, ranges: tuple[Range, ...], seen: int) -> None:
        """Sets the ranges of a log.

        Raises:
            StaleError: They were changed since revision `seen`.
        """
        with self._lock:
            upload = self.upload(log_id)
            if upload.revision != seen:
                raise StaleError(f"the ranges of {upload.name} were changed in another window: those are shown now")
            new = replace(upload, ranges=ranges, revision=seen + 1)
            self._changed(uploads=tuple(new if one.id == log_id else one for one in self._session.uploads))

    def first_card(self, text: str) -> int:
        """Sets the first card of a session; an existing card is kept, because another page was faster.

        Returns:
            The revision of the card afterwards.
        """
        with self._lock:
            if not self._session.card:
                self.set_card(lambda _: text, self._session.card_revision)
            return self._session.card_revision

    def set_card(self, change: Callable[[str], str], seen: int) -> int:
        """Changes the text of the card; a change without effect is accepted on any revision.

        Returns:
            The revision of the card afterwards.

        Raises:
            StaleError: The card was changed since revision `seen`.
        """
        with self._lock:
            text = change(self._session.card)
            if text != self._session.card:
                if self._session.card_revision != seen:
                    raise StaleError("the card was changed in another window: that text is shown now")
                self._changed(card=text, card_revision=seen + 1)
            return self._session.card_revision

    def begin_fit(self, settings: Mapping[str, Any], logs: tuple[str, ...]) -> FitEntry:
        """Adds a new fit, with its folder.

        Raises:
            WorkspaceError: The session has too many fits.
        """
        with self._lock:
            if len(self._session.fits) >= MOST_FITS:
                raise WorkspaceError(f"a session holds at most {MOST_FITS} fits; remove one first")
            number = self._session.next_fit
            fit = FitEntry(str(number), settings, logs)
            self.fit_folder(fit).mkdir(exist_ok=True)  # it may be left from an attempt that failed on a full disk
            self._changed(fits=(*self._session.fits, fit), next_fit=number + 1)
            return fit

    def end_fit(self, fit_id: str, status: Status, text: str) -> None:
        """Sets the status and the text of a fit that has ended."""
        with self._lock:
            self._happened(
                fits=tuple(
                    replace(fit, status=status, text=text) if fit.id == fit_id else fit for fit in self._session.fits
                )
            )

    def remove_fit(self, fit_id: str) -> None:
        """Removes a fit that is not running."""
        with self._lock:
            fit = self.fit(fit_id)
            if fit.status == "running":
                raise WorkspaceError("the fit is running; cancel it first")
            self._removed(self.fit_folder(fit), fits=tuple(one for one in self._session.fits if one.id != fit_id))

    def room(self) -> int:
        """Size of what may still be uploaded [bytes]."""
        return LARGEST_WORKSPACE - sum(upload.size for upload in self._session.uploads)

    def _changed(self, **parts: Any) -> None:
        """Makes a requested change, which takes effect once it is on the disk."""
        session = replace(self._session, revision=self._session.revision + 1, **parts)
        self._write(session)
        self._session = session

    def _happened(self, **parts: Any) -> None:
        """Notes a change that has happened, whether or not the disk has room: the next change writes it too."""
        self._session = replace(self._session, revision=self._session.revision + 1, **parts)
        with suppress(OSError, WorkspaceError):
            self._write(self._session)

    def _removed(self, folder: Path, **parts: Any) -> None:
        """Makes a change that removes a folder; on a full disk the folder goes first, to make room."""
        try:
            self._changed(**parts)
        except OSError:
            shutil.rmtree(folder, ignore_errors=True)
            self._changed(**parts)
        shutil.rmtree(folder, ignore_errors=True)

    def _write(self, session: Session) -> None:
        text = json.dumps(asdict(session), indent=1, allow_nan=False)
        if len(text) > LARGEST_JSON:
            raise WorkspaceError("the session holds too many ranges and fits; remove some first")
        write_whole(self.folder / "session.json", text, keep=False)

    def _loaded(self) -> Session:
        """The session in the folder, or a new one; a session that cannot be read is set aside with its logs and fits.

        Raises:
            WorkspaceError: A newer studio wrote it.
        """
        path = self.folder / "session.json"
        if not path.exists():
            return Session()
        try:
            return _session_from(plain_json(text_of(path)))
        except ValueError as error:
            trouble = line_of(error, 200)
        place = self._aside()
        for name in ("logs", "fits", "session.json"):  # the session last: after a kill in between, this runs again
            with suppress(FileNotFoundError):
                (self.folder / name).rename(place / name)
        self.notice = (
            f"the session was damaged ({trouble}); it lies in {place}, with its logs and fits; this is a new one"
        )
        return Session()

    def _aside(self) -> Path:
        """A new folder for what cannot be used any more."""
        aside = self.folder / "set-aside"
        place = next(new for n in range(1, sys.maxsize) if not (new := aside / str(n)).exists())
        place.mkdir(parents=True)
        return place

    def _sweep(self) -> None:
        """Removes the remains of an interrupted upload, removal or write, but no recording."""
        for half in self.folder.glob(".session.json.*"):
            half.unlink(missing_ok=True)
        for place, entries in (("logs", self._session.uploads), ("fits", self._session.fits)):
            known = {entry.id for entry in entries}
            for folder in (self.folder / place).iterdir():
                if folder.name not in known:
                    shutil.rmtree(folder, ignore_errors=True)


def _one_of(entries: Sequence[Entry], identity: str, what: str) -> Entry:
    for entry in entries:
        if entry.id == identity:
            return entry
    raise WorkspaceError(f"there is no such {what} in this session; another page may have removed it")


def safe_name(name: str) -> str:
    """A file name of at most 80 safe characters: no separator, no leading dot, no plus (which joins files)."""
    return re.sub(r"[^A-Za-z0-9._-]+", "_", name).strip("._-")[-80:].lstrip("._-") or "log"


def default_folder() -> Path:
    """The user's own workspace."""
    home = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state"
    return Path(home) / "rotorfit" / "studio"


def _session_from(raw: Any) -> Session:
    """A session from its file.

    Raises:
        ValueError: It is not a session; the message says why.
        WorkspaceError: A newer version wrote it.
    """
    version = _part(raw, "version", int)
    if version > VERSION:
        raise WorkspaceError(f"the session is of version {version}; this studio knows {VERSION}: install a newer one")
    uploads = tuple(_upload_from(one) for one in _part(raw, "uploads", list))
    fits = tuple(_fit_from(one) for one in _part(raw, "fits", list))
    for entries in (uploads, fits):
        if len({entry.id for entry in entries}) < len(entries):
            raise ValueError("two entries have one id")
    numbers = {name: _part(raw, name, int) for name in ("revision", "card_revision", "next_log", "next_fit")}
    return Session(uploads=uploads, card=_part(raw, "card", str), fits=fits, **numbers)


def _upload_from(raw: Any) -> Upload:
    texts = {name: _part(raw, name, str) for name in ("name", "file", "format")}
    if texts["file"] != safe_name(texts["file"]):
        raise ValueError(f"file: no harmless name, {shown(texts['file'])}")
    ranges = tuple(_range_from(one) for one in _part(raw, "ranges", list))
    size, revision = _part(raw, "size", int), _part(raw, "revision", int)
    return Upload(id=_id_of(raw), **texts, size=size, ranges=ranges, revision=revision)


def _range_from(raw: Any) -> Range:
    role = _part(raw, "role", str)
    ends = [raw.get(name) for name in ("start", "end")]
    if role not in get_args(Role) or not all(end is None or is_number(end) for end in ends):
        raise ValueError("a range that is none")
    return Range(role, *ends)


def _fit_from(raw: Any) -> FitEntry:
    logs, status = _part(raw, "logs", list), _part(raw, "status", str)
    if status not in get_args(Status) or not all(isinstance(one, str) for one in logs):
        raise ValueError("a fit that is none")
    settings, text = _part(raw, "settings", dict), _part(raw, "text", str)
    return FitEntry(_id_of(raw), settings, tuple(logs), status, text)


def _id_of(raw: Any) -> str:
    identity: str = _part(raw, "id", str)
    if not re.fullmatch("[0-9]{1,18}", identity):
        raise ValueError(f"id: no number, {shown(identity)}")
    return identity


def _part(raw: Any, name: str, kind: type) -> Any:
    value = raw.get(name) if isinstance(raw, dict) else None
    if type(value) is not kind:
        raise ValueError(f"{name}: must be of the kind {kind.__name__}, not {shown(value)}")
    return value
