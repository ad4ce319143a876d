"""The linear plant of an FMU about an operating point, by derivatives, by differences, or identified from its response.

    ẋ = A (x - x_0) + B (u - u_0),   y - y_0 = C (x - x_0) + D (u - u_0)

The operating point is where the FMU starts with the parameters, states and input that it is given, or where it has settled from there.
Derivatives and differences need an interface that shows the states; identification (`fmus.probing`) needs co-simulation only.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from fmus.archives import Fmu
from fmus.differences import LARGEST
from fmus.errors import LinearizationError
from fmus.settling import natural_step, rest
from fmus.stepping import Array, Experiment, Probe, RunStatus
from fmus.variables import Value
from fmus.workers import Worker
from relaxations.commands import Command, Tail
from relaxations.realization import Realization, realize

Method = Literal["auto", "derivatives", "differences", "identified"]
"""`auto`: directional derivatives where the FMU offers them, else differences, else identified."""

REST = 1e-6  # of what states and inputs of natural size cause: rates above this are no rest
ROUNDING = 4 * np.finfo(float).eps  # relative error of a directional derivative: formulas of a few operations
CHECKED = 200  # states up to which directional derivatives are compared with differences: 28 evaluations a state
AGREEMENT = 1e-4  # of a row's largest entry: how far derivatives may be from differences and still be believed
CAUTIOUS = 2.0**-15  # largest step of the differences for an FMU that crashed on larger ones
LOST = (RunStatus.CRASHED, RunStatus.EXITED, RunStatus.HUNG)


@dataclass(frozen=True, slots=True)
class Identification:
    """How a plant was identified, and how well it predicts.

    `step` [s] and `samples` of the response to pulses of ± `amplitude` (input units) over one sample; `singular_values` of its Hankel
    matrix, relative to the largest; `orders` tried there, each with its error on another input (infinite: no continuous plant); `order`
    chosen. `fit_error` is the largest distance from the response that was fitted, `check_error` from that to the other input, each over
    its largest deviation. `amplitude_error` is what non-linearity and noise may have done to the response, likewise. `drift` is how far the
    output moved with the input at rest, relative to what a natural step of the input does in that time.
    """

    step: float
    samples: int
    amplitude: float
    singular_values: tuple[float, ...]
    orders: tuple[tuple[int, float], ...]
    order: int
    fit_error: float
    check_error: float
    amplitude_error: float
    drift: float

    @property
    def summary(self) -> str:
        """In one sentence."""
        return (
            f"order {self.order} from {self.samples} samples every {self.step:.3g} s after pulses of ±{self.amplitude:.3g}: it misses "
            f"the response to another input by {self.check_error:.1g} of it. Nothing is known of the FMU beyond that"
        )


@dataclass(frozen=True, slots=True)
class Linearization:
    """State-space matrices with the point that they belong to; arrays are read-only.

    `A` (n, n), `B` (n,), `C` (n,), `D`; `states` names the rows. `uncertainty` (n+1, n+1) is the estimated error of each entry of
    [A B; C D]. `x`, `u`, `y` are the operating point, reached after settling for `settled` [s], `sizes` (n+1,) the natural sizes of states
    and input (the larger of value and nominal), and `rates` the states' derivatives there, zero at an equilibrium. `method` is
    "directional derivatives", "finite differences" or "identified"; then `identification` tells how, the states have no names in the
    FMU, and the first `relative_degree` of D, CB, CAB … are zero but for rounding. `interface` (in the description's words) is the one
    whose library was asked. `notes` say what a reader should know, such as why derivatives that the FMU promises were not used.
    """

    states: tuple[str, ...]
    A: Array
    B: Array
    C: Array
    D: float
    method: str
    x: Array
    u: float
    y: float
    rates: Array
    uncertainty: Array
    sizes: Array
    settled: float = 0.0
    identification: Identification | None = None
    relative_degree: int = 0
    interface: str = "co_simulation"
    notes: tuple[str, ...] = field(default=())

    def __post_init__(self) -> None:
        for array in (self.A, self.B, self.C, self.x, self.rates, self.uncertainty, self.sizes):
            array.setflags(write=False)

    @property
    def imbalances(self) -> Array:
        """|rate| of each state, relative to what states and input of natural size cause; 0 for states that reach no output. Shape (n,)."""
        n = len(self.states)
        reach = self.C != 0.0
        for _ in range(n):
            reach = reach | (self.A[reach] != 0.0).any(axis=0)
        scale = np.abs(np.column_stack([self.A, self.B])) @ self.sizes
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(reach & (self.rates != 0.0), np.abs(self.rates) / scale, 0.0)

    @property
    def error(self) -> float:
        """The largest uncertainty of an entry, relative to the largest entry of its row, both scaled by the natural sizes."""
        matrix = np.block([[self.A, self.B[:, None]], [self.C, np.array([self.D])]])
        rows = (np.abs(matrix) * self.sizes).max(axis=1, keepdims=True, initial=0.0)
        return float((self.uncertainty * self.sizes / np.where(rows > 0.0, rows, 1.0)).max(initial=0.0))

    @property
    def summary(self) -> str:
        """How it was found, and how good it is, in one sentence."""
        where = f"after settling for {self.settled:.6g} s" if self.settled else "where it starts"
        if self.identification is None:
            return f"its linearisation {where}, by {self.method} (relative error of the entries about {self.error:.1g})"
        return f"identified {where} from its response, {self.identification.summary}"

    def plant(self, output: str) -> Realization:
        """The exact linear plant that these numbers stand for; raises `PlantError` if it is none that can be used."""
        return realize(self.A, self.B, self.C, self.D, self.uncertainty, self.sizes, relative_degree=self.relative_degree, name=output)

    def require_rest(self, name: str) -> None:
        """Raise `LinearizationError` unless the operating point is an equilibrium; `name` is the FMU's."""
        unrest = self.imbalances
        if not len(unrest) or unrest.max() <= REST:
            return
        worst = int(unrest.argmax())
        how = "after settling" if self.settled else "where it starts"
        raise LinearizationError(
            f"{name} is not at rest {how}, with input {self.u!r}: the derivative of {self.states[worst]!r} is {self.rates[worst]:.6g}, "
            f"{unrest[worst]:.2g} of what is natural there ({REST:g} is allowed){self._nearest()}"
        )

    def _nearest(self) -> str:
        """Where the linear plant would rest, if that is anywhere."""
        sizes = self.sizes[:-1]
        move = np.linalg.lstsq(self.A * sizes, -self.rates, rcond=1e-10)[0] * sizes
        if not np.allclose(self.A @ move, -self.rates, rtol=1e-6, atol=1e-12):
            return "; at this input it rests nowhere near: give another input"
        moved = sorted(range(len(move)), key=lambda i: -abs(move[i]) / sizes[i])[:4]
        there = np.where(np.abs(self.x + move) > 1e-9 * sizes, self.x + move, 0.0)
        places = ", ".join(f"{self.states[i]} = {there[i]:.10g}" for i in moved if abs(move[i]) > 1e-9 * sizes[i])
        return f"; the nearest rest is about {places}: give that state, or let it settle"


def linearize(
    fmu: Fmu,
    input: str,
    output: str,
    parameters: Mapping[str, Value] | None = None,
    *,
    initial_state: Mapping[str, float] | None = None,
    initial_input: float = 0.0,
    settle: float = 0.0,
    step: float | None = None,
    method: Method = "auto",
    probe: Probe | None = None,
    timeout: float = 60.0,
    worker: Worker | None = None,
) -> Linearization:
    """Linearise in a child process about the FMU's initial point, or where it is after `settle` [s] (infinite: when it rests).

    `step` is the communication step [s] with which it settles and an identification begins, the FMU's own unless given; `probe` says how
    an identification is carried out. Raises `LinearizationError` when the FMU fails, never settles, or a matrix is not finite, or for a
    method that needs an interface that it does not offer, `DescriptionError` for names that it does not have.
    """
    at_rest = Command(0.0, (), Tail(initial_input))
    step = step or natural_step(fmu)
    point = Experiment(fmu.path, input, (output,), parameters or {}, initial_input, initial_state or {}, at_rest, step, step, settle=settle)
    interface = _interface(fmu, method)
    with ExitStack() as stack:
        worker = worker or stack.enter_context(Worker())
        if interface is None:
            from fmus.probing import identify_fmu

            return identify_fmu(worker, fmu, point, probe, timeout)
        reached = rest(worker, fmu, point, timeout) if settle else (0.0, {})
        return _differentiated(worker, fmu, point, interface, method, reached, timeout)


def _interface(fmu: Fmu, method: Method) -> str | None:
    """Which interface shows the states to this method; None if it identifies."""
    has = fmu.description.capabilities
    exchange, steps = has.model_exchange is not None, has.directional_in_steps and bool(fmu.description.states)
    if method == "identified" or (method == "auto" and not exchange and not steps):
        return None
    if method == "differences" and not exchange:
        raise LinearizationError(f"{fmu.path.name} offers no Model Exchange, which differences need; it can be identified")
    if method == "derivatives" and not (exchange and has.directional_derivatives) and not steps:
        other = "differences and identified are" if exchange else "identified is"
        raise LinearizationError(f"{fmu.path.name} offers no directional derivatives; {other} possible")
    if method == "derivatives" and not has.directional_derivatives:
        return "co_simulation"
    return "model_exchange" if exchange else "co_simulation"


def _differentiated(
    worker: Worker, fmu: Fmu, point: Experiment, interface: str, method: Method, reached: tuple[float, Mapping[str, float]], timeout: float
) -> Linearization:
    has, (settled, values) = fmu.description.resized(point.parameters), reached
    names = has.state_names
    n, exchange = len(names), interface == "model_exchange"
    offered = has.capabilities.directional_derivatives if exchange else has.capabilities.directional_in_steps
    # Of an array the standard gives derivatives as a whole only.
    single = all(has.find(name).element is None for name in (*names, *has.rate_names, point.input, *point.outputs))
    directional = offered and single and method != "differences"
    starts = [*(values.get(name, has.find(name).start) for name in names), point.initial_input]
    sizes = [_size(has.find(name).nominal, start) for name, start in zip([*names, point.input], starts, strict=True)]
    asked: dict[str, Any] = {
        "interface": interface,
        "directional": directional,
        "differences": exchange and (not directional or n <= CHECKED),
        "largest": LARGEST,
        "scales": sizes,
        "time": settled,
        "state": [values[name] for name in names] if settled and exchange else None,
        "settle": [round(settled / point.step), point.step],
    }
    notes: list[str] = []
    try:
        answer = worker.jacobian(fmu, point, asked, timeout)
    except LinearizationError as problem:
        if not asked["differences"] or problem.status not in LOST:
            raise
        # A step may have led out of the plant's domain. What remains is worth having, and is marked.
        asked |= {"differences": False} if directional else {"largest": CAUTIOUS}
        answer = worker.jacobian(fmu, point, asked, timeout)
        notes.append(f"{problem}; only smaller steps were taken" if not directional else f"{problem}; derivatives were not compared")
    if answer["note"]:
        notes.append(answer["note"])
    matrix, uncertainty, name, more = _chosen(answer, sizes, method)
    everything = np.array([*answer["x"], *answer["rates"], *answer["y"]], dtype=float)
    if not (np.isfinite(matrix).all() and np.isfinite(everything).all()):
        raise LinearizationError(f"{fmu.path.name} gives a linear plant with entries that are not finite")
    return Linearization(
        states=names,
        A=matrix[:n, :n].copy(),
        B=matrix[:n, n].copy(),
        C=matrix[n, :n].copy(),
        D=float(matrix[n, n]),
        method=name,
        x=np.array(answer["x"], dtype=float),
        u=float(point.initial_input),
        y=float(answer["y"][0]),
        rates=np.array(answer["rates"], dtype=float),
        uncertainty=uncertainty,
        sizes=np.array([*(_size(s, v) for s, v in zip(sizes, answer["x"], strict=False)), sizes[-1]]),
        settled=settled,
        interface=interface,
        notes=(*notes, *more),
    )


def _size(nominal: float, value: float | str | None) -> float:
    return max(nominal, abs(value)) if isinstance(value, float) and math.isfinite(value) else nominal


def _chosen(answer: Mapping[str, Any], sizes: list[float], method: Method) -> tuple[Array, Array, str, list[str]]:
    """The Jacobian to believe, its entries' errors, the method's name, and what is to be said about the choice."""
    exact, differences = _matrix(answer["directional"]), _matrix(answer["differences"])
    if exact is None and differences is None:
        raise LinearizationError(answer["refused"] or "neither derivatives nor differences could be computed")
    if exact is None:
        assert differences is not None
        errors = _matrix(answer["errors"])
        assert errors is not None
        return differences, errors, "finite differences", []
    uncertainty = ROUNDING * np.abs(exact)
    if differences is None:
        return exact, uncertainty, "directional derivatives", [answer["refused"]] if answer["refused"] else []
    errors = _matrix(answer["errors"])
    assert errors is not None
    distance = np.abs(exact - differences) * sizes
    rows = (np.abs(exact) * sizes).max(axis=1, keepdims=True, initial=0.0)
    wrong = distance > 10.0 * errors * sizes + AGREEMENT * rows
    if not wrong.any():
        return exact, uncertainty, "directional derivatives", []
    worst = float((distance / np.where(rows > 0.0, rows, 1.0)).max())
    note = f"the FMU's directional derivatives differ from differences of its own equations by {worst:.2g} of the largest entry of a row"
    if method == "derivatives":
        return exact, uncertainty, "directional derivatives", [note]
    return differences, errors, "finite differences", [f"{note}: differences were used"]


def _matrix(columns: list[list[float]] | None) -> NDArray[np.float64] | None:
    return None if columns is None else np.array(columns, dtype=float).T.copy()
