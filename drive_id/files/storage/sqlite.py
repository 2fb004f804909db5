"""sqlite3 files, the default storage of ROS 2 up to Humble, read in the order of the rows, which is that of arrival."""

from __future__ import annotations

import sqlite3
import struct
import time
from collections import Counter
from collections.abc import Collection, Iterator
from pathlib import Path
from urllib.parse import quote

from drive_id.common.quantity import counted
from drive_id.errors import MessageCountError, NotABagError, TruncatedBagError
from drive_id.files.inputs.input_file import open_input, shown_size
from drive_id.files.storage.container import (
    LARGEST_CHUNK,
    RawMessage,
    Storage,
    TopicInfo,
    file_size,
    full_type,
    merged_topics,
)

_SQL_ERRORS = (sqlite3.Error, OSError, UnicodeDecodeError, OverflowError, MemoryError)
_MOST_TOPICS = 1 << 16  # more are damage
_LONGEST_TEXT = 1 << 22  # characters of a type or a definition: more are damage
_STEPS = 100_000  # of sqlite between two looks at the clock: some milliseconds
_PATIENCE = 20.0  # s that opening a file of any size may take, before sqlite is told to give up
_BYTES_PER_SECOND = 1e7  # further time by the size: a slow network disk


class SqliteStorage(Storage):
    """A sqlite3 file, named ``shown`` in errors."""

    kind = "sqlite3"

    def __init__(self, path: Path, shown: Path) -> None:
        self._shown = shown
        for ending in ("-wal", "-journal"):
            if file_size(path.with_name(path.name + ending)):
                raise TruncatedBagError(
                    f"{shown} was not closed ({path.name}{ending} lies beside it): recover it first, for instance "
                    f"with 'sqlite3 {path.name} \"PRAGMA wal_checkpoint(TRUNCATE)\"'."
                )
        try:
            self._database = sqlite3.connect(
                f"file:{quote(str(path.absolute()))}?mode=ro&immutable=1", uri=True, check_same_thread=False
            )
        except sqlite3.Error as error:
            raise NotABagError(f"{shown} cannot be opened ({error}): check its permissions.") from error
        try:
            self._check_size(path)
            end = time.monotonic() + _PATIENCE + file_size(path) / _BYTES_PER_SECOND
            self._database.set_progress_handler(lambda: time.monotonic() > end, _STEPS)
            self._open()
            self._database.set_progress_handler(None, 0)
        except _SQL_ERRORS as error:
            self._database.close()
            raise self._damaged(error) from error
        except BaseException:
            self._database.close()
            raise

    def close(self) -> None:
        """Release the file."""
        self._database.close()

    def messages(self, topics: Collection[str]) -> Iterator[RawMessage]:
        """Yield the messages of ``topics`` in the order of the rows; checks the declared counts.

        Raises TruncatedBagError when the file is damaged, MessageCountError when a count differs.
        """
        keys = {key: name for key, name in self._keys.items() if name in topics}
        found: Counter[str] = Counter()
        marks = ",".join("?" * len(keys))
        query = f"SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN ({marks}) ORDER BY id"
        try:
            for key, log_time, data in self._database.execute(query, tuple(keys)):
                if not isinstance(log_time, int) or not isinstance(data, bytes):
                    raise sqlite3.DatabaseError(f"a message on {keys[key]} is not a blob with a time")
                found[keys[key]] += 1
                yield RawMessage(keys[key], log_time, data)
        except _SQL_ERRORS as error:
            raise self._damaged(error) from error
        for topic in self.topics:
            if topic.name in topics and found[topic.name] != topic.count:
                raise MessageCountError(
                    f"{self._shown} counts {counted(topic.count, 'message')} on {topic.name} but "
                    f"yields {found[topic.name]}: "
                    "copy the file again from its origin, or rebuild its index with 'sqlite3 ... REINDEX'."
                )

    def _check_size(self, path: Path) -> None:
        """Compare the size of the file with its header: sqlite itself reads missing pages as zeros."""
        with open_input(path) as stream:
            head = stream.read(100)
        if len(head) < 100:
            raise sqlite3.DatabaseError("it breaks off within its header")
        (page,), (pages,) = struct.unpack_from(">H", head, 16), struct.unpack_from(">I", head, 28)
        size = 65536 if page == 1 else page
        if size == 0 or file_size(path) % size or file_size(path) < pages * size:
            raise sqlite3.DatabaseError("it breaks off before its end")

    def _open(self) -> None:
        query = "SELECT name FROM sqlite_master WHERE type = 'table' AND length(sql) < 4096 LIMIT 1000"
        tables = {row[0] for row in self._database.execute(query)}
        if not {"topics", "messages"} <= tables:
            raise NotABagError(
                f"{self._shown} is a sqlite3 file without the tables 'topics' and 'messages': give a rosbag2 recording."
            )
        check = self._database.execute("PRAGMA quick_check(1)").fetchone()
        if check is None or check[0] != "ok":
            raise sqlite3.DatabaseError("its structure is inconsistent")
        for table in tables & {"topics", "messages", "message_definitions"}:
            self._check_stored(table)
        rows = self._database.execute("SELECT id, name, type, serialization_format FROM topics ORDER BY id").fetchall()
        if not all(isinstance(key, int) and all(isinstance(text, str) for text in texts) for key, *texts in rows):
            raise sqlite3.DatabaseError("its table of topics holds other values than text")
        self._keys: dict[int, str] = {row[0]: row[1] for row in rows}
        groups = "SELECT topic_id, count(*), max(length(data)) FROM messages GROUP BY topic_id"
        found = self._database.execute(f"{groups} LIMIT {_MOST_TOPICS + 1}").fetchall()
        longest = max((length for _, _, length in found if isinstance(length, int)), default=0)
        if longest > LARGEST_CHUNK:
            raise sqlite3.DatabaseError(f"it holds a message of {shown_size(longest)}")
        counts = {key: count for key, count, _ in found}
        if not set(counts) <= set(self._keys):
            raise MessageCountError(
                f"{self._shown} holds messages that belong to none of its topics: copy it again from its origin."
            )
        definitions: dict[str, tuple[str, str]] = {}
        if "message_definitions" in tables:
            query = "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
            definitions = {str(name): (str(form), str(text)) for name, form, text in self._database.execute(query)}
        self.topics = tuple(
            merged_topics(
                TopicInfo(name, full_type(kind), counts.get(key, 0), encoding, *definitions.get(kind, ("", "")))
                for key, name, kind, encoding in rows
            ).values()
        )
        first, last = self._database.execute("SELECT min(timestamp), max(timestamp) FROM messages").fetchone()
        if isinstance(first, int) and isinstance(last, int):
            self.start, self.end = first, last

    def _check_stored(self, table: str) -> None:
        """Refuse tables whose rows are computed as they are read, and texts that no recording has."""
        columns = self._database.execute(f"PRAGMA table_xinfo({table})").fetchall()
        (sql,) = self._database.execute("SELECT sql FROM sqlite_master WHERE name = ?", (table,)).fetchone()
        if any(column[6] for column in columns) or str(sql).lstrip().upper().startswith("CREATE VIRTUAL"):
            raise sqlite3.DatabaseError(f"its table {table} is computed, not recorded")
        if table == "messages":
            return
        lengths = ", ".join(f'max(length("{column[1]}"))' for column in columns[:20] if '"' not in column[1])
        count, *longest = self._database.execute(f"SELECT count(*), {lengths} FROM {table}").fetchone()
        if count > _MOST_TOPICS or any(isinstance(length, int) and length > _LONGEST_TEXT for length in longest):
            raise sqlite3.DatabaseError(f"its table {table} is too large")

    def _damaged(self, error: BaseException) -> TruncatedBagError:
        return TruncatedBagError(
            f"{self._shown} is not a complete recording ({error}): recover it first, for instance with "
            f"'sqlite3 {self._shown.name} .recover'."
        )
