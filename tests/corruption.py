"""Certificates tampered with: originals of every kind, and ways to change them, the digest forged right."""

from __future__ import annotations

import json
import random
from collections.abc import Callable
from fractions import Fraction
from functools import cache
from typing import Any

from forgery import certificate, forged, number, opened, proven, proven_limited, proven_tail, task, written

STATE = (
    "two_mass_1",
    "two_mass_robust",
    "chain_4",
    "real_mode",
    "rigid_body_asymmetric",
    "oscillator",
    "unstable",
    "double_real",
    "held_robust",
    "fuel",
)
OUTPUT = ("real_zero", "pitch", "complex_zeros", "double_zero", "rest_on_a_limit", "short_tail", "at_once", "at_once_on_a_limit")
OUTPUT += ("insensitive_real", "insensitive_pair")


LIMITS = ("speed", "steps", "steps_from_a_start", "stop", "stop_limited", "fuel_and_speed", "tail_of_limited_slope")


@cache
def limited_originals() -> tuple[bytes, ...]:
    """Of limits of outputs and slopes, and several together."""
    return tuple(map(proven_limited, LIMITS))


@cache
def originals() -> tuple[bytes, ...]:
    impossible = (task(["1"], ["1", "0", "0"], limits=("0", "1")), "face"), (task(["1"], ["1", "1"]), "remainder")
    return (*map(proven, STATE), *map(proven_tail, OUTPUT), *(certificate(of, impossible=criterion) for of, criterion in impossible))


# Ways to tamper; each changes the object in place, or the text.


def leaves(data: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """The paths of all leaves."""
    if isinstance(data, dict):
        return [leaf for name, value in data.items() for leaf in leaves(value, (*path, name))]
    if isinstance(data, list):
        return [leaf for i, value in enumerate(data) for leaf in leaves(value, (*path, i))]
    return [path]


def at(data: Any, path: tuple[Any, ...]) -> Any:
    for step in path:
        data = data[step]
    return data


def put(data: Any, path: tuple[Any, ...], value: Any) -> None:
    at(data, path[:-1])[path[-1]] = value


def numbers(data: Any) -> list[tuple[Any, ...]]:
    """The paths of all real numbers."""
    return [
        path for path in leaves(data) if isinstance(at(data, path), str) and path[0] != "format" and at(data, path)[:1] in "-0123456789"
    ]


def nudge(value: str, rng: random.Random) -> str:
    """A number a little or a lot off."""
    factor = 1 + rng.choice((-1, 1)) * Fraction(1, 10 ** rng.randint(0, 18))
    changed = number(value) * factor if number(value) else Fraction(rng.choice((-1, 1)), 10 ** rng.randint(0, 18))
    return written(changed)


def change_a_number(data: Any, rng: random.Random) -> None:
    path = rng.choice(numbers(data))
    put(data, path, nudge(at(data, path), rng))


def change_a_digit(data: Any, rng: random.Random) -> None:
    path = rng.choice(numbers(data))
    value = at(data, path)
    place = rng.choice([i for i, c in enumerate(value) if c.isdigit()])
    put(data, path, value[:place] + str(rng.randint(0, 9)) + value[place + 1 :])


def flip_a_sign(data: Any, rng: random.Random) -> None:
    path = rng.choice(numbers(data))
    value = at(data, path)
    put(data, path, value[1:] if value.startswith("-") else f"-{value}")


def swap_two_leaves(data: Any, rng: random.Random) -> None:
    one, other = rng.choice(numbers(data)), rng.choice(numbers(data))
    first, second = at(data, one), at(data, other)
    put(data, one, second)
    put(data, other, first)


def move_a_member(data: Any, rng: random.Random) -> None:
    """Delete, repeat or exchange an item or a member."""
    inner = [path[:i] for path in leaves(data) for i in range(1, len(path)) if isinstance(at(data, path[:i]), list | dict)]
    node = at(data, rng.choice(inner))
    if isinstance(node, dict) and node:
        names = list(node)
        one, other = rng.choice(names), rng.choice(names)
        rng.choice((lambda: node.pop(one), lambda: node.update({one: node[other]}), lambda: node.update({one: None})))()
    elif isinstance(node, list) and node:
        i, j = rng.randrange(len(node)), rng.randrange(len(node))
        rng.choice((lambda: node.pop(i), lambda: node.append(node[i]), lambda: node.insert(j, node.pop(i))))()


def lie_about_a_side(data: Any, rng: random.Random) -> None:
    """A larger lower side, a smaller upper one."""
    side = rng.choice(("lower", "upper"))
    if data["claim"][side] is not None:
        grown = 1 + Fraction(1, 10 ** rng.randint(0, 14)) * (1 if side == "lower" else -1)
        data["claim"] |= {"lower": None, "upper": None, side: written(number(data["claim"][side]) * grown)}


def soften_a_claim(data: Any, rng: random.Random) -> None:
    """A smaller lower side, a larger upper one: weaker, and true."""
    shrink = Fraction(1, 10 ** rng.randint(0, 9))
    if data["claim"]["lower"] is not None:
        data["claim"]["lower"] = written(number(data["claim"]["lower"]) * (1 - shrink))
    if data["claim"]["upper"] is not None:
        data["claim"]["upper"] = written(number(data["claim"]["upper"]) * (1 + shrink))


def one_side_of_another_task(data: Any, rng: random.Random) -> None:
    """Other limits, displacement, rest input, further zeros or tail length; one side stays, which may even stay true."""
    data["claim"][rng.choice(("lower", "upper"))] = None
    posed, limits = data["task"], data["task"]["limits"]
    match rng.randrange(9):
        case 0:
            i = rng.randrange(2)
            limits["input"][i] = nudge(limits["input"][i], rng)
        case 1:
            posed["displacement"] = nudge(posed["displacement"], rng)
        case 2:
            posed["initial_input"] = nudge(posed["initial_input"], rng)
        case 3:
            posed["plants"][0]["zeros"] = rng.choice(({}, {"mode[1]": 1}, {"real[1]": 1}, {"mode[1]": 2}))
        case 4:
            limits["tail_length"] = rng.choice((None, {"time": "1", "within": "0.5"}, {"time": "0", "within": "1/1000"}))
        case 5:
            limits["sample_time"] = rng.choice(("0.25", "2"))
        case 6:
            limits["fuel"] = rng.choice((None, "1", "6.7")) if limits["fuel"] is None else nudge(limits["fuel"], rng)
        case 7:
            posed["rest"] = rng.choice(("state", "output"))
        case _:
            polynomial = posed["plants"][0][rng.choice(("numerator", "denominator"))]
            i = rng.randrange(len(polynomial))
            polynomial[i] = nudge(polynomial[i], rng)


def call_it_impossible(data: Any, rng: random.Random) -> None:
    data["claim"] = {"lower": None, "upper": None, "impossible": rng.choice(("face", "remainder", "fuel", "overshoot"))}
    if rng.random() < 0.5:
        data["task"]["limits"]["input"][rng.randrange(2)] = rng.choice(("0", "1", "-1", data["task"]["displacement"]))


def rename_unknowns(data: Any, rng: random.Random) -> None:
    if data["upper"]:
        count = len(data["upper"]["segments"]) + 1
        for _ in range(rng.randint(1, 2)):
            if data["upper"]["free"]:
                name = [rng.choice(("time", "start", "level", "re", "im")), rng.randrange(count), rng.randrange(2)]
                data["upper"]["free"][rng.randrange(len(data["upper"]["free"]))] = name


def another_radius(data: Any, rng: random.Random) -> None:
    if data["upper"]:
        data["upper"]["radius"] = written(Fraction(10) ** rng.randint(-40, 3))


def drop_a_multiplier(data: Any, rng: random.Random) -> None:
    """One of a limit's terms less, or another weight of it."""
    lower = data["lower"] or {}
    lists = [lower[name] for name in ("deflection", "ramps", "steps", "after", "tail") if lower.get(name)]
    if lists:
        terms = rng.choice(lists)
        i = rng.randrange(len(terms))
        if rng.random() < 0.5:
            terms.pop(i)
        elif isinstance(terms[i], dict):
            name = rng.choice([name for name, value in terms[i].items() if isinstance(value, str) and name != "output"] or ["levels"])
            terms[i][name] = nudge(terms[i][name], rng) if isinstance(terms[i][name], str) else terms[i][name][:-1]
        else:
            terms[i] = nudge(terms[i], rng)


def another_limit(data: Any, rng: random.Random) -> None:
    """A tighter or a wider limit of an output, the slope, the fuel, or another start; one side stays, which may even stay true."""
    data["claim"][rng.choice(("lower", "upper"))] = None
    limits, start = data["task"]["limits"], data["task"]["initial_state"]
    match rng.randrange(4):
        case 0 if limits["deflection"]:
            (name,) = limits["deflection"]
            limits["deflection"][name] = nudge(limits["deflection"][name], rng)
        case 1 if limits["rate"]:
            i = rng.randrange(2)
            limits["rate"][i] = nudge(limits["rate"][i], rng)
        case 2 if start:
            i = rng.randrange(len(start))
            start[i] = nudge(start[i], rng)
        case _:
            limits["rate"] = rng.choice((None, ["-2", "2"], ["-50", "50"]))


WAYS: tuple[Callable[[Any, random.Random], None], ...] = (
    change_a_number,
    change_a_digit,
    flip_a_sign,
    swap_two_leaves,
    move_a_member,
    lie_about_a_side,
    soften_a_claim,
    one_side_of_another_task,
    one_side_of_another_task,
    call_it_impossible,
    rename_unknowns,
    another_radius,
)


LIMIT_WAYS = (*WAYS, *(drop_a_multiplier, another_limit, lie_about_a_side) * 3)


def tampered(seed: int, limited: bool = False) -> tuple[str, bytes]:
    """A certificate, tampered with in one way or two and signed again; or some of its bytes changed, signed again if it still is JSON."""
    rng = random.Random(f"tampered {seed}{' with limits' if limited else ''}")
    content = rng.choice(limited_originals() if limited else originals())
    if rng.random() < 0.1:
        raw = bytearray(content)
        for _ in range(rng.randint(1, 3)):
            raw[rng.randrange(len(raw))] = rng.randrange(256) if rng.random() < 0.3 else rng.choice(b'0123456789.-/x"[]{},')
        try:
            return "bytes", forged(json.loads(bytes(raw)))
        except (ValueError, AttributeError, TypeError):
            return "bytes", bytes(raw)
    data, names = opened(content), []
    for way in rng.choices(LIMIT_WAYS if limited else WAYS, k=rng.choice((1, 1, 2))):
        try:
            way(data, rng)
        except (KeyError, IndexError, TypeError, ValueError, ZeroDivisionError):  # what the first change left does not suit the second
            continue
        names.append(way.__name__)
    return " + ".join(names), forged(data)
