"""`slewcert prefilter`: a pole-zero cancelling filter for the plant of a study, beside the proven bracket of its task."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from relaxations.bounds import Bound
from relaxations.cancelling.answers import output, residual, tail_length, zero_sensitivities
from relaxations.cancelling.conditions import Conditions
from relaxations.cancelling.forms import DEFAULT, Form
from relaxations.cancelling.monotone import least_monotone
from relaxations.cancelling.prefilters import Prefilter
from relaxations.cancelling.requests import Request, cancelling
from relaxations.errors import ImpossibleShaperError, RelaxationsError
from relaxations.plants import LinearPlant
from relaxations.proofs import minimum_time
from reports.files import json_bytes, write_atomically
from suite.cancelled import request_of
from suite.design import pose
from suite.errors import SuiteError
from suite.loading import load_study
from suite.plants import nominal_plant
from suite.study import CancellingRequest, CommandRequest, Study

SETTLED = 0.01  # of the largest input: when a tail counts as over
SHIFTED = 0.01  # of a zero's magnitude
CURVE = 1201  # instants of the picture


@dataclass(frozen=True, slots=True)
class Asked:
    """The command line's words (None: as the study says, or not at all)."""

    delays: int | None = None
    form: str | None = None
    robustness: int | None = None
    gains: tuple[float, float] | None = None
    monotone: bool = False
    instants: tuple[float, ...] | None = None
    sample_time: float | None = None
    zeros: tuple[int, ...] | None = None
    unbounded: bool = False


@dataclass(frozen=True, slots=True)
class Designed:
    """The filter of a study's plant, what was asked, and the bracket of any command within the study's limits.

    `residual`: the largest |G_f| at a pole that it cancels, over its gains; `tail` [s]: how long it is; `zeros`: what they leave elsewhere;
    `least` [s]: for which it is proven that no filter with a monotone answer is as short, where one was asked for.
    """

    study: Study
    plant: LinearPlant
    request: Request
    prefilter: Prefilter
    bound: Bound
    residual: float
    tail: float
    zeros: dict[str, float]
    least: float | None = None

    @property
    def displacement(self) -> float:
        """Of the study's move (output units)."""
        return float(self.study.maneuver.displacement)

    def to_dict(self) -> dict[str, Any]:
        """The object of `prefilter --json` (docs/schemas.md)."""
        return {
            "prefilter": self.prefilter.to_dict(),
            "form": self.request.form,
            "duration": self.prefilter.duration,
            "gain": self.prefilter.gain,
            "residual": self.residual,
            "bounded": self.request.bounds.levels is not None,
            "minimum_time": {"status": self.bound.status.name.lower(), "lower": self.bound.lower, "upper": self.bound.upper},
            "least_monotone": self.least,
            "tail_length": {"within": SETTLED, "time": self.tail},
            "zero_sensitivity": self.zeros,
        }

    def lines(self) -> Iterator[str]:
        """What is said of it on a terminal, beside its table."""
        upper = "–" if self.bound.upper is None else repr(self.bound.upper)
        yield f"duration: {self.prefilter.duration!r} s: the shortest of its form that was found"
        rest = "the output" if self.study.command.tail else "every state"
        more = ", as robust," if self.request.robustness else ""
        sides = f"[{self.bound.lower!r}, {upper}] s: {self.bound.status.name.lower()}"
        task = f"any command{more} within the limits that brings {rest} to rest: {sides}"
        yield task if self.request.bounds.levels is not None else f"{task} (this filter is not held within them)"
        if self.least is not None:
            tails = {None: "with tails at any zeros", (): "without tails"}.get(self.request.zeros, "with tails at these zeros")
            proved = f"no filter that never turns back, {tails}{more} is as short as {self.least!r} s, with any number of delays: proved"
            yield f"{proved} (for poles and zeros as doubles)"
        yield f"left of the poles that it cancels: {self.residual:.2g} of its gains (measured)"
        if self.prefilter.terms:
            yield f"the tail is within {SETTLED:.0%} of the largest input {self.tail:.4g} s after the last delay (measured)"
        for name, left in self.zeros.items():
            yield f"{name} elsewhere by {SHIFTED:.0%} of its magnitude: {100.0 * SHIFTED * left:.3g} % of the move, to first order"


def designed(file: Path, asked: Asked) -> Designed:
    """The filter for a study's plant; raises `SuiteError`, and `ImpossibleShaperError` where none was found."""
    study, plant, request = requested(file, asked)
    try:
        prefilter = cancelling(plant, request)
    except ImpossibleShaperError:
        raise
    except RelaxationsError as problem:
        raise SuiteError(f"{file}: {problem}") from None
    conditions = Conditions.of(plant, request.robustness, request.zeros)
    least = least_monotone(conditions, prefilter.duration) if request.bounds.monotone else None
    bound = minimum_time(pose(study, plant))
    lasting, zeros = tail_length(prefilter, SETTLED), zero_sensitivities(plant, prefilter)
    return Designed(study, plant, request, prefilter, bound, residual(conditions, prefilter), lasting, zeros, least)


def requested(file: Path, asked: Asked) -> tuple[Study, LinearPlant, Request]:
    """The study, its nominal plant, and what is asked of a filter for it; raises `SuiteError`."""
    study = asking(load_study(file), asked)
    plant = nominal_plant(study)
    assert study.command.cancelling is not None
    request = request_of(study, study.command.cancelling, plant)
    if asked.unbounded:
        request = replace(request, bounds=replace(request.bounds, levels=None, length=None))
    return study, plant, request


def asking(study: Study, asked: Asked) -> Study:
    """The study with what the command line asks of a filter instead of its own command."""
    own, command = study.command.cancelling, study.command
    given = own or CancellingRequest(0, DEFAULT)
    instants = asked.instants or (None if asked.sample_time is not None else given.instants)
    delays = asked.delays or (len(asked.instants) if asked.instants else given.delays)
    if not delays:
        raise SuiteError(
            f"--delays is missing: how many delays the filter has; {study.file} does not say it (its command is {command.kind})"
        )
    if command.robustness == "box" and asked.robustness is None:
        why = f'{study.file} asks for a "box", which filters are not designed for'
        raise SuiteError(f"--robustness is missing: further zeros, 0, 1, 2 …; {why}")
    request = CancellingRequest(
        delays,
        asked.form or given.form,
        asked.gains or given.gains,
        asked.monotone or given.monotone,
        given.zeros if asked.zeros is None else asked.zeros,
        instants,
        asked.sample_time or (None if asked.instants is not None else given.sample_time),
    )
    try:
        Form.named(request.form, delays)
    except RelaxationsError as problem:
        raise SuiteError(f"--form {request.form}: {problem}") from None
    robustness = command.robustness if asked.robustness is None else asked.robustness
    wanted = CommandRequest("pole-zero", robustness, request.zeros != (), cancelling=request)
    return replace(study, command=wanted)


def save(done: Designed, path: Path) -> None:
    """The filter as a file (`slewcert-prefilter/1`), which `slewcert fmus export` makes an FMU of."""
    write_atomically(path, json_bytes(done.prefilter.to_dict()))


def draw(done: Designed, path: Path) -> None:
    """The input with its tail, and the output, as an SVG file."""
    from reports import charts
    from reports.prefilter_charts import filtered

    prefilter, study = done.prefilter, done.study
    last = prefilter.duration + min(max(done.tail, prefilter.duration), 4.0 * prefilter.duration)
    times = np.unique(np.concatenate([np.linspace(-0.05 * last, last, CURVE), *([d, np.nextafter(d, -np.inf)] for d in prefilter.delays)]))
    rest = float(study.plant.initial_input)
    svg = filtered(
        f"{study.title}: filter of form {done.request.form}",
        times,
        rest + done.displacement * prefilter.reference(times),
        done.displacement * output(done.plant, prefilter, times),
        end=prefilter.duration,
        final=rest + done.displacement * prefilter.gain,
        target=done.displacement,
        limits=(float(study.limits.lower), float(study.limits.upper)),
        input_label=f"{study.plant.input} [{study.plant.input_unit or '–'}]",
        output_label=f"{study.plant.output} [{study.plant.output_unit or '–'}]",
    )
    write_atomically(path, charts.standalone(svg).encode())
