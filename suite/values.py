"""What a single value in a study file may be: plain functions that return the value as meant, or raise `ValueError` with a sentence.

Numbers stay exact: an integer or a decimal as written becomes a `Decimal`, never a float.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from decimal import Decimal
from typing import Literal

LARGEST, SMALLEST, DIGITS = Decimal("1e150"), Decimal("1e-150"), 400  # squares still fit a double, and an exact fraction stays small
MOST_SAMPLES = 100_000
DEVICES = {"CON", "PRN", "AUX", "NUL", *(f"{port}{i}" for port in ("COM", "LPT") for i in range(1, 10))}


def number(value: object) -> Decimal:
    """A finite number of a sane magnitude, exactly as written."""
    if isinstance(value, bool) or not isinstance(value, int | Decimal):
        raise ValueError("must be a number, such as 1.5")
    exact = Decimal(value)
    if not exact.is_finite():
        raise ValueError("must be a finite number")
    if exact and not SMALLEST <= exact.copy_abs() <= LARGEST:
        raise ValueError(f"must be 0 or of a magnitude between {SMALLEST} and {LARGEST}")
    if len(exact.as_tuple().digits) > DIGITS:
        raise ValueError(f"must have at most {DIGITS} digits")
    return exact


def whole(value: object) -> int:
    """A whole number that fits 64 bits."""
    if isinstance(value, bool) or not isinstance(value, int):
        raise ValueError("must be a whole number, such as 3")
    if abs(value) >= 2**63:
        raise ValueError("must be a whole number of at most 64 bits")
    return value


def text(value: object) -> str:
    """Text that is not empty and can stand in XML, HTML and on a terminal."""
    if not isinstance(value, str):
        raise ValueError("must be text in quotes")
    if not value.strip():
        raise ValueError("must not be empty")
    if any(not (c.isprintable() or c in "\n\t") for c in value):
        raise ValueError("must not contain control characters")
    return value


def settle(value: object) -> bool | Decimal:
    """`true`, or a time."""
    if value is True:
        return True
    if value is False:
        raise ValueError("must be true (until at rest) or a number of seconds; leave it out to start at once")
    return positive(number(value))


def response_samples(value: int) -> int:
    """Samples of a response from which a plant can be identified."""
    if not 16 <= value <= 4000:
        raise ValueError("must be between 16 and 4000")
    return value


def positive(value: Decimal) -> Decimal:
    """Greater than 0."""
    if value <= 0:
        raise ValueError("must be greater than 0")
    return value


def non_negative(value: Decimal) -> Decimal:
    """0 or greater."""
    if value < 0:
        raise ValueError("must not be negative")
    return value


def natural(value: int) -> int:
    """0, 1, 2 …"""
    if value < 0:
        raise ValueError("must be a whole number from 0 on")
    return value


def count(value: int) -> int:
    """1, 2, 3 …"""
    if value < 1:
        raise ValueError("must be a whole number from 1 on")
    return value


def profile_type(value: int) -> int:
    """1: positive pulses, then negative pulses; 2: any order."""
    if value not in (1, 2):
        raise ValueError("must be 1 or 2")
    return value


def samples(value: int) -> int:
    """As many values of one parameter as a campaign can hope to finish."""
    if value > MOST_SAMPLES:
        raise ValueError(f"must be at most {MOST_SAMPLES}")
    return value


def mebibytes(value: int) -> int:
    """Memory that a process can live in, and that a computer may have."""
    if not 64 <= value <= 2**30:
        raise ValueError("must be a whole number of MiB from 64 on")
    return value


def items(value: object) -> Sequence[object]:
    """A list, of whatever."""
    if not isinstance(value, list):
        raise ValueError("must be a list in brackets")
    return value


def pair(value: object) -> Sequence[object]:
    """A list of two."""
    if not isinstance(value, list) or len(value) != 2:
        raise ValueError("must be two numbers, [lower, upper]")
    return value


def ascending(value: tuple[Decimal, Decimal]) -> tuple[Decimal, Decimal]:
    """An interval that is not empty."""
    if not value[0] < value[1]:
        raise ValueError("must be [lower, upper] with lower < upper")
    return value


def root(value: object) -> tuple[Decimal, Decimal]:
    """A complex number: [re, im], or a real number."""
    if isinstance(value, list):
        if len(value) != 2:
            raise ValueError("must be a number or a pair [re, im]")
        return number(value[0]), number(value[1])
    return number(value), Decimal(0)


def robustness(value: object) -> int | Literal["box"] | Mapping[str, int]:
    """Further zeros at every flexible mode, at the modes of a table, or the word "box"."""
    if value == "box":
        return "box"
    if isinstance(value, int) and not isinstance(value, bool) and 0 <= value < 1000:
        return value
    if isinstance(value, dict) and value:
        for key, zeros in value.items():
            if not re.fullmatch(r"(mode|real)\[[1-9]\d{0,3}\]", key):
                raise ValueError(f'has the key "{key}"; a table of robustness has keys such as "mode[1]" or "real[2]"')
            if isinstance(zeros, bool) or not isinstance(zeros, int) or not 0 <= zeros < 1000:
                raise ValueError(f'has {zeros!r} further zeros at "{key}"; valid are whole numbers from 0 on')
        return dict(value)
    raise ValueError('must be a whole number from 0 on, "box", or a table such as { "mode[1]" = 1 }')


def state(value: object) -> tuple[Decimal, ...] | Mapping[str, Decimal]:
    """One number a state, in order or by name."""
    if isinstance(value, list) and value:
        return tuple(number(x) for x in value)
    if isinstance(value, dict) and value:
        return {name: number(x) for name, x in value.items()}
    raise ValueError("must be a list of one number a state, or a table of numbers by the states' names")


def identifier(value: str) -> str:
    """A name that every file system and XML accept."""
    if not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_.-]{0,79}", value) or value.endswith("."):
        raise ValueError(
            "must serve as a file name and in XML: at most 80 of the letters A to Z, digits, '_', '-' and '.', "
            "a letter or '_' first, no '.' last"
        )
    if value.split(".")[0].upper() in DEVICES:
        raise ValueError("is the name of a device on some systems and no file name there")
    return value


def mode_text(value: str) -> str:
    """A mode as the command line writes it: natural frequency and damping ratio."""
    split_mode(value)
    return value


def split_mode(value: str) -> tuple[float, str, float]:
    """Frequency, its unit and damping ratio of a mode as it is written; what they may be is up to `Mode`. Raises `ValueError`."""
    found = re.fullmatch(r"\s*(.*?)\s*(Hz|rad/s)\s*(?::\s*(.*?))?\s*", value)
    if found is None:
        raise ValueError('must be FREQUENCY(Hz|rad/s):DAMPING, such as "1.0Hz:0.05"')
    if found[3] is None:
        raise ValueError('has no damping ratio; must be FREQUENCY(Hz|rad/s):DAMPING, such as "1.0Hz:0.05", without damping "1.0Hz:0"')
    numbers, wrong = [], []
    for name, text in (("frequency", found[1]), ("damping ratio", found[3])):
        try:
            numbers.append(float(text))
        except ValueError:
            wrong.append(f"the {name} {text!r} is no number")
    if wrong:
        raise ValueError(f'{"; ".join(wrong)}; must be FREQUENCY(Hz|rad/s):DAMPING, such as "1.0Hz:0.05"')
    return numbers[0], found[2], numbers[1]


def factors(value: tuple[Decimal, Decimal]) -> tuple[Decimal, Decimal]:
    """Factors of a frequency."""
    if value[0] <= 0:
        raise ValueError("must be factors of each mode's frequency, above 0")
    return value


def dampings(value: tuple[Decimal, Decimal]) -> tuple[Decimal, Decimal]:
    """Damping ratios."""
    if not (value[0] >= 0 and value[1] < 1):
        raise ValueError("must be damping ratios, at least 0 and less than 1")
    return value


def zero_name(value: str) -> str:
    """The name of a zero."""
    if not re.fullmatch(r"zero\[[1-9]\d{0,2}\]", value):
        raise ValueError(f'has the key "{value}"; its keys are names of zeros such as "zero[1]"')
    return value


def zero_listed(value: str) -> str:
    """The name of a zero in a list."""
    if not re.fullmatch(r"zero\[[1-9]\d{0,2}\]", value):
        raise ValueError('names a zero of the plant, such as "zero[1]"')
    return value


def fraction(value: Decimal) -> Decimal:
    """Between 0 and 1, both excluded."""
    if not 0 < value < 1:
        raise ValueError("must lie between 0 and 1")
    return value


def nonzero(value: Decimal) -> Decimal:
    """Anything but 0."""
    if value == 0:
        raise ValueError("must not be 0")
    return value


def table(value: object) -> Mapping[str, object]:
    """A table, of whatever."""
    if not isinstance(value, dict):
        raise ValueError("must be a table in braces")
    return value


def setting(value: object) -> object:
    """What a variable of an FMU may be set to: a number, true or false, the name of an enumeration's item, or a list of these."""
    if isinstance(value, list):
        return tuple(setting(item) for item in value)
    if isinstance(value, bool):
        return value
    if isinstance(value, str):
        return text(value)
    if isinstance(value, int | Decimal):
        return number(value)
    raise ValueError("must be a number, true or false, the name of an enumeration's item in quotes, or a list of these")
