"""From an experiment and what the FMU can do to the steps and inputs of a run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fmus.descriptions import Capabilities, Description
from fmus.errors import FmuError
from fmus.inputs import Told, constants, instants, lines
from fmus.stepping import MERGE, Array, Experiment, grid, multiples, step_sizes


class Misfit(FmuError):
    """The FMU's step size and the experiment do not go together."""


@dataclass(frozen=True, slots=True)
class Plan:
    """`interface` in the words of the description, what the child is told (`request`, and `columns` as raw float64), and the rows.

    `times` (n,) [s] of all rows, `applied` (n,) the input from each of them on, `logged` the indices of those of the trajectory.
    """

    interface: str
    request: dict[str, Any]
    columns: bytes
    times: Array
    applied: Array
    logged: NDArray[np.intp]


def interface_of(has: Capabilities, asked: str | None) -> str:
    """The interface to use: the one asked for ("co-simulation", "model-exchange"), else co-simulation if the FMU offers it."""
    if asked is None:
        return "co_simulation" if has.co_simulation else "model_exchange"
    return asked.replace("-", "_")


def grid_step(description: Description, interface: str | None, asked: float | None) -> float | None:
    """The step [s] that all communication points are multiples of, None if the FMU takes any; `asked` is the user's, if there is one.

    Raises `Misfit` if that does not fit the FMU's internal step, or nobody names a step.
    """
    has = description.capabilities
    if interface_of(has, interface) != "co_simulation" or not has.one_step:
        return None
    step, fixed = asked or description.grid_step, has.fixed_internal_step
    if step is None:
        raise Misfit("it takes communication steps of one size only, and does not say of which: give a step")
    if fixed is not None and abs(step - round(step / fixed) * fixed) > MERGE * step:
        raise Misfit(f"its internal step is {fixed!r} s, and a communication step of {step!r} s is no multiple of it")
    return step


def plan(description: Description, experiment: Experiment) -> Plan:
    """The plan of a run; raises `Misfit` if an FMU with one step size cannot follow the command."""
    e, has = experiment, description.capabilities
    interface = interface_of(has, e.interface)
    request: dict[str, Any] = {"interface": interface, "stop": e.stop}
    if interface == "model_exchange":
        times = grid(0.0, e.stop, e.step, e.command.breakpoints)
        request |= {"command": e.command.to_dict(), "tolerance": e.tolerance, "completed_steps": has.completed_steps}
        request |= {"states": len(description.states), "indicators": has.event_indicators, "points": len(times)}
        return Plan(interface, request, times.tobytes(), times, _applied(e, times), np.arange(len(times)))
    intermediate = description.major == 3 and has.intermediate_update and description.find(e.input).intermediate
    ramps = description.major == 2 and has.interpolates_inputs
    told, sizes = _steps(description, e, intermediate, ramps)
    moving = bool((told.slopes != 0.0).any())
    request |= {
        "points": len(told.times),
        "stop": float(max(told.times[-1], e.stop)),
        "ramps": moving,
        "intermediate": intermediate and any(not piece.constant for piece in e.command.pieces()),
        "event_mode": has.event_mode,
        "early_return": has.early_return,
        "copies": description.major == 2 and has.restores_steps,
        "divisible": not has.one_step,
    }
    if request["intermediate"]:
        request["command"] = e.command.to_dict()
    columns = (told.times, sizes, told.levels, *((told.slopes,) if moving else ()))
    return Plan(interface, request, b"".join(column.tobytes() for column in columns), told.times, _applied(e, told.times), told.logged)


def _applied(e: Experiment, times: Array) -> Array:
    """The input from each of the times on. Of a slope or tail that is the command itself, not the constants or lines that stand for it."""
    return np.append(instants(e.command, times, e.initial_input).levels, e.command(times[-1], e.initial_input))


def _steps(description: Description, e: Experiment, intermediate: bool, ramps: bool) -> tuple[Told, Array]:
    """What the FMU is told, and the sizes of its steps [s]."""
    tell = instants if intermediate else lines if ramps else constants
    if not description.capabilities.one_step:
        told = tell(e.command, grid(0.0, e.stop, e.step, e.command.breakpoints), e.initial_input)
        return told, step_sizes(told.times)
    grid_step(description, e.interface, e.step)
    try:
        times = multiples(e.stop, e.step, e.command.breakpoints)
    except FmuError as problem:
        raise Misfit(f"it takes communication steps of one size only, but {problem}") from None
    told = tell(e.command, times, e.initial_input)
    if len(told.times) != len(times):
        raise Misfit("it takes communication steps of one size only, and holds its input during each, but the command slopes or decays")
    return told, np.full(len(times) - 1, e.step)
