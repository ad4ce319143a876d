"""From values to verdicts: requirements against runs, with the numerical error and the margin."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import Enum

from suite.study import Requirement


class Verdict(Enum):
    """What became of a requirement; the value is how JSON writes it. UNDECIDED and ERROR are no kind of pass."""

    PASS = "pass"
    FAIL = "fail"
    UNDECIDED = "undecided"
    ERROR = "error"


@dataclass(frozen=True, slots=True)
class Measured:
    """A measured value and the estimate of its numerical error (from a finer run)."""

    value: float
    error: float


def margin(requirement: Requirement, value: float) -> float:
    """`maximum - value` or `value - minimum`, the smaller; negative where the requirement is violated."""
    above = math.inf if requirement.maximum is None else requirement.maximum - value
    below = math.inf if requirement.minimum is None else value - requirement.minimum
    return math.nan if math.isnan(value) else min(above, below)


def limit(requirement: Requirement, value: float) -> float | None:
    """The limit that `value` is nearest to violating, or violates most."""
    if requirement.minimum is None or requirement.maximum is None:
        return requirement.maximum if requirement.minimum is None else requirement.minimum
    return requirement.maximum if requirement.maximum - value <= value - requirement.minimum else requirement.minimum


def judge_run(requirement: Requirement, measured: Measured) -> Verdict:
    """PASS or FAIL of one run, UNDECIDED if a limit lies within value ± error, ERROR if the value is no number."""
    distance = margin(requirement, measured.value)
    if math.isnan(distance) or math.isnan(measured.error):
        return Verdict.ERROR
    if measured.error > 0.0 and abs(distance) <= measured.error:
        return Verdict.UNDECIDED
    return Verdict.PASS if distance >= 0.0 else Verdict.FAIL


@dataclass(frozen=True, slots=True)
class RunVerdict:
    """One run as a requirement sees it: its name, and what was measured; None if the run failed (`detail` says how)."""

    run: str
    nominal: bool
    measured: Measured | None
    detail: str = ""


@dataclass(frozen=True, slots=True)
class Judgement:
    """A requirement's verdict with its evidence: the run with the least margin (or the run that failed), its value and margin."""

    requirement: Requirement
    verdict: Verdict
    measured: Measured | None
    worst_run: str | None
    reason: str

    @property
    def margin(self) -> float | None:
        """The least margin over all runs that the requirement speaks of."""
        return None if self.measured is None else margin(self.requirement, self.measured.value)


def judge(requirement: Requirement, runs: Iterable[RunVerdict]) -> Judgement:
    """One requirement over its scope: FAIL if any run fails it, else ERROR if any run is in error, else UNDECIDED if any is, else PASS."""
    scope = [run for run in runs if run.nominal or requirement.scope == "box"]
    broken = [run for run in scope if run.measured is None]
    measured = [(run, run.measured, judge_run(requirement, run.measured)) for run in scope if run.measured is not None]
    verdict = overall([*(outcome for _, _, outcome in measured), *([Verdict.ERROR] if broken or not scope else [])])
    # A run that is undecided may have less margin than one that surely fails: the evidence is a run that has the verdict.
    decisive = [item for item in measured if item[2] is verdict] or measured
    worst = min(decisive, key=lambda item: _rank(requirement, item[1]), default=None)
    if verdict is Verdict.ERROR and broken:
        return Judgement(requirement, verdict, None, broken[0].run, _errors(broken))
    if worst is None:
        return Judgement(requirement, Verdict.ERROR, None, None, "no run was made")
    run, value, _ = worst
    return Judgement(requirement, verdict, value, run.run, _reason(requirement, verdict, value, run, broken))


def overall(verdicts: Sequence[Verdict]) -> Verdict:
    """Fail, else error, else undecided, else pass."""
    for verdict in (Verdict.FAIL, Verdict.ERROR, Verdict.UNDECIDED):
        if verdict in verdicts:
            return verdict
    return Verdict.PASS


def _rank(requirement: Requirement, measured: Measured) -> float:
    distance = margin(requirement, measured.value)
    return -math.inf if math.isnan(distance) else distance


def _errors(broken: Sequence[RunVerdict]) -> str:
    more = f" (and {len(broken) - 1} more)" if len(broken) > 1 else ""
    return f"run {broken[0].run} could not be finished: {broken[0].detail}{more}"


def _reason(requirement: Requirement, verdict: Verdict, value: Measured, run: RunVerdict, broken: Sequence[RunVerdict]) -> str:
    distance, nearest = margin(requirement, value.value), limit(requirement, value.value)
    number = f"{requirement.quantity} is {value.value:.6g} in run {run.run}"
    match verdict:
        case Verdict.FAIL:
            reason = f"{number}, {-distance:.3g} beyond the limit {nearest:.6g}"
        case Verdict.UNDECIDED:
            reason = f"{number}: the limit {nearest:.6g} lies within its numerical error {value.error:.2g}"
        case Verdict.ERROR:
            reason = f"{requirement.quantity} has no value in run {run.run}"
        case Verdict.PASS:
            reason = f"{number}, {distance:.3g} within the limit {nearest:.6g}"
    return f"{reason}; {_errors(broken)}" if broken else reason
