"""Certificates by hand: what a liar could write, always with the right digest."""

from __future__ import annotations

import copy
import hashlib
import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any

import flint
import rfc8785
from problems import KNOWN, Known, transfer

from relaxations.checking import balls
from relaxations.checking.reading import TASK, read, shaped
from relaxations.initial import from_output
from relaxations.maneuvers import Limits, Maneuver, Problem, problem
from relaxations.plants import exact
from relaxations.proofs import minimum_time

# Repeated poles and further zeros off the origin, where the rest input is held.
HELD = (
    Known("double_real", transfer([1], [1, 4, 4]), "0.2", None, "", robustness={"real[1]": 1}),
    Known("held_robust", transfer([1], [1, "0.2", 1]), "0.5", None, "", robustness=1),
)
BY_NAME = {known.name: known for known in (*KNOWN, *HELD, Known("fuel", transfer([1], [1, 0, 2, 0, 0]), "5", None, "", fuel="4"))}
RECORDED = Path(__file__).with_name("recorded")
"""Certificates that were made before the checker was changed on purpose (mutants.py); otherwise this folder does not exist."""


@cache
def proven(name: str) -> bytes:
    """The certificate of a problem of the collection, both sides proven."""
    return _certified(name, BY_NAME[name].problem)


def _limited(
    denominator: list[Any],
    displacement: str,
    start: tuple[int, ...] = (),
    sample_time: Fraction | None = None,
    pulse_width: Fraction | None = None,
    speed: str | None = None,
    rate: tuple[str, str] | None = None,
    fuel: str | None = None,
    numerator: tuple[int, ...] = (1,),
) -> Problem:
    plant = transfer([*numerator], denominator)()
    begin = from_output(plant, [Fraction(x) for x in start]) if start else None
    limits = replace(Limits.of(-1, 1, fuel, {"output_rate": speed} if speed else {}, rate), pulse_width=pulse_width)
    return problem([plant], Maneuver(Fraction(displacement), limits, initial=begin, sample_time=sample_time, tail=len(numerator) > 1))


LIMITED: dict[str, Callable[[], Problem]] = {
    "sampled": lambda: _limited([2, 0, 4, 0, 0], "5", sample_time=Fraction(1, 4)),
    "exact": lambda: _limited([1, 0, 0], "1", sample_time=Fraction(1, 10)),
    "started": lambda: _limited([1, 0, 1], "1/4", start=(5, 3)),
    "braked": lambda: _limited([1, "0.3", 4], "1/10", start=(2, -1)),
    "pulsed": lambda: _limited([1, 0, 0], "1", pulse_width=Fraction(11, 10)),
    "slope": lambda: _limited([1, 0, 0], "1", rate=("-4", "4")),
    "speed": lambda: _limited([1, 0, 0], "1", speed="0.5"),
    "steps": lambda: _limited([1, 0, 0], "1", sample_time=Fraction(7, 100), speed="0.5", rate=("-4", "4")),
    "steps_from_a_start": lambda: _limited([1, "0.2", 1], "0.3", start=(0, 1), sample_time=Fraction(1, 5), speed="1.2", rate=("-3", "3")),
    "stop": lambda: _limited([1, 0], "0", start=(1,), rate=("-4", "4")),
    "stop_limited": lambda: _limited([1, 0, 0], "2", start=(0, 1), speed="1.1"),
    "fuel_and_speed": lambda: _limited([1, 0, 0], "1", sample_time=Fraction(1, 10), speed="0.6", fuel="1"),
    "held_slope": lambda: _limited([1, 1], "1/2", rate=("-4", "4")),
    "held_steps": lambda: _limited([1, "0.5", 1], "1/2", rate=("-2", "2"), sample_time=Fraction(1, 4)),
    "tail_of_limited_slope": lambda: _limited([1, 0, 0], "1", rate=("-4", "4"), numerator=(1, 1)),
}
"""Tasks with limits beyond the input's."""


@cache
def proven_limited(name: str) -> bytes:
    """The certificate of one of `LIMITED`."""
    return _certified(f"limited_{name}", LIMITED[name])


@cache
def proven_tail(name: str) -> bytes:
    """The certificate of an output rest."""
    numerator, denominator, displacement, limits, length = TAILS[name]
    sensitivity = {"zero[1]": (Fraction(1, 10), Fraction(1, 50))} if name.startswith("insensitive") else {}
    maneuver = Maneuver(exact(displacement), Limits.of(*limits), tail=True, tail_length=length, zero_sensitivity=sensitivity)
    return _certified(f"tail_{name}", lambda: problem([transfer(numerator, denominator)()], maneuver))


TAILS: dict[str, tuple[list[Any], list[Any], Any, tuple[Any, Any], tuple[Fraction, Fraction] | None]] = {
    "real_zero": ([1, 1], [1, 0, 0], 1, (-1, 1), None),
    "pitch": (["1.151", "0.1774"], [1, "0.739", "2.072", "0.1774"], "0.2", ("-0.3", "0.3"), None),
    "complex_zeros": ([1, 2, 3], [1, 0, 0, 0], 1, (-1, 1), None),
    "double_zero": ([1, 2, 1], [1, 0, 2, 0, 0], 1, (-1, 1), None),
    "rest_on_a_limit": ([1, 1], [1, 5, 6], 1, (-1, 6), None),
    "at_once": ([1, 2, 3], [1, 0, 1], 1, (-1, 4), None),
    "at_once_on_a_limit": ([1, 2, 3], [1, 0, 1], 1, (-1, 1), None),
    "at_once_on_the_other": ([1, 2, 3], [1, 0, 1], -1, (-1, 1), None),
    "at_once_amplified": ([2, 4, 6], [1, 0, 1], 2, (-1, 1), None),
    "at_once_and_rising": ([1, 1, 3], [1, "1.5", 1], 1, (-1, 4), None),
    "short_tail": ([1, 1], [1, 0, 0], 1, (-1, 1), (Fraction(1), Fraction(1, 20))),
    "no_stable_zero": ([-1, 1], [1, 2, 0], 1, (-1, 1), None),
    "insensitive_real": ([1, 1], [1, 3, 0, 0], "0.5", (-2, 2), None),
    "insensitive_pair": ([1, 1, "4.25"], [1, "2.2", "9.41", "18.02", 0, 0], "0.5", (-2, 2), None),
    "insensitive_double": ([3, 6, 3], [1, "4.4", "2.64", "4.16"], "0.5", (-2, 2), None),
    "insensitive_at_once": ([1, 2, 5], [1, "0.4", "1.04"], "0.5", (-2, 2), None),
}
"""Numerator, denominator, displacement, limits, length of the tail; insensitive ones allow a residual of 2 % for a shift of 10 %."""


def _certified(name: str, pose: Callable[[], Any]) -> bytes:
    if (file := RECORDED / f"{name}.json").exists():
        return file.read_bytes()
    bound = minimum_time(pose())
    assert bound.certificate is not None
    assert bound.status.name == "PROVED", bound.reason
    return bound.certificate


def opened(content: bytes) -> dict[str, Any]:
    """A certificate's object, to be changed at will."""
    return json.loads(content)


def forged(data: dict[str, Any]) -> bytes:
    """Canonical bytes with the digest that belongs to them."""
    plain = {name: value for name, value in data.items() if name != "digest"}
    return rfc8785.dumps({**plain, "digest": hashlib.sha256(rfc8785.dumps(plain)).hexdigest()})


def changed(content: bytes, change: Callable[[dict[str, Any]], Any]) -> bytes:
    """A certificate with one change, signed again."""
    data = copy.deepcopy(opened(content))
    change(data)
    return forged(data)


def number(text: str) -> Fraction:
    """The exact value of a certificate's number."""
    return Fraction(float.fromhex(text)) if "x" in text else Fraction(text)


def written(value: Fraction) -> str:
    """A fraction in lowest terms, or a whole number."""
    return str(value.numerator) if value.denominator == 1 else f"{value.numerator}/{value.denominator}"


def task(numerator: list[str], denominator: list[str], displacement: str = "1", **others: Any) -> dict[str, Any]:
    """A task as a certificate writes it; state rest and |u| ≤ 1 unless said otherwise."""
    limits = {"input": list(others.pop("limits", ("-1", "1")))}
    limits |= {name: others.pop(name, None) for name in ("fuel", "rate", "pulse_width", "pulses", "held", "sample_time")}
    limits |= {"deflection": others.pop("deflection", {})}
    limits |= {"tail_length": others.pop("tail_length", None), "zero_sensitivity": others.pop("zero_sensitivity", {})}
    plant = {"numerator": numerator, "denominator": denominator, "outputs": others.pop("outputs", {}), "zeros": others.pop("zeros", {})}
    return {
        "plants": [plant],
        "schedule": None,
        "box": None,
        "displacement": displacement,
        "initial_state": None,
        "rest": "state",
        "limits": limits,
        "initial_input": "0",
        **others,
    }


def certificate(
    of: dict[str, Any], lower: Any = None, upper: Any = None, impossible: str | None = None, witnesses: Any = (None, None)
) -> bytes:
    """A certificate of a task with any claim and witnesses."""
    claim = {"lower": lower, "upper": upper, "impossible": impossible}
    return forged({"format": "slewcert-certificate/1", "task": of, "claim": claim, "lower": witnesses[0], "upper": witnesses[1]})


def costate(
    *chains: tuple[tuple[str, str], list[tuple[str, str]]],
    tail: Any = (),
    fuel: str = "0",
    deflection: Any = (),
    ramps: Any = (),
    steps: Any = (),
    after: Any = (),
    changes: Any = (),
) -> dict[str, Any]:
    """A lower side's witness."""
    written_chains = [{"near": list(near), "coefficients": [list(c) for c in coefficients]} for near, coefficients in chains]
    return {
        "costate": [written_chains],
        "tail": list(tail),
        "samples": [],
        "after": list(after),
        "fuel": fuel,
        "deflection": list(deflection),
        "ramps": list(ramps),
        "steps": list(steps),
        "changes": list(changes),
        "pulses": [],
    }


def command(time: str, segments: list[tuple[str, str]], free: list[list[Any]], radius: str = "1/1000000", tail: Any = ()) -> dict[str, Any]:
    """An upper side's witness."""
    arcs = [{"start": start, "level": level} for start, level in segments]
    return {"maneuver_time": time, "segments": arcs, "tail": list(tail), "free": free, "radius": radius, "mirrored": False}


def system(of: dict[str, Any], bits: int = 128) -> balls.System:
    """A task's equations in balls, as the checker sees them, with work enough to look at them."""
    balls.work["left"] = 1e9
    with flint.ctx.workprec(bits):
        return balls.system(read(certificate(of, lower="1", witnesses=(costate(), None))).task)


@contextmanager
def posed(of: dict[str, Any], bits: int = 128) -> Iterator[balls.System]:
    """A task's equations in balls, with the precision in force that they were made with and work enough to look at them."""
    balls.work["left"] = 1e12
    with flint.ctx.workprec(bits):
        yield balls.system(shaped(of, TASK, "task"))


def known(name: str) -> Known:
    """A problem of the collection."""
    return BY_NAME[name]


def scaled(data: Any, path: tuple[Any, ...], factor: str) -> None:
    """One number of an opened certificate, multiplied."""
    node = data
    for step in path[:-1]:
        node = node[step]
    node[path[-1]] = written(number(node[path[-1]]) * Fraction(factor))
