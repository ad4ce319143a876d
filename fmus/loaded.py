"""Shared libraries in this process: each is loaded once and stays. Standard library only, as this runs beside the FMU."""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path

from fmus.errors import FmuError


@cache
def loaded(library: Path) -> tuple[ctypes.CDLL, dict[str, Callable[..., int]], dict[str, int]]:
    """A shared library, which stays loaded, its functions with their prototypes and addresses, as far as they have been asked for."""
    return load(library), {}, {}


def load(library: Path) -> ctypes.CDLL:
    """Load a shared library; `FmuError` says what the system's loader says."""
    try:
        if sys.platform == "win32":
            os.add_dll_directory(str(library.parent))
        return ctypes.CDLL(str(library))
    except OSError as problem:
        words = str(problem).replace(str(library), library.name)  # its folder is another one in every run
        raise FmuError(f"the FMU's binary cannot be loaded: {words}") from None
