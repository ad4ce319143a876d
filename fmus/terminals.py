"""Terminals of an FMU: which variables belong together as one connector (terminalsAndIcons.xml of FMI 3.0)."""

from __future__ import annotations

from dataclasses import dataclass

from fmus.markup import read_markup

TERMINALS = "terminalsAndIcons/terminalsAndIcons.xml"


@dataclass(frozen=True, slots=True)
class Member:
    """A variable of a terminal: the FMU's name for it, its name in the terminal, and what it is there ("signal", "inflow" …)."""

    variable: str
    name: str
    kind: str


@dataclass(frozen=True, slots=True)
class Terminal:
    """A connector: `matching` tells how it is joined ("plug", "bus", "sequence"), `kind` what it is; terminals may hold others."""

    name: str
    matching: str
    kind: str = ""
    description: str = ""
    members: tuple[Member, ...] = ()
    terminals: tuple[Terminal, ...] = ()


def read_terminals(xml: bytes) -> tuple[Terminal, ...]:
    """The terminals in a terminalsAndIcons.xml; `DescriptionError` if it is no XML, or has a DOCTYPE."""
    top: list[Terminal] = []
    stack: list[tuple[dict[str, str], list[Member], list[Terminal]]] = []

    def start(element: str, attributes: dict[str, str], depth: int) -> None:
        if element == "Terminal":
            stack.append((attributes, [], []))
        elif element in ("TerminalMemberVariable", "TerminalStreamMemberVariable") and stack:
            name = attributes.get("variableName") or attributes.get("inStreamVariableName", "")
            stack[-1][1].append(Member(name, attributes.get("memberName", ""), attributes.get("variableKind", "stream")))

    def end(element: str) -> None:
        if element == "Terminal":
            a, members, inner = stack.pop()
            made = Terminal(
                a.get("name", ""),
                a.get("matchingRule", ""),
                a.get("terminalKind", ""),
                a.get("description", ""),
                tuple(members),
                tuple(inner),
            )
            (stack[-1][2] if stack else top).append(made)

    read_markup(xml, "terminalsAndIcons.xml", start, end)
    return tuple(top)
