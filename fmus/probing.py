"""Identification of an FMU that shows nothing but its outputs: which input to apply, how long, how strongly, and what to believe.

The sampling time is walked by factors of four from the FMU's own step to where a model identified from a *pulse* predicts best what
*another* input does, at irregular instants between the samples, on all the scales that were looked at (`fmus.bench`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from fmus.archives import Fmu
from fmus.bench import ENOUGH, SIMPLER, Bench
from fmus.errors import LinearizationError
from fmus.identification import Model, Reals, Record, identify, orders, polished, realize
from fmus.linearization import REST, Identification, Linearization
from fmus.settling import rest
from fmus.stepping import Experiment, Probe
from fmus.workers import Worker

LOOKS = 3  # sampling times of the first look, each a sixteenth of the one before
SAMPLES = 400  # of a response: 20 periods of the fastest mode at 20 samples each; its Hankel matrix takes 10 ms
WALK = 4  # ratio of neighbouring sampling times
FARTHEST = 5  # how many of them are walked at most, in either direction
LOOSE = 0.01  # error of a prediction, of its largest deviation, above which there is no model
PATIENT, ECHO = 16, 0.1  # records after a pulse in which nothing new may come, and what is new: so much of the largest response
GIVE_UP = 25.0  # s of wall-clock time after which nothing more is tried as long as nothing has come near
RESTLESS = 1e-3  # drift that the noise of an FMU may look like, at most


def identify_fmu(worker: Worker, fmu: Fmu, point: Experiment, probe: Probe | None, timeout: float) -> Linearization:
    """The linear plant about the experiment's initial point (after its `settle`); raises `LinearizationError` as `linearize` does."""
    asked = probe or Probe()
    if point.settle:
        point = replace(point, settle=rest(worker, fmu, point, timeout)[0])
    bench = Bench(worker, fmu, point, timeout)
    samples = asked.samples or SAMPLES
    step = bench.sampling(asked.step or point.step)
    drift, _ = bench.drift(step, samples * step)  # first: an FMU that cannot even be left alone fails here, at once
    start, (amplitude, unsure, response) = _first_look(bench, step, samples, asked)
    natural = float(np.abs(np.cumsum(response)).max()) * bench.size  # a step is pulses one after the other
    bench.require_rest(drift * start / step, natural, samples * start, RESTLESS)
    best = _walk(bench, start, samples, amplitude * start, asked)
    model = polished(best.model, best.pulse)
    if model.error(best.check) > SIMPLER * best.error:
        model = replace(best.model, spread=model.spread)
    pulse = best.pulse
    length = float(pulse.times[-1])
    drift, y = bench.drift(float(pulse.times[1]), length)
    natural = float(np.abs(model.predict(Record(pulse.times, np.zeros(1), np.array([bench.size]), pulse.output))).max())
    drift = bench.require_rest(drift, natural, length, max(REST, min(10.0 * best.error, RESTLESS)))
    late = _late(bench, best, model)
    if late and asked.order is None:
        raise LinearizationError(late)
    return _linearization(bench, best, replace(model, notes=(*model.notes, late)) if late else model, (unsure, drift, y))


def _first_look(bench: Bench, start: float, samples: int, asked: Probe) -> tuple[float, tuple[float, float, Reals]]:
    """Where to begin: a sampling time and an amplitude at which the response is anything like linear.

    A plant that is unstable, or far from linear, may need a look that is shorter than from `start`.
    """
    looks = []
    for closer in range(1 if bench.fixed is not None or asked.step is not None else LOOKS):
        step = start / WALK ** (2 * closer)
        looks.append((step, bench.amplitude(step, samples, asked.amplitude)))
        if looks[-1][1][1] <= LOOSE or bench.spent > GIVE_UP:
            break
    return min(looks, key=lambda look: look[1][1])


@dataclass(frozen=True, slots=True)
class _Candidate:
    """What one sampling time came to."""

    pulse: Record
    check: Record
    values: Reals
    tried: tuple[tuple[int, Model | None], ...]
    model: Model
    error: float


def _walk(bench: Bench, start: float, samples: int, area: float, asked: Probe) -> _Candidate:
    """The sampling time whose model predicts best, walking from `start`; given ones are not left."""
    seen: dict[int, _Candidate | None] = {}
    pool: list[Record] = []

    def look(rung: int) -> None:
        forbidden = (rung and asked.step is not None) or (rung < 0 and bench.fixed is not None)
        seen[rung] = None if forbidden else _candidate(bench, start * float(WALK) ** rung, samples, area, asked.order, pool)

    def score(rung: int) -> float:
        found = seen[rung]
        return math.inf if found is None else max(found.model.error(record) for record in pool)

    def chosen() -> int:
        """Of those that predict about as well the nearest to the start: the step that the FMU was made for, or that the user gave."""
        scores = {rung: score(rung) for rung in seen}
        good = [rung for rung, value in scores.items() if value <= max(SIMPLER * min(scores.values()), ENOUGH)]
        return min(good, key=lambda rung: (abs(rung), scores[rung]))

    look(0)
    for tried in range(2 * FARTHEST):
        best = chosen()
        # Finer first where nothing fits at all: short runs are cheap.
        lost = score(best) > LOOSE and asked.order is None
        beyond = [1, -1] if tried < 2 else [min(seen) - 1, max(seen) + 1] if lost else [best - 1, best + 1]
        new = [rung for rung in beyond if rung not in seen and abs(rung) <= FARTHEST]
        enough = tried > 1 and score(best) <= ENOUGH
        if enough or not new or (lost and bench.spent > GIVE_UP):
            break
        look(new[0])
    best = chosen()
    found = seen[best]
    if found is None or (score(best) > LOOSE and asked.order is None):
        lengths = [samples * start * float(WALK) ** rung for rung in seen]
        raise LinearizationError(_hopeless(bench, None if found is None else replace(found, error=score(best)), lengths, samples))
    return replace(found, error=score(best))


def _hopeless(bench: Bench, best: _Candidate | None, lengths: list[float], samples: int) -> str:
    words = f"{bench.fmu.path.name} could not be identified from pulses of {bench.point.input!r}"
    spans = " to ".join(f"{length:.3g}" for length in sorted({min(lengths), max(lengths)}))
    gave_up = f" (given up after {bench.spent:.0f} s: its runs are slow)" if bench.spent > GIVE_UP else ""
    if best is None:
        poles = "every model has poles on the negative real axis of the sampled plant: a delay, too coarse a sampling, or noise"
        return f"{words}, of which {samples} samples within {spans} s were taken: {bench.trouble or poles}{gave_up}"
    step = float(best.pulse.times[1])
    return (
        f"{words}: the best model, of order {best.model.weights.size} with samples every {step:.3g} s, misses the response to moves "
        f"within {spans} s by {best.error:.2g} of it (at most {LOOSE:g} is allowed). It is not linear there, has a "
        f"delay, which is no pole, or more time scales than {samples} samples hold: another step or more samples may show them{gave_up}"
    )


def _late(bench: Bench, best: _Candidate, model: Model) -> str:
    """What is to be said of an FMU that responds to a pulse more strongly than the model, after the record that the model comes from; "" if
    it does not. What it does later than `PATIENT` records, nobody knows.
    """
    step, length, pulse = float(best.pulse.times[1]), float(best.pulse.times[-1]), best.pulse
    if any(pole.value.real > 0.0 for pole in model.poles):
        return ""
    seen = bench.pulse(step, PATIENT * (len(pulse.times) - 1), float(pulse.levels[0]) * step)
    if seen is None:
        return ""
    with np.errstate(over="ignore", invalid="ignore"):
        foretold = np.abs(model.predict(seen))
    for begin in np.arange(1, PATIENT) * length:
        window = (seen.times > begin) & (seen.times <= begin + length)
        there, allowed = np.abs(seen.output[window]), ECHO * max(pulse.size, float(foretold[window].max(initial=0.0)))
        late = there > foretold[window].max(initial=0.0) + allowed
        if late.any():
            when = float(seen.times[window][late][0])
            step = 4.0 * when / (len(pulse.times) - 1)
            return (
                f"{bench.fmu.path.name} responds to a pulse of {bench.point.input!r} again after {when:.3g} s, by "
                f"{float(there.max()) / pulse.size:.2g} of its largest response within the {length:.3g} s that the model comes from: "
                f"a delay, which is no pole, or slow dynamics; a step of the identification of {step:.3g} s looks longer"
            )
    return ""


def _candidate(bench: Bench, step: float, samples: int, area: float, order: int | None, pool: list[Record]) -> _Candidate | None:
    """Pulse, check and the order that predicts the check best; the check joins the pool."""
    pulse = bench.pulse(step, samples, area)
    check = None if pulse is None or not pulse.size else bench.check(pulse)
    if pulse is None or check is None or not check.size:
        return None
    pool.append(check)
    realization, values = realize(pulse)
    tried = tuple((k, identify(pulse, realization, k)) for k in ((order,) if order is not None else orders(values)))
    errors = {k: model.error(check) for k, model in tried if model is not None}
    if not errors:
        return None
    chosen = next(k for k in sorted(errors) if errors[k] <= SIMPLER * min(errors.values()))
    model = next(m for k, m in tried if k == chosen and m is not None)
    return _Candidate(pulse, check, values, tried, model, errors[chosen])


def _linearization(bench: Bench, best: _Candidate, model: Model, measured: tuple[float, float, float]) -> Linearization:
    unsure, drift, y = measured
    A, B, C, D = model.matrices
    n = len(B)
    uncertainty = 4 * np.finfo(float).eps * np.abs(np.block([[A, B[:, None]], [C[None, :], np.array([[D]])]]))
    row = 0
    for pole, error in zip(model.poles, model.spread.tolist(), strict=True):
        width = pole.multiplicity * (2 if pole.is_flexible else 1)
        block = np.s_[row : row + width, row : row + width]
        uncertainty[block] += np.where(A[block] != 0.0, error, 0.0) if pole.multiplicity == 1 else 0.0
        row += width
    identification = Identification(
        step=float(best.pulse.times[1]),
        samples=len(best.pulse.times) - 1,
        amplitude=float(best.pulse.levels[0]),
        singular_values=tuple((best.values[: max(2 * n + 4, 8)] / best.values[0] if best.values[0] else best.values[:8]).tolist()),
        orders=tuple((k, math.inf if m is None else m.error(best.check)) for k, m in best.tried),
        order=n,
        fit_error=model.error(best.pulse),
        check_error=model.error(best.check),
        amplitude_error=unsure,
        drift=drift,
    )
    return Linearization(
        states=tuple(f"m{i}" for i in range(1, n + 1)),
        A=A,
        B=B,
        C=C.copy(),
        D=D,
        method="identified",
        x=np.zeros(n),
        u=float(bench.point.initial_input),
        y=y,
        rates=np.zeros(n),
        uncertainty=uncertainty,
        sizes=np.append(np.ones(n), bench.size),
        settled=bench.point.settle,
        identification=identification,
        relative_degree=model.relative_degree,
        notes=model.notes,
    )
