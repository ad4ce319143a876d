"""An FMU on the bench: what its output does when its input is moved about an operating point.

Every response is the odd part of two runs with opposite inputs, (y(+a) - y(-a))/2: even non-linearities and any drift that does not
depend on the input cancel. The amplitude balances what is left of the non-linearity against the FMU's own noise, as the steps of
differences do (`fmus.differences`).
"""

from __future__ import annotations

import math
import time
from dataclasses import replace
from itertools import pairwise

import numpy as np

from fmus.archives import Fmu
from fmus.differences import HOPELESS, balance
from fmus.errors import LinearizationError
from fmus.identification import Reals, Record
from fmus.stepping import MERGE, Experiment, RunStatus, grid
from fmus.workers import Worker
from relaxations.commands import Command, Segment, Tail
from relaxations.plants import LinearPlant
from relaxations.response import response

RATIO = 10.0  # of neighbouring amplitudes
AMPLITUDES = tuple(RATIO**k for k in range(-5, 3))  # of the input's natural size, ascending
ENOUGH = 1e-9  # error of a response that need not be smaller
SIMPLER = 3.0  # by how much what is preferred may be worse than the best
PATTERN = np.array([(1.0, 1.0), (2.0, -1.0), (1.0, 1.0)])  # duration and level: moves a rigid body and leaves it at rest
SIGNS = (1.0, -0.7, 0.9, -1.0, 0.8, -0.9)  # of a pattern in each of as many durations
PERIODS, SAMPLED = 20.0, 20.0  # of the slowest mode that are observed, and samples in one of the fastest
MOST_POINTS = 20_000


class Bench:
    """The FMU as a plant in deviations from its operating point."""

    def __init__(self, worker: Worker, fmu: Fmu, point: Experiment, timeout: float) -> None:
        self.fmu, self.point = fmu, point
        self.size = max(abs(point.initial_input), fmu.description.find(point.input).nominal)
        has = fmu.description.capabilities
        self.fixed = (has.fixed_internal_step or point.step) if has.one_step else None
        self._worker, self._timeout = worker, timeout
        self.trouble = ""
        self._began = time.monotonic()
        self.only: float | None = None
        """The one amplitude that the FMU takes, if there is only one: thrusters, relays and valves are on or off."""

    @property
    def spent(self) -> float:
        """Wall-clock time since its beginning [s]."""
        return time.monotonic() - self._began

    def sampling(self, step: float) -> float:
        """The sampling time nearest to `step` that the FMU can take [s]."""
        return step if self.fixed is None else max(round(step / self.fixed), 1) * self.fixed

    def output(self, starts: Reals, levels: Reals, step: float, stop: float) -> tuple[Reals, Reals] | None:
        """Times and absolute output for input deviations; None (and `trouble`) if the run is of no use."""
        wanted = grid(0.0, stop, step, starts.tolist())
        if self.point.settle and self.point.step > step and self.fixed is None:
            # It settles in the steps in which it has been seen to; shorter ones are then instants at which the input is set again.
            levels = np.append(0.0, levels)[np.searchsorted(starts, wanted[:-1], side="right")]
            starts, step = wanted[:-1], self.point.step
        segments = tuple(Segment(float(t), self.point.initial_input + float(u)) for t, u in zip(starts, levels, strict=True))
        last = float(starts[-1]) - float(starts[0]) if len(starts) else 0.0
        command = Command(last, segments, Tail(segments[-1].level if segments else self.point.initial_input))
        outcome = self._worker.run(replace(self.point, command=command, stop=stop, step=step), self._timeout)
        if outcome.trajectory is None or not outcome.status.complete:
            self.trouble = f"{outcome.status.value}: {outcome.detail}"
            if outcome.status in (RunStatus.HUNG, RunStatus.FAILED):
                raise LinearizationError(f"{self.fmu.path.name} cannot be identified: {self.trouble}", outcome.status)
            return None
        times, values = outcome.trajectory.times, outcome.trajectory.values[:, 0]
        kept = np.searchsorted(times, wanted - MERGE * step) if len(times) > len(wanted) else slice(None)
        return times[kept], values[kept]

    def respond(self, starts: Reals, levels: Reals, step: float, stop: float) -> Record | None:
        """The odd part of the response."""
        above, below = self.output(starts, levels, step, stop), self.output(starts, -levels, step, stop)
        if above is None or below is None:
            return None
        return Record(above[0], starts, levels, (above[1] - below[1]) / 2.0)

    def pulse(self, step: float, samples: int, area: float) -> Record | None:
        """The response to a pulse of one sample, of this area where the FMU takes it."""
        level = area / step if self.only is None else self.only
        return self.respond(np.array([0.0, step]), np.array([level, 0.0]), step, samples * step)

    def amplitude(self, step: float, samples: int, given: float | None) -> tuple[float, float, Reals]:
        """The amplitude of a pulse of one sample whose response is least wrong, how much that may be of its largest value, and the response
        per unit of it.
        """
        ladder = AMPLITUDES if given is None else (given / self.size / RATIO, given / self.size)
        rungs: list[tuple[float, Reals]] = []
        jumps: list[float] = []
        self.only, refused = None, [False, False]  # smaller ones than those that it takes, larger ones
        for factor in ladder:
            found = self.pulse(step, samples, factor * self.size * step)
            refused[bool(rungs)] |= found is None
            if found is None and rungs:
                break
            if found is None or not found.size:
                continue  # below what the output resolves, perhaps
            rungs.append((factor * self.size, found.output / (factor * self.size)))
            jumps = [float(np.abs(b[1] - a[1]).max()) for a, b in pairwise(rungs)]
            if len(jumps) > 3 and jumps[-1] > HOPELESS * min(max(pair) for pair in pairwise(jumps)) > 0.0:
                break  # larger ones are another plant
        largest = max((float(np.abs(response).max()) for _, response in rungs), default=0.0)
        if largest == 0.0:
            raise LinearizationError(f"{self.fmu.path.name} cannot be identified: {self.trouble or self._silent(samples * step)}")
        if len(rungs) == 1 and all(refused):
            self.only = rungs[0][0]
        if given is not None or not jumps:
            return rungs[-1][0], jumps[-1] / largest if jumps else math.inf, rungs[-1][1]
        floors = [float(np.finfo(float).eps * np.abs(response).max()) for _, response in rungs]
        best, error = balance(jumps, floors, RATIO)
        # Where that hardly matters the input's natural size is better: there the FMU was meant to work.
        natural = min(range(len(rungs)), key=lambda k: abs(math.log(rungs[k][0] / self.size)))
        if (change := jumps[min(natural, len(jumps) - 1)]) <= ENOUGH * largest:
            best, error = natural, max(error, change)
        return rungs[best][0], error / float(np.abs(rungs[best][1]).max()), rungs[best][1]

    def _silent(self, length: float) -> str:
        return (
            f"{self.point.outputs[0]!r} does not react to {self.point.input!r} within {length:.3g} s; "
            "if it is slow, give a larger step for the identification"
        )

    def check(self, pulse: Record) -> Record | None:
        """The response to another input of the same strength: moves of many durations, at instants that are none of the samples'."""
        length = float(pulse.times[-1])
        starts, levels, fine = self.moves(float(pulse.times[1]), length)
        # As strong as the pulse: its own samples, superposed, foretell how strongly the output will move.
        held = levels[np.maximum(np.searchsorted(starts, pulse.times, side="right") - 1, 0)] * (pulse.times >= starts[0])
        expected = float(np.abs(np.convolve(held, pulse.output / pulse.levels[0])[: len(held)]).max())
        levels = levels * (pulse.size / expected if expected > 0.0 else pulse.levels[0])
        if self.only is not None:
            levels = self.only * np.sign(levels)
        return self.respond(starts, levels, fine, length)

    def moves(self, step: float, length: float) -> tuple[Reals, Reals, float]:
        """Starts [s] and levels (at most 1) of moves of many durations within `length` [s], and the step [s] to look at them with."""
        durations = np.geomspace(2.7 * step, length / 12.0, len(SIGNS))
        pattern = np.concatenate([PATTERN * (d, sign) for d, sign in zip(durations, SIGNS, strict=True)])
        starts = np.concatenate([[0.0], np.cumsum(pattern[:, 0])]) + 0.63 * step
        levels, fine = np.append(pattern[:, 1], 0.0), 0.37 * step
        if self.fixed is None:
            return starts, levels, fine
        fine = self.fixed * max(round(fine / self.fixed), 1)
        # Where several moves fall on one point of the FMU's grid, the last one is what is left of them.
        points = np.round(starts / fine).astype(int)
        last = np.append(np.diff(points) > 0, True)
        return points[last] * fine, levels[last], fine

    def drift(self, step: float, length: float) -> tuple[float, float]:
        """How far the output moves by itself within `length` [s], in its units; and where it starts."""
        found = self.output(np.zeros(0), np.zeros(0), step, length)
        if found is None:
            raise LinearizationError(f"{self.fmu.path.name} cannot be identified: {self.trouble}")
        return float(np.abs(found[1] - found[1][0]).max()), float(found[1][0])

    def require_rest(self, drift: float, natural: float, length: float, allowed: float) -> float:
        """`drift` relative to what a natural step of the input does; raises `LinearizationError` if that is more than allowed."""
        ratio = drift / natural if natural else 0.0
        if ratio > allowed:
            where = "after settling" if self.point.settle else "where it starts"
            raise LinearizationError(
                f"{self.fmu.path.name} is not at rest {where}, with input {self.point.initial_input!r}: in {length:.3g} s its output moves "
                f"by {ratio:.2g} of what a natural step of the input does ({allowed:.1g} is allowed); let it settle"
            )
        return ratio

    def mismatch(self, plant: LinearPlant, amplitude: float, finer: int = 1) -> tuple[float, float, float] | None:
        """The largest distance between the FMU's output and the linear plant's, relative to the latter's largest deviation, for moves of
        this amplitude (input units), how long they were looked at, and the communication step [s], which is divided by `finer`; None if the
        run is of no use.
        """
        rates = [pole.natural_frequency for pole in plant.poles if not pole.is_rigid]
        fine = min([0.37 * 2.0 * math.pi / SAMPLED / rate for rate in rates] + [self.point.step]) / finer
        fine = self.sampling(fine)
        length = 1000.0 * finer * fine
        if rates and not plant.is_unstable:  # an unstable one leaves the neighbourhood that it is looked at in
            length = max(length, min(PERIODS * 2.0 * math.pi / min(rates), MOST_POINTS * finer * fine))
        starts, levels, _ = self.moves(finer * fine / 0.37, length)
        rest_input = self.point.initial_input
        found = self.output(starts, amplitude * levels, fine, fine * math.ceil(length / fine))
        if found is None:
            return None
        segments = tuple(Segment(float(t), rest_input + amplitude * float(u)) for t, u in zip(starts, levels, strict=True))
        command = Command(float(starts[-1] - starts[0]), segments, Tail(segments[-1].level))
        expected = response(plant, command, found[0], rest=rest_input, before=True)
        largest = float(np.abs(expected).max())
        return (float(np.abs(found[1] - found[1][0] - expected).max()) / largest, float(found[0][-1]), fine) if largest else None
