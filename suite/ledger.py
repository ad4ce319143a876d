"""The ledger: one row a run in an SQLite file, so that a campaign that was cut short goes on where it stopped."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any

from suite.errors import SuiteError

SCHEMA = "CREATE TABLE IF NOT EXISTS runs (id TEXT PRIMARY KEY, name TEXT NOT NULL, verdict TEXT NOT NULL, result TEXT NOT NULL)"


class LedgerError(SuiteError):
    """The ledger is damaged, or in use by another process."""


class Ledger:
    """Rows by run id (a hash of everything that determines the run); each row is committed as soon as its log is on disk.

    Everything here raises `LedgerError` if the file cannot be used.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        with self._usable():
            # Rows are written by one thread at a time: the campaign holds a lock while it records.
            self._connection = sqlite3.connect(path, check_same_thread=False)
            try:
                self._connection.execute("PRAGMA journal_mode = WAL")
                self._connection.execute(SCHEMA)
                self._connection.commit()
            except BaseException:
                self._connection.close()
                raise

    def __enter__(self) -> Ledger:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        with self._usable():
            try:
                # Back to a single file: the write-ahead log and its index would not be part of the evidence.
                self._connection.execute("PRAGMA journal_mode = DELETE")
            finally:
                self._connection.close()

    def find(self, run_id: str) -> dict[str, Any] | None:
        """The result recorded for a run, or None."""
        with self._usable():
            row = self._connection.execute("SELECT result FROM runs WHERE id = ?", (run_id,)).fetchone()
            return None if row is None else json.loads(row[0])

    def add(self, run_id: str, name: str, verdict: str, result: Mapping[str, object]) -> None:
        """Record a finished run (again, if need be)."""
        self._write("INSERT OR REPLACE INTO runs VALUES (?, ?, ?, ?)", run_id, name, verdict, json.dumps(result))

    def amend(self, name: str, result: Mapping[str, object]) -> None:
        """Replace the result of the run called `name`."""
        self._write("UPDATE runs SET result = ? WHERE name = ?", json.dumps(result), name)

    def _write(self, statement: str, *values: str) -> None:
        with self._usable():
            self._connection.execute(statement, values)
            self._connection.commit()

    @contextmanager
    def _usable(self) -> Iterator[None]:
        try:
            yield
        except (sqlite3.Error, ValueError) as problem:
            message = f"{self._path} cannot be used ({problem}): is another run at work in this folder? If not, --force begins anew"
            raise LedgerError(message) from None
