"""ROS 2 bags: a folder with metadata.yaml, or a single storage file; SQLite is read here, MCAP in `mcap`."""

import shutil
import sqlite3
from collections.abc import Collection, Iterator
from contextlib import closing, contextmanager
from functools import partial
from pathlib import Path, PurePath
from tempfile import TemporaryDirectory

import numpy as np

from rotorfit.core.errors import LogError
from rotorfit.files.logs import mcap
from rotorfit.files.logs.compression import ZSTD_MAGIC, unpack_file
from rotorfit.files.logs.content import BLOCK_LIMIT, Content, DamageError, one_line
from rotorfit.files.logs.mcap_records import MAGIC
from rotorfit.files.logs.ros_messages import Topic, normal_type
from rotorfit.files.logs.rosbag2_pages import rows_left, rows_of_table
from rotorfit.files.logs.topics import Collector

_SQLITE = b"SQLite format 3\0"

_FIRST_ROW = -(1 << 63)

_UNPACKED_LIMIT = 1 << 34  # on disk

_Row = tuple[int, object, object, object]  # rowid, topic, time, message, of any type in an untrusted file


def sniff(path: Path, head: bytes) -> bool:
    """Whether it is a folder with metadata.yaml, an SQLite file, or a file compressed with zstd by ROS 2."""
    return (path / "metadata.yaml").is_file() if path.is_dir() else head.startswith((_SQLITE, ZSTD_MAGIC))


def read(path: Path, tables: Collection[str] | None) -> Content:
    """Reads the requested topics; see `files.logs.read`. The files of a split bag are read in sequence.

    Raises:
        LogError: metadata.yaml is invalid, a file it names is missing or of another kind, or there is no message.
    """
    collector = Collector(path, tables)
    for file in _storage_files(path) if path.is_dir() else [path]:
        with _plain(file, collector) as plain:
            with plain.open("rb") as stream:
                head = stream.read(16)
            if head.startswith(MAGIC):
                mcap.collect(plain, collector)
            elif head.startswith(_SQLITE):
                _collect(file, plain, collector)
            else:
                raise LogError(f"{file}: neither SQLite nor MCAP; check that the bag was copied whole")
    return collector.content()


def _storage_files(folder: Path) -> list[Path]:
    """The files named in metadata.yaml, in its order; folders in their names are ignored, as bags get moved."""
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    metadata = folder / "metadata.yaml"
    hint = "rebuild it with `ros2 bag reindex`"
    try:
        content = YAML(typ="safe", pure=True).load(metadata.read_text(encoding="utf-8"))
        names = content["rosbag2_bagfile_information"]["relative_file_paths"]
        files = [folder / PurePath(name).name for name in names]
    except (YAMLError, UnicodeDecodeError, KeyError, TypeError, ValueError, RecursionError) as error:
        raise LogError(f"{metadata}: cannot be understood ({one_line(error)}); {hint}") from error
    missing = [file.name for file in files if not file.is_file()]
    if missing or not files:
        raise LogError(f"{folder}: metadata.yaml names files that are not there ({', '.join(missing)}); {hint}")
    return files


@contextmanager
def _plain(file: Path, collector: Collector) -> Iterator[Path]:
    """Yields the file itself or, if it is compressed as a whole, a temporary decompressed copy."""
    with file.open("rb") as stream:
        packed = stream.read(4) == ZSTD_MAGIC
    if not packed:
        yield file
        return
    with TemporaryDirectory(prefix="rotorfit-") as folder:
        target = Path(folder) / "unpacked"
        try:
            unpack_file(file, target, _UNPACKED_LIMIT)
        except DamageError as error:
            collector.damaged(f"{file.name}: {error}; read up to there")
        yield target


def _collect(named: Path, file: Path, collector: Collector) -> None:
    """Passes all messages of an SQLite file to a collector; `named` is the user's name for it."""
    try:
        # Immutable: nothing is written beside the log, and no journal is replayed into it.
        with (
            _whole_pages(named, file, collector) as pages,
            _merged(named, pages, collector) as whole,
            closing(sqlite3.connect(f"{whole.absolute().as_uri()}?mode=ro&immutable=1", uri=True)) as database,
        ):
            database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, BLOCK_LIMIT)
            database.text_factory = partial(str, encoding="utf-8", errors="replace")
            database.execute("PRAGMA trusted_schema = OFF")
            _check_schema(named, database)
            topics = _topics(database)
            for topic in topics.values():
                collector.declare(topic)
            _messages(whole, database, topics, collector)
    except (sqlite3.Error, UnicodeDecodeError, DamageError) as error:  # the second where SQLite quotes damaged bytes
        collector.damaged(f"{named.name} is damaged ({one_line(error)}); read up to there")


@contextmanager
def _whole_pages(named: Path, file: Path, collector: Collector) -> Iterator[Path]:
    """Yields the file itself or, if it was cut short, a copy of its whole pages.

    SQLite would fill an incomplete page with zeros, so poses would become zeros; a missing page is an error.
    Source: sqlite.org/fileformat.html, 1.3.
    """
    with file.open("rb") as stream:
        head = stream.read(32)
    page = int.from_bytes(head[16:18], "big")
    page = 65536 if page == 1 else page
    size, expected = file.stat().st_size, page * int.from_bytes(head[28:32], "big")
    if size >= expected:
        yield file
        return
    collector.damaged(f"{named.name} is cut short: {size} of {expected} bytes")
    with TemporaryDirectory(prefix="rotorfit-") as folder:
        whole = Path(shutil.copyfile(file, Path(folder) / "whole.db3"))
        with whole.open("r+b") as stream:
            stream.truncate(size - size % page)
            stream.seek(28)
            stream.write((size // page).to_bytes(4, "big"))  # SQLite opens no file shorter than it claims
        yield whole


@contextmanager
def _merged(named: Path, file: Path, collector: Collector) -> Iterator[Path]:
    """Yields the file itself or, if a crash left messages in a write-ahead log beside it, a copy that has them, too.

    Source: sqlite.org/wal.html, 4.
    """
    log = Path(f"{named}-wal")
    if not log.is_file() or not log.stat().st_size:
        yield file
        return
    with TemporaryDirectory(prefix="rotorfit-") as folder:
        copy = Path(shutil.copyfile(file, Path(folder) / "merged.db3"))
        shutil.copyfile(log, f"{copy}-wal")
        with closing(sqlite3.connect(copy)) as database:
            _, _, pages = database.execute("PRAGMA wal_checkpoint(PASSIVE)").fetchone()
        merged = pages > 0 and copy.stat().st_size <= file.stat().st_size + log.stat().st_size
        if merged:
            collector.note(f"{log.name} was merged in a copy")
        else:
            collector.damaged(f"{log.name} cannot be merged: its messages are lost")
        yield copy if merged else file


def _check_schema(named: Path, database: sqlite3.Connection) -> None:
    """Raises `LogError` unless `topics` and `messages` are tables: a view could compute rows without end."""
    rows = database.execute("SELECT name FROM sqlite_master WHERE type = 'table' AND sql LIKE 'CREATE TABLE%'")
    if not {"topics", "messages"} <= {name for (name,) in rows}:
        raise LogError(f"{named}: an SQLite file but no ROS 2 bag: it has no topics and messages")


def _topics(database: sqlite3.Connection) -> dict[int, Topic]:
    """Topics by number; definitions are in the bag from ROS 2 Iron on."""
    definitions: dict[str, tuple[str, str]] = {}
    if database.execute("SELECT 1 FROM sqlite_master WHERE type = 'table' AND name = 'message_definitions'").fetchone():
        for name, language, text in database.execute(
            "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
        ):
            definitions[str(name)] = (str(language), str(text))
    topics: dict[int, Topic] = {}
    for number, name, msgtype, encoding in database.execute("SELECT id, name, type, serialization_format FROM topics"):
        if not isinstance(number, int):
            continue
        language, text = definitions.get(str(msgtype), ("ros2msg", ""))
        topics[number] = Topic(
            str(name), normal_type(str(msgtype)), str(encoding), text, "idl" if language == "ros2idl" else "msg"
        )
    return topics


def _messages(file: Path, database: sqlite3.Connection, topics: dict[int, Topic], collector: Collector) -> None:
    """Passes the messages to the collector in the order of recording.

    They are read from the pages where these are as rosbag2 writes them, else through SQLite, and behind damage from the
    pages again.
    """
    last = _FIRST_ROW
    wanted = [number for number, topic in topics.items() if collector.wants(topic)]
    try:
        for rows in rows_of_table(file, _root(database), wanted):
            if not collector.add_mixed(topics, rows.numbers, rows.times, rows.messages):
                raise DamageError("a message without its topic")
            last = int(rows.rowids.max(initial=last))
        return
    except DamageError:
        pass
    try:
        for row, number, time, data in _slow_rows(file, database, wanted, last):
            if number in topics and isinstance(time, int) and isinstance(data, bytes):
                collector.add(topics[number], time, data)
            last = row
    except (sqlite3.DatabaseError, DamageError):
        for rows in rows_left(file, last, wanted):
            known = rows[np.isin(rows.numbers, [*topics])]
            collector.add_mixed(topics, known.numbers, known.times, known.messages)
        raise


def _slow_rows(file: Path, database: sqlite3.Connection, wanted: list[int], after: int) -> Iterator[_Row]:
    """Rows after a rowid, one by one; for topics that are not requested SQLite fetches no message data.

    Raises:
        DamageError: The messages together are larger than the file, so pages must belong to several of them.
    """
    numbers, left = ",".join(map(str, wanted)), file.stat().st_size
    for row in database.execute(
        f"SELECT rowid, topic_id, timestamp, CASE WHEN topic_id IN ({numbers}) THEN data ELSE x'' END "
        "FROM messages WHERE rowid > ? ORDER BY rowid",
        (after,),
    ):
        left -= len(row[3]) if isinstance(row[3], bytes) else 0
        if left < 0:
            raise DamageError("messages larger than the file")
        yield row


def _root(database: sqlite3.Connection) -> int:
    """Root page of the table of messages."""
    columns = [
        (name, kind.upper(), key) for _, name, kind, _, _, key in database.execute("PRAGMA table_info(messages)")
    ]
    if [name for name, _, _ in columns] != ["id", "topic_id", "timestamp", "data"] or columns[0][1:] != ("INTEGER", 1):
        raise DamageError("a table with other columns")
    ((root,),) = database.execute("SELECT rootpage FROM sqlite_master WHERE type = 'table' AND name = 'messages'")
    return int(root)
