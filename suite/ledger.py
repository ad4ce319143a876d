"""The ledger: one row a run in an SQLite file, so that a campaign that was cut short goes on where it stopped."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

SCHEMA = "CREATE TABLE IF NOT EXISTS runs (id TEXT PRIMARY KEY, name TEXT NOT NULL, verdict TEXT NOT NULL, result TEXT NOT NULL)"


class Ledger:
    """Rows by run id (a hash of everything that determines the run); each row is committed as soon as its log is on disk."""

    def __init__(self, path: Path) -> None:
        # Rows are written by one thread at a time: the campaign holds a lock while it records.
        self._connection = sqlite3.connect(path, check_same_thread=False)
        self._connection.execute("PRAGMA journal_mode = WAL")
        self._connection.execute(SCHEMA)
        self._connection.commit()

    def __enter__(self) -> Ledger:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        # Back to a single file: the write-ahead log and its index would not be part of the evidence.
        self._connection.execute("PRAGMA journal_mode = DELETE")
        self._connection.close()

    def find(self, run_id: str) -> dict[str, Any] | None:
        """The result recorded for a run, or None."""
        row = self._connection.execute("SELECT result FROM runs WHERE id = ?", (run_id,)).fetchone()
        return None if row is None else json.loads(row[0])

    def add(self, run_id: str, name: str, verdict: str, result: Mapping[str, object]) -> None:
        """Record a finished run (again, if need be)."""
        row = (run_id, name, verdict, json.dumps(result, sort_keys=True))
        self._connection.execute("INSERT OR REPLACE INTO runs VALUES (?, ?, ?, ?)", row)
        self._connection.commit()
