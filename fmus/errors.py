"""The exceptions of this package.

    FmuError                 base: what a caller catches
    ├── ArchiveError         the file is no FMU, or not one that is safe to unpack
    ├── DescriptionError     modelDescription.xml is malformed, or has no such variable
    ├── PlatformError        the FMU holds no binary for this machine
    ├── LibraryError         a file is no shared library, or a damaged one
    ├── BuildError           a plant cannot be compiled or packed
    ├── CallFailed           an FMI function returned something other than OK
    ├── LinearizationError   the FMU gives no linear plant at this operating point
    └── DecayError           a measured decay holds no mode that could be identified

What an FMU does wrong *during a run* is not an exception but a `RunStatus`.
"""

from __future__ import annotations


class FmuError(Exception):
    """Base of every error that this package raises on purpose."""


class ArchiveError(FmuError):
    """The file is no FMU, or unpacking it would be unsafe."""


class DescriptionError(FmuError):
    """modelDescription.xml is malformed or unsupported, or a variable that was asked for is not in it."""


class PlatformError(FmuError):
    """The FMU holds no binary for this machine."""


class LibraryError(FmuError):
    """A file is no shared library, or a damaged one."""


class BuildError(FmuError):
    """A plant could not be compiled or packed."""


class LinearizationError(FmuError):
    """The FMU gives no linear plant at this operating point."""

    def __init__(self, message: str, status: object = None) -> None:
        """`status` is the `RunStatus` of an FMU that failed; None if it is the request that cannot be met."""
        super().__init__(message)
        self.status = status


class DecayError(FmuError):
    """A measured decay holds no mode that could be identified."""


class CallFailed(FmuError):
    """An FMI function returned a status other than OK."""

    def __init__(self, call: str, status: str, message: str = "") -> None:
        """`call` is the FMI function's name, `status` the FMI word for what it returned, `message` the FMU's last log line."""
        super().__init__(f"{call} returned {status}" + (f": {message}" if message else ""))
        self.call = call
        self.status = status
        self.message = message
