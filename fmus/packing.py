"""Writing archives: the same bytes for the same content, all or nothing."""

from __future__ import annotations

import hashlib
import io
import os
import tempfile
import zipfile
from collections.abc import Mapping
from pathlib import Path


def digest(parts: Mapping[str, bytes]) -> str:
    """SHA-256 (hex) of named parts, whatever their order."""
    total = hashlib.sha256()
    for name in sorted(parts):
        total.update(f"{name}\0{len(parts[name])}\0".encode() + parts[name])
    return total.hexdigest()


def token(parts: Mapping[str, bytes]) -> str:
    """A GUID made of the parts: a library never meets the description of another build unnoticed."""
    total = digest(parts)
    return f"{{{total[:8]}-{total[8:12]}-{total[12:16]}-{total[16:20]}-{total[20:32]}}}"


def zipped(files: Mapping[str, bytes]) -> bytes:
    """A zip archive of `files`, without dates and owners."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name in sorted(files):
            entry = zipfile.ZipInfo(name, date_time=(1980, 1, 1, 0, 0, 0))
            entry.compress_type, entry.create_system, entry.external_attr = zipfile.ZIP_DEFLATED, 3, 0o644 << 16
            archive.writestr(entry, files[name])
    return buffer.getvalue()


def write(path: Path, content: bytes) -> None:
    """Write all or nothing: several processes may write the same file at once."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile(dir=path.parent, prefix=path.name, delete=False) as file:
        file.write(content)
    try:
        os.chmod(file.name, 0o644)
        os.replace(file.name, path)
    except OSError:
        os.unlink(file.name)
        raise
