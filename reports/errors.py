"""What can be wrong with evidence.

    ReportError
    ├── RecordError      a record does not fit together (shapes, names, times), or a result lacks a member the page needs
    ├── LogError         a log is damaged, or is not one of ours
    └── ManifestError    a manifest is missing or malformed

A truncated log is no error: it reads as far as it goes and has no verdict.
"""


class ReportError(Exception):
    """Base of everything this package raises on purpose."""


class RecordError(ReportError):
    """A record does not fit together."""


class LogError(ReportError):
    """A log is damaged, or is not one of ours."""


class ManifestError(ReportError):
    """A manifest is missing or malformed."""
