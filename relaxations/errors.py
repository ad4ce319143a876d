"""What can be wrong with a request to `relaxations`.

    RelaxationsError
    ├── PlantError       the plant cannot be used as written (improper, a zero at the origin, a hidden mode …)
    ├── ManeuverError    the task has no answer, or only a degenerate one (limits without the rest input …)
    ├── CommandError     a command or command file is malformed
    ├── ShaperError      a shaper or shaper file is malformed, or what was asked of it has no form that is known here
    │   └── ImpossibleShaperError   there is no shaper of that kind
    └── SolverError      a numerical step failed; what was tried stands in the message
        └── ShortHorizonError   the time is so short that the modes cannot be told apart in it

"Not proved" is no error but a status of `relaxations.bounds.Bound`.
"""


class RelaxationsError(Exception):
    """Base of everything this package raises on purpose."""


class PlantError(RelaxationsError):
    """The plant cannot be used as written."""


class ManeuverError(RelaxationsError):
    """The task is refused by definition."""


class CommandError(RelaxationsError):
    """A command or command file is malformed."""


class ShaperError(RelaxationsError):
    """A shaper or shaper file is malformed, or a shaped command is none that segments and one tail can hold."""


class ImpossibleShaperError(ShaperError):
    """There is no shaper of the kind that was asked for; the message says what would be possible."""


class SolverError(RelaxationsError):
    """A numerical step failed."""


class ShortHorizonError(SolverError):
    """The moment equations are dependent to rounding: in so short a time the modes cannot be told apart, let alone be reached."""
