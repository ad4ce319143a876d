"""XML of strangers, read without anything that could pull in other files or fill the memory."""

from __future__ import annotations

import unicodedata
from collections.abc import Callable
from xml.parsers import expat

from fmus.errors import DescriptionError

DEEPEST = 200  # elements inside each other: descriptions are flat, and a parser's stack is not endless

Start = Callable[[str, dict[str, str], int], None]
"""Called for each element with its name, its attributes and how deep it lies, 0 for the root."""


def one_line(text: str) -> str:
    """A stranger's text for a message: line breaks and control characters, which could forge lines, become replacement characters."""
    return "".join("\ufffd" if unicodedata.category(c)[0] == "C" or c in "\u2028\u2029" else c for c in text)


def read_markup(xml: bytes, name: str, start: Start, end: Callable[[str], None] = lambda name: None) -> None:
    """Call `start` and `end` for each element of the document; `name` is the file's, for messages.

    `DescriptionError` for a DOCTYPE (its entities could read files or multiply), for elements nested too deeply, and for XML that is none.
    """
    depth = 0

    def refuse(*_: object) -> None:
        raise DescriptionError(f"{name} has a DOCTYPE, which an FMU does not need and which could pull in other files")

    def opened(element: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        if depth > DEEPEST:
            raise DescriptionError(f"{name} nests its elements more than {DEEPEST} deep")
        start(element, attributes, depth)
        depth += 1

    def closed(element: str) -> None:
        nonlocal depth
        depth -= 1
        end(element)

    parser = expat.ParserCreate()
    parser.StartDoctypeDeclHandler = refuse
    parser.StartElementHandler = opened
    parser.EndElementHandler = closed
    try:
        parser.Parse(xml, True)
    except expat.ExpatError as problem:
        raise DescriptionError(f"{name} is no well-formed XML: {problem}") from None
    except ValueError as problem:  # an encoding that does not exist
        raise DescriptionError(f"{name} cannot be read: {problem}") from None
