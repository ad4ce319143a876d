"""The child's part of a linearisation: the Jacobian of an FMU at a point that `make` brings an instance to.

Only the standard library is imported here (`fmus.isolated`). Two interfaces can tell derivatives: model exchange, by directional
derivatives and by differences of its right-hand side; and co-simulation where it offers directional derivatives and names its states.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from fmus.differences import column
from fmus.errors import CallFailed
from fmus.instances import Instance, Typed
from fmus.sessions import driver

Make = Callable[[], Instance]


def jacobian(request: dict[str, Any], make: Make) -> dict[str, Any]:
    """The reply to a request "linearize": the point (x, rates, y) and, as far as asked for, the columns of
    `∂(derivatives, outputs)/∂(states, input)` by either method, those of the differences with their errors."""
    fmu = _Point(request, make)
    x, rates, y = fmu.read()
    reply: dict[str, Any] = {
        "x": x,
        "rates": rates,
        "y": y,
        "note": "",
        "refused": "",
        "directional": None,
        "differences": None,
        "errors": None,
    }
    if request["directional"]:
        try:
            reply["directional"] = fmu.directional()
        except CallFailed as problem:
            if problem.status == "Fatal":
                raise
            reply["note"] = f"directional derivatives failed ({problem})"
            fmu.renew()
    if request["differences"]:
        point, found = [*x, request["initial_input"]], []
        for i, size in enumerate(request["scales"]):
            size = max(size, abs(point[i]))
            entry = column(lambda value, i=i: fmu.evaluate([*point[:i], value, *point[i + 1 :]]), point[i], size, request["largest"])
            if entry is None:
                reply["refused"] = f"derivatives are not finite for small changes of {request['names'][i]!r} about {point[i]!r}"
                break
            found.append(entry)
        else:
            reply["differences"], reply["errors"] = [values for values, _ in found], [errors for _, errors in found]
    warning = fmu.instance.warning
    fmu.instance.free()
    return {"status": "FINISHED", "detail": warning, **reply}


class _Point:
    """An instance at the operating point, replaced by another one whenever it has failed."""

    def __init__(self, request: dict[str, Any], make: Make) -> None:
        self._make = make
        self._exchange = request["interface"] == "model_exchange"
        self._states: list[Typed] = [tuple(v) for v in request["states"]]
        self._derivatives: list[Typed] = [tuple(v) for v in request["derivatives"]]
        self._outputs: list[Typed] = [tuple(v) for v in request["outputs"]]
        self._input: Typed = tuple(request["input"])
        self._request = request
        self.instance = make()
        self._drive = driver(self.instance, request)

    def renew(self) -> None:
        """After an Error the standard allows little more than to free the instance."""
        self.instance.free()
        self.instance = self._make()
        self._drive = driver(self.instance, self._request)

    def read(self) -> tuple[list[float], list[float], list[float]]:
        """States, their derivatives, outputs."""
        n, instance = len(self._states), self.instance
        if not self._exchange:
            return instance.get(self._states), instance.get(self._derivatives), instance.get(self._outputs)
        y = instance.get(self._outputs)  # before the rates: see `evaluate`
        return instance.states(n), instance.rates(n), y

    def directional(self) -> list[list[float]]:
        """A column for each state and one for the input."""
        unknowns = [variable[1] for variable in (*self._derivatives, *self._outputs)]
        return [self.instance.derivative(unknowns, known[1]) for known in (*self._states, self._input)]

    def evaluate(self, point: Sequence[float]) -> list[float] | None:
        """Derivatives and outputs at states and input (the last number); None where the FMU has no value."""
        n, instance = len(self._states), self.instance
        try:
            instance.set_states(point[:n]) if n else None
            self._drive(point[n])
            # Outputs first: FMUs of some tools hold everything for up to date once their derivatives are, and then give old outputs.
            outputs = instance.get(self._outputs)
            return instance.rates(n) + outputs
        except CallFailed as problem:
            if problem.status == "Fatal":
                raise
            self.renew()
            return None
