"""Writing certificates: the exact task, a costate for the lower side, a command with its unknowns for the upper side.

Nothing here proves anything: a certificate counts when the checker (`relaxations.checking`), which shares no code with this, accepts it.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
import rfc8785
from numpy.typing import NDArray

from relaxations.maneuvers import Problem
from relaxations.plants import fraction
from relaxations.prices import NONE, Prices
from relaxations.robust.boxes import Axis, Box, Family, Listed, Place, Polynomial
from relaxations.robust.moved import Move, Moved
from relaxations.transitions import VaryingPlant
from relaxations.varying_courses import driven

Number = Fraction | float
Numbers = Sequence[Number] | NDArray[np.float64]

FORMAT, COST_FORMAT = "slewcert-certificate/1", "slewcert-cost/1"
HELD = {0: None, 1: "positive, then negative", -1: "negative, then positive"}
LONGEST_DECIMAL = 60  # digits; longer exact numbers are written as p/q


def text(value: Fraction | float) -> str:
    """An exact number as the certificate writes it: a short decimal, p/q, or a hexadecimal float."""
    if isinstance(value, float):  # numpy's too
        if value == 0.0:
            return "0"
        mantissa, exponent = float(value).hex().split("p")
        return f"{mantissa.rstrip('0').rstrip('.') if '.' in mantissa else mantissa}p{exponent}"
    denominator, twos, fives = value.denominator, 0, 0
    while denominator % 2 == 0:
        denominator, twos = denominator // 2, twos + 1
    while denominator % 5 == 0:
        denominator, fives = denominator // 5, fives + 1
    places = max(twos, fives)
    digits = str(abs(value.numerator) * 10**places // value.denominator)
    if denominator != 1 or max(places, len(digits)) > LONGEST_DECIMAL:
        return f"{value.numerator}/{value.denominator}" if value.denominator != 1 else str(value.numerator)
    digits = digits.rjust(places + 1, "0")
    decimal = f"{digits[: len(digits) - places]}.{digits[len(digits) - places :]}" if places else digits
    return ("-" if value < 0 else "") + decimal


def task(problem: Problem) -> dict[str, Any]:
    """The task in exact numbers."""
    maneuver, plants, varying = problem.maneuver, [], problem.transition and problem.transition.plant
    length = maneuver.tail_length
    for plant in problem.plants if varying is None else ():
        polynomials = {"numerator": plant.numerators[plant.output], "denominator": plant.denominator}
        written = {name: [text(fraction(c)) for c in reversed(p.coeffs())] for name, p in polynomials.items()}
        outputs = {course.name: [text(fraction(c)) for c in reversed(plant.numerators[course.name].coeffs())] for course in problem.courses}
        plants.append({**written, "outputs": outputs, "zeros": _zeros(problem)})
    return {
        "plants": plants,
        "schedule": varying and _schedule(varying, [course.name for course in problem.courses]),
        "box": maneuver.box and _box(maneuver.box, list(maneuver.limits.deflection)),
        "displacement": text(maneuver.displacement),
        "initial_state": None if maneuver.initial is None else [text(x) for x in maneuver.initial],
        "rest": "output" if maneuver.tail else "state",
        "limits": {
            "input": [text(maneuver.limits.lower), text(maneuver.limits.upper)],
            "rate": maneuver.limits.rate and [text(side) for side in maneuver.limits.rate],
            "deflection": {course.name: text(maneuver.limits.deflection[course.name]) for course in problem.courses},
            "fuel": None if maneuver.limits.fuel is None else text(maneuver.limits.fuel),
            "pulse_width": None if maneuver.limits.pulse_width is None else text(maneuver.limits.pulse_width),
            "pulses": maneuver.limits.pulses,
            "held": HELD[maneuver.limits.held],
            "sample_time": None if maneuver.sample_time is None else text(maneuver.sample_time),
            "tail_length": length and {"time": text(length[0]), "within": text(length[1])},
            "zero_sensitivity": {
                name: {"shift": text(shift), "residual": text(residual)} for name, (shift, residual) in maneuver.zero_sensitivity.items()
            },
        },
        "initial_input": text(maneuver.rest - (varying.rest(maneuver.displacement)[1] if varying else 0)),
    }


def _schedule(plant: VaryingPlant, limited: Sequence[str]) -> dict[str, Any]:
    rows = {name: [[text(x) for x in row] for row in which] for name, which in (("B", plant.B), ("C", plant.C))}
    A = [[[text(x) for x in row] for row in matrix] for matrix in plant.A]
    outputs = {name: [[text(x) for x in row] for row in plant.rows[name]] for name in limited}
    return {
        "instants": [text(t) for t in plant.instants],
        "A": A,
        **rows,
        "D": [text(d) for d in plant.D],
        "outputs": outputs,
        "members": [],
    }


def boxed(task: dict[str, Any], axes: Sequence[Axis], members: Sequence[tuple[Place, VaryingPlant]], tolerance: Fraction) -> dict[str, Any]:
    """The task of a plant that varies, with a box of such plants."""
    written = [
        {"place": [text(x) for x in place], **{key: _schedule(plant, [])[key] for key in ("A", "B", "C", "D")}} for place, plant in members
    ]
    ranges = [{"name": axis.name, "nominal": text(axis.nominal), "low": text(axis.low), "high": text(axis.high)} for axis in axes]
    nothing: dict[str, Any] = {"numerator": [], "denominator": [], "outputs": {}, "plants": [], "final_tolerance": None}
    box = {"parameters": ranges, **nothing, "tolerance": text(tolerance)}
    return {**task, "box": box, "schedule": {**task["schedule"], "members": written}}


def _box(box: Box, names: Sequence[str]) -> dict[str, Any]:
    def written(which: Sequence[Polynomial]) -> list[Any]:
        return [[[text(coefficient), list(powers)] for coefficient, powers in terms] for terms in which]

    def listed(place: Place) -> dict[str, Any]:
        upper, lower = ([text(c) for c in which] for which in box.family.written(place))
        plant = box.family.member(place)
        outputs = {name: [text(fraction(c)) for c in reversed(plant.numerators[name].coeffs())] or ["0"] for name in names}
        return {"place": [text(x) for x in place], "numerator": upper, "denominator": lower, "outputs": outputs}

    family, parameters = box.family, []
    for axis in box.axes:
        move = Move.of(axis.name) if isinstance(family, Moved) else None
        nominal = None if move is not None and move.what == "damping" else text(axis.nominal)
        parameters.append({"name": axis.name, "nominal": nominal, "low": text(axis.low), "high": text(axis.high)})
    # Of moved roots the names of the parameters say which plants these are.
    coefficients = family if isinstance(family, Family) and not isinstance(family, Moved) else None
    return {
        "parameters": parameters,
        "numerator": written(coefficients.numerator) if coefficients else [],
        "denominator": written(coefficients.denominator) if coefficients else [],
        "outputs": {name: written(coefficients.above(name)) for name in names} if coefficients else {},
        "plants": [listed(place) for place in family.places] if isinstance(family, Listed) else [],
        "tolerance": text(box.tolerance),
        "final_tolerance": box.final_tolerance if box.final_tolerance is None else text(box.final_tolerance),
    }


def _zeros(problem: Problem) -> dict[str, int]:
    robustness = problem.maneuver.robustness
    if isinstance(robustness, int):
        return {f"mode[{i}]": robustness for i in range(1, len(problem.plants[0].flexible) + 1)} if robustness else {}
    return {name: count for name, count in robustness.items() if count}


def costate_witness(
    problem: Problem,
    costate: Numbers,
    multipliers: Sequence[tuple[Number, Number, Number]] = (),
    prices: Prices = NONE,
) -> dict[str, Any]:
    """The lower side's witness: `p(s) = Re Σ c_k s^k/k! e^{ps}`, complex coefficients at every pole; (instant, μ⁺, μ⁻) of the tail; μ of
    the fuel; the multipliers of courses."""
    plants, at = [], 0
    if problem.transition is not None:
        if prices.pressed:  # which drive the costate from its begin on
            costate = driven(np.array([float(x) for x in costate]), prices.pressed, np.zeros(1))[0]
        # its components are those of one chain
        plants = [[{"near": ["0", "0"], "coefficients": [[text(x), "0"] for x in costate]}]]
    for target in problem.sets if problem.transition is None else ():
        chains = []
        for pole in target.basis.poles:
            coefficients = []
            for _ in range(pole.multiplicity):
                width = 2 if pole.is_flexible else 1
                part = costate[at : at + width]
                coefficients.append([text(part[0]), text(-part[1]) if width == 2 else "0"])
                at += width
            chains.append({"near": [text(pole.value.real), text(pole.value.imag)], "coefficients": coefficients})
        plants.append(chains)
    written = [{"time": text(time), "upper": text(above), "lower": text(below)} for time, above, below in multipliers]
    pressed = [
        (p.course.place, {"output": p.course.name, "begin": text(p.begin), "end": text(p.end), "weight": text(p.weight)})
        for p in prices.pressed
    ]
    presses = [one for place, one in pressed if place is None]
    rates = [{"edges": [text(x) for x in ramp.edges], "levels": [text(x) for x in ramp.levels]} for ramp in prices.ramps]
    others = {"fuel": text(prices.fuel), "deflection": presses, "ramps": rates, "steps": [text(x) for x in prices.steps]}
    others |= {"changes": [], "pulses": []}
    after = [{"output": name, "time": text(at), "upper": text(up), "lower": text(down)} for name, at, up, down in prices.after]
    others["after"] = after
    residuals = problem.residuals
    if residuals is None:
        return {"costate": plants, "tail": written, "samples": [], **others}
    looks = np.array([float(time) for time, _, _ in multipliers])
    found: dict[Place, dict[str, Any]] = {}

    def at_place(place: Place) -> dict[str, Any]:
        return found.setdefault(place, {"place": [text(x) for x in place], "residual": [], "deflection": [], "after": []})

    for k, (sample, since) in enumerate(zip(residuals.samples, residuals.split(looks), strict=True)):
        own = [pair for pair, owner in zip(written, residuals.owner(looks), strict=True) if owner == k]
        contacts = [{**pair, "time": text(float(time))} for pair, time in zip(own, since, strict=True)]
        if contacts and sample.name is None:
            at_place(sample.place)["residual"] = contacts
        elif contacts:
            at_place(sample.place)["after"] += [{"output": sample.name, **contact} for contact in contacts]
    for place, one in pressed:
        if place is not None:
            at_place(place)["deflection"].append(one)
    return {"costate": plants or [[]], "tail": [], "samples": list(found.values()), **others}


def changes_witness(problem: Problem, nodes: Sequence[tuple[Number, Numbers, Number]]) -> dict[str, Any]:
    """The lower side's witness of inputs of a form: (time to go of the change of sign [s], costate, price of the fuel) of every node."""
    nothing = costate_witness(problem, [0.0] * problem.size)
    written = [(at, costate_witness(problem, costate, prices=Prices(price))) for at, costate, price in nodes]
    return {**nothing, "changes": [{"at": text(at), "costate": one["costate"], "fuel": one["fuel"]} for at, one in written]}


def place_witness(problem: Problem, place: Place) -> dict[str, Any]:
    """The witness that no command suits a box: the plant at this place."""
    nothing = costate_witness(replace(problem, sets=(), residuals=None), [])
    return {**nothing, "costate": [[]], "samples": [{"place": [text(x) for x in place], "residual": [], "deflection": [], "after": []}]}


def tail_chains(problem: Problem, coefficients: Numbers) -> list[dict[str, Any]]:
    """The tail's coefficients of `Re(c r^l/l! e^{zr})` at every stable zero."""
    chains, at = [], 0
    for zero in problem.tail.zeros:
        width, pairs = (2 if zero.is_flexible else 1), []
        for _ in range(zero.multiplicity):
            part = coefficients[at : at + width]
            at += width
            pairs.append([text(part[0]), text(part[1]) if width == 2 else "0"])
        chains.append({"near": [text(zero.value.real), text(zero.value.imag)], "coefficients": pairs})
    return chains


def tail_unknowns(problem: Problem) -> list[list[Any]]:
    """The names of the tail's real coefficients, in their order."""
    names: list[list[Any]] = []
    for i, zero in enumerate(problem.tail.zeros):
        for power in range(zero.multiplicity):
            names += [["re", i, power], ["im", i, power]] if zero.is_flexible else [["re", i, power]]
    return names


def command_witness(
    maneuver_time: Number,
    starts: Numbers,
    levels: Numbers,
    tail: list[dict[str, Any]],
    free: Sequence[list[Any]],
    radius: Number,
    *,
    mirrored: bool = False,
) -> dict[str, Any]:
    """The upper side's witness: absolute levels on arcs, and which numbers are unknowns within `radius` of those written; whether the
    second half is the first one's image (`relaxations.checking.mirrored`)."""
    segments = [{"start": text(s), "level": text(level)} for s, level in zip(starts, levels, strict=True)]
    written = {"maneuver_time": text(maneuver_time), "segments": segments, "tail": tail, "free": list(free), "radius": text(radius)}
    return {**written, "mirrored": mirrored}


def certificate(
    task: dict[str, Any],
    claim: dict[str, Any],
    lower: dict[str, Any] | None,
    upper: dict[str, Any] | None,
) -> bytes:
    """Canonical bytes (RFC 8785) with their digest."""
    return _digested({"format": FORMAT, "task": task, "claim": claim, "lower": lower, "upper": upper})


def cost_certificate(
    task: dict[str, Any],
    price: Number,
    claim: dict[str, Any],
    pieces: Sequence[tuple[Number, Number, dict[str, Any]]] | None,
    upper: dict[str, Any] | None,
) -> bytes:
    """The same of the cost T + price · fuel; pieces: begin and end of maneuver times [s], and the witness of a costate for these."""
    lower = pieces and [{"begin": text(begin), "end": text(end), "costate": one["costate"]} for begin, end, one in pieces]
    return _digested({"format": COST_FORMAT, "task": task, "price": text(price), "claim": claim, "lower": lower, "upper": upper})


def _digested(record: dict[str, Any]) -> bytes:
    content = rfc8785.dumps(record)
    first = len(rfc8785.dumps({"claim": record["claim"]})) - 1  # "digest" comes next to it in canonical order
    digest = rfc8785.dumps({"digest": hashlib.sha256(content).hexdigest()})
    return content[:first] + b"," + digest[1:-1] + content[first:]
