"""What `slewcert linearize` does: an FMU's linear plant about an operating point, its poles, zeros and modes, and how far to trust them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fmus.archives import Fmu
from fmus.bench import Bench
from fmus.descriptions import SETTABLE, Description
from fmus.errors import FmuError
from fmus.linearization import Linearization, Method, linearize
from fmus.settling import natural_step
from fmus.stepping import Experiment
from fmus.variables import Variable
from fmus.workers import Worker
from relaxations.commands import Command, Tail
from relaxations.modes import Mode, modes
from relaxations.plants import LinearPlant, Pole
from suite.errors import Mistake, StudyError
from suite.study_plant import open_plant, variable
from suite.study_units import is_with_unit, plain_values

CLOSE, FINER = 1e-4, 8  # distance above which a small move is looked at again, and the divisor of its communication step
UNMEASURED = "the distance from the FMU could not be measured"
SMALL = 0.01  # of the input's natural size: the amplitude at which a plant should be as linear as its linearisation is good


@dataclass(frozen=True, slots=True)
class Request:
    """What is asked: start values of parameters, states and of the input itself; the time to settle [s], infinite for until at rest."""

    fmu: str
    input: str
    output: str
    settings: Sequence[str] = ()
    method: Method = "auto"
    settle: float = 0.0
    step: float | None = None


@dataclass(frozen=True, slots=True)
class Linear:
    """The answer. `checks` are (amplitude in input units, error, duration [s], communication step [s]): how far the FMU's response to moves
    of the input, small ones and ones of natural size, is from the linear plant's, relative to its largest deviation; what could not be
    measured is missing, and `unchecked` says why.
    """

    request: Request
    fmu: Fmu
    found: Linearization
    plant: LinearPlant
    modes: tuple[Mode, ...]
    checks: tuple[tuple[float, float, float, float], ...]
    unchecked: str = ""

    @property
    def gain(self) -> float:
        """K of `K ∏(s - z) / ∏(s - p)`."""
        return float(self.plant.numerators[self.plant.output].coeffs()[-1])

    @property
    def notes(self) -> list[str]:
        """What a reader should know of the plant, of how it was found, and of what was not measured."""
        return [*self.plant.notes, *self.found.notes, *([self.unchecked] if self.unchecked else [])]

    def unit(self, name: str) -> str:
        """A variable's unit."""
        return self.fmu.description.find(name).unit

    def to_dict(self) -> dict[str, Any]:
        """The object of `linearize --json` (docs/schemas.md)."""
        found, how = self.found, self.found.identification
        return {
            "fmu": str(self.fmu.path),
            "sha256": self.fmu.sha256,
            "binary_sha256": self.fmu.binary_sha256(found.interface),
            "input": self.request.input,
            "output": self.request.output,
            "method": found.method,
            "poles": every_root(self.plant.poles),
            "zeros": every_root(self.plant.zeros),
            "gain": self.gain,
            "A": found.A.tolist(),
            "B": found.B.tolist(),
            "C": found.C.tolist(),
            "D": found.D,
            "states": list(found.states),
            "operating_point": {
                "input": found.u,
                "output": found.y,
                "states": {} if how else dict(zip(found.states, found.x.tolist(), strict=True)),
                "settled": found.settled,
                "imbalance": float(found.imbalances.max(initial=0.0)) if how is None else how.drift,
            },
            "error": found.error if how is None else how.check_error,
            "order": self.plant.order,
            "modes": [_mode(mode, found) for mode in self.modes],
            "checks": [{"amplitude": a, "error": e, "duration": t, "step": h} for a, e, t, h in self.checks],
            "identification": None
            if how is None
            else {
                "step": how.step,
                "samples": how.samples,
                "amplitude": how.amplitude,
                "singular_values": list(how.singular_values),
                "orders": [{"order": order, "error": error if math.isfinite(error) else None} for order, error in how.orders],
                "fit_error": how.fit_error,
                "check_error": how.check_error,
            },
            "notes": self.notes,
        }


def every_root(roots: Sequence[Pole]) -> list[list[float]]:
    """[re, im] of every root, conjugates and repetitions written out, by magnitude and then by imaginary part."""
    values = [value for root in roots for value in {root.value, root.value.conjugate()} for _ in range(root.multiplicity)]
    return [[value.real, value.imag] for value in sorted(values, key=lambda v: (abs(v), v.imag))]


def _mode(mode: Mode, found: Linearization) -> dict[str, Any]:
    pole = mode.pole
    return {
        "kind": mode.kind,
        "pole": [pole.value.real, pole.value.imag],
        "multiplicity": pole.multiplicity,
        "uncertainty": mode.uncertainty,
        "natural_frequency": pole.natural_frequency,
        "frequency_hz": pole.natural_frequency / (2.0 * math.pi),
        "damping_ratio": pole.damping_ratio,
        "time_constant": mode.time_constant,
        "residues": [[r.real, r.imag] for r in mode.residues],
        "step_amplitude": mode.step_amplitude,
        "participation": dict(zip(found.states, mode.participation, strict=False)),
    }


def linear(request: Request) -> Linear:
    """Linearise; raises `StudyError` with everything that is wrong with the request, `LinearizationError`, `PlantError`."""
    mistakes: list[Mistake] = []
    fmu = open_plant(request.fmu, Path(), mistakes, "FMU")
    if fmu is None:
        raise StudyError("linearize", mistakes)
    has = fmu.description
    entry = variable("--input", request.input, has.drivable_input, has.names("input"), mistakes)
    variable("--output", request.output, lambda name: _output(has, name), has.names("output"), mistakes)
    parameters, states, u0 = _settings(request, has, mistakes)
    if mistakes or entry is None:
        raise StudyError("linearize", mistakes)
    start = entry.start if isinstance(entry.start, float) else 0.0
    u0 = start if u0 is None else u0
    with Worker() as worker:
        found = linearize(
            *(fmu, request.input, request.output, parameters),
            initial_state=states,
            initial_input=u0,
            settle=request.settle,
            step=request.step,
            method=request.method,
            worker=worker,
        )
        found.require_rest(fmu.path.name)
        exact = found.plant(request.output)
        step = request.step or natural_step(fmu)
        point = Experiment(
            *(fmu.path, request.input, (request.output,), parameters, u0, states, Command(0.0, (), Tail(u0)), step, step),
            settle=found.settled,
        )
        checks, unchecked = _checks(Bench(worker, fmu, point, 60.0), exact.plant)
    table = modes(exact.plant, exact.poles, exact.spread, None if found.identification else found.A)
    return Linear(request, fmu, found, exact.plant, table, checks, unchecked)


def _checks(bench: Bench, plant: LinearPlant) -> tuple[tuple[tuple[float, float, float, float], ...], str]:
    """The mismatch at a small amplitude and at the natural one; where the small one is not, with finer steps too, since many an FMU
    integrates no better than its communication step. What cannot be run is left out, and a sentence says so.
    """
    if bench.fmu.description.capabilities.co_simulation is None:
        return (), f"{UNMEASURED}: it offers no co-simulation, in which its moves are run"
    made: list[tuple[float, float, float, float]] = []
    missing: dict[str, None] = {}

    def look(amplitude: float, finer: int = 1) -> None:
        bench.trouble = ""
        try:
            seen = bench.mismatch(plant, amplitude, finer)
        except FmuError as problem:
            seen, bench.trouble = None, str(problem)
        if seen is not None and all(map(math.isfinite, seen)):
            made.append((amplitude, *seen))
        else:
            missing[
                f"for moves of ±{amplitude:.4g}: {bench.trouble or 'the response of the linear plant to them is zero, or no number'}"
            ] = None

    look(SMALL * bench.size)
    if made and made[0][1] > CLOSE and bench.fixed is None:
        look(SMALL * bench.size, FINER)
    look(bench.size)
    return tuple(made), f"{UNMEASURED} {'; '.join(missing)}" if missing else ""


def _output(has: Description, name: str) -> Variable:
    """The variable to look at. States and other local ones will do; what is set from outside is no output."""
    found = has.readable(name)
    return has.find(name, "output") if found.causality in SETTABLE else found


def _settings(request: Request, has: Description, mistakes: list[Mistake]) -> tuple[dict[str, float], dict[str, float], float | None]:
    """`name=value` sorted into parameters, states and the input at rest."""
    parameters: dict[str, float] = {}
    states: dict[str, float] = {}
    u0: float | None = None
    for text in request.settings:
        name, _, number = text.partition("=")
        name = name.strip()
        if is_with_unit(number) and variable("--set", name, has.find, (), mistakes) is None:
            continue
        try:
            plain, wrong = plain_values({name: number}, lambda: has) if is_with_unit(number) else ({name: number}, [])
            value = math.nan if wrong else float(plain[name])
        except ValueError:
            value, wrong = math.nan, []
        if wrong:
            mistakes.append(Mistake("--set", text, wrong[0].message))
        elif not math.isfinite(value):
            mistakes.append(Mistake("--set", text, 'must be NAME=NUMBER, such as stiffness=2.5, or with a unit: "stiffness=2.5 N/mm"'))
        elif name == request.input:
            u0 = value
        elif (found := variable("--set", name, has.find, (), mistakes)) is None:
            continue
        elif found.causality in SETTABLE:  # also an input that is held
            parameters[name] = value if variable("--set", name, has.settable_parameter, (), mistakes) else 0.0
        else:
            states[name] = value if variable("--set", name, has.settable_state, (), mistakes) else 0.0
    return parameters, states, u0
