"""What an FMU says about itself: its variables, units and capabilities, as plain frozen data."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from fmus.errors import DescriptionError
from fmus.markup import one_line, read_markup
from fmus.variables import NUMBER_TYPES, DisplayUnit, Unit, Value, Variable, element_indices, require_elements, require_in_all

if TYPE_CHECKING:
    from fmus.instances import ModelDescription, ModelVariable, RawUnit

INTERFACES = ("CoSimulation", "ModelExchange", "ScheduledExecution")
FMI3 = re.compile(r"3\.\d+(\.\d+)?", re.ASCII)
"""Versions of FMI 3; one with a hyphen, such as 3.0-beta.2, is preliminary, and its functions differ."""
SETTABLE = ("parameter", "structuralParameter", "input")
"""Causalities of what a study may set before a run."""


@dataclass(frozen=True, slots=True)
class Capabilities:
    """What the FMU can do. The identifiers are the file names of its binaries, None where the interface is missing.

    Of co-simulation: `variable_step` … `restores_steps` (FMU states can be saved and restored) and `fixed_internal_step` [s]. Of model
    exchange: `completed_steps` (it wants to know of each accepted integrator step) and, in FMI 2.0, the number of `event_indicators`.
    `directional_derivatives` are those of model exchange, `directional_in_steps` those of co-simulation.
    """

    co_simulation: str | None = None
    model_exchange: str | None = None
    variable_step: bool = False
    interpolates_inputs: bool = False
    directional_derivatives: bool = False
    directional_in_steps: bool = False
    once_per_process: bool = False
    needs_execution_tool: bool = False
    fixed_internal_step: float | None = None
    event_mode: bool = False
    early_return: bool = False
    intermediate_update: bool = False
    restores_steps: bool = False
    completed_steps: bool = True
    event_indicators: int = 0

    @property
    def one_step(self) -> bool:
        """Whether communication points lie on multiples of one step only."""
        return self.co_simulation is not None and (not self.variable_step or self.fixed_internal_step is not None)


@dataclass(frozen=True, slots=True)
class Description:
    """modelDescription.xml; `default_step` [s] and `default_tolerance` are its default experiment's, None where it has none."""

    fmi_version: str
    model_name: str
    guid: str
    tool: str
    variables: tuple[Variable, ...]
    capabilities: Capabilities
    default_step: float | None = None
    default_tolerance: float | None = None
    units: tuple[Unit, ...] = ()
    log_categories: tuple[str, ...] = ()
    interfaces: tuple[tuple[str, tuple[tuple[str, str], ...]], ...] = ()
    """Every interface as written: its element's name and its attributes."""
    states: tuple[tuple[str, str], ...] = ()
    """Name of each continuous state and of its derivative, in the order of the FMU's state vector."""
    _by_name: dict[str, Variable] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_by_name", {variable.name: variable for variable in reversed(self.variables)})

    @property
    def grid_step(self) -> float | None:
        """The step [s] that a co-simulation with one step size only is meant for; None if it does not say."""
        return self.capabilities.fixed_internal_step or self.default_step

    @property
    def major(self) -> int:
        """2 or 3."""
        return int(self.fmi_version.split(".")[0])

    def names(self, causality: str | None = None) -> tuple[str, ...]:
        """The variables' names, all or those of one causality."""
        return tuple(v.name for v in self.variables if causality in (None, v.causality))

    @property
    def state_names(self) -> tuple[str, ...]:
        """The continuous states one by one, in the order of the FMU's state vector: arrays element by element."""
        return tuple(name for state, _ in self.states for name in self.find(state).elements)

    @property
    def rate_names(self) -> tuple[str, ...]:
        """The derivatives of `state_names`."""
        return tuple(name for _, rate in self.states for name in self.find(rate).elements)

    def resized(self, values: Mapping[str, Value]) -> Description:
        """The description with those of `values` that set structural parameters: they become start values, and arrays get their sizes."""
        named = [(self._by_name[name], value) for name, value in values.items() if name in self._by_name]
        changed = {v.name: float(v.number(value)) for v, value in named if v.causality == "structuralParameter"}
        if not changed:
            return self
        sizes = {v.name: changed.get(v.name, v.start) for v in self.variables if v.causality == "structuralParameter"}

        def size(dimension: int | str) -> int:
            return dimension if isinstance(dimension, int) else int(float(sizes[dimension] or 0.0))

        shapes = [tuple(map(size, v.dimensions)) for v in self.variables]
        require_in_all(sum(require_elements(v.name, shape) for v, shape in zip(self.variables, shapes, strict=True) if shape))
        variables = (replace(v, start=changed[v.name]) if v.name in changed else v for v in self.variables)
        return replace(self, variables=tuple(v.resized(shape) for v, shape in zip(variables, shapes, strict=True)))

    def find(self, name: str, causality: str | None = None) -> Variable:
        """The variable of that name, or an array's element ("x[2]", "A[1,3]", counted from 1).

        `DescriptionError` with the nearest names, or if its causality is another one.
        """
        variable = self._by_name.get(name)
        if variable is None and (parts := element_indices(name)) and (array := self._by_name.get(parts[0])):
            variable = array.at(parts[1])
        if variable is None:
            raise DescriptionError(f"{self.model_name} has no variable {name!r}{self._suggestion(name, causality)}")
        if causality is not None and variable.causality != causality:
            raise DescriptionError(
                f"{name!r} of {self.model_name} has causality {variable.causality}, not {causality}{self._suggestion(name, causality)}"
            )
        return variable

    def settable(self, name: str, driven: str = "") -> Variable:
        """The variable of that name that can be set before the run and keeps its value: a parameter, or an input that is not `driven`."""
        variable = self.find(name)
        if variable.causality not in SETTABLE or name == driven:
            variable = self.find(name, "parameter")  # which says what there is
        if variable.type not in NUMBER_TYPES:
            raise DescriptionError(
                f"{variable.causality} {name!r} is of type {variable.type} and keeps its start value; "
                "only numbers, Booleans and enumerations can be set"
            )
        return variable

    def settable_parameter(self, name: str, driven: str = "") -> Variable:
        """`settable`, and a single number."""
        variable = self.settable(name, driven)
        if variable.dimensions:
            hint = f"name one element, such as {_first(variable)}"
            raise DescriptionError(f"{variable.causality} {name!r} is of type {variable.kind}; {hint}")
        return variable

    def settable_state(self, name: str) -> Variable:
        """The variable of that name whose start value can be set: `initial` is exact or approx."""
        variable = self.find(name)
        if not variable.is_real or variable.initial not in ("exact", "approx") or variable.causality in ("parameter", "input"):
            able = [v.name for v in self.variables if v.is_real and v.initial == "exact" and v.causality in ("local", "output")]
            raise DescriptionError(
                f"{name!r} ({variable.causality}, initial {variable.initial}) has no start value of a state that can be set; "
                f"such are: {', '.join(able) or 'none'}"
            )
        return variable

    def drivable_input(self, name: str) -> Variable:
        """The input of that name that a command can drive: a single real number."""
        variable = self.find(name, "input")
        if not variable.is_real:
            hint = f"; name one element, such as {_first(variable)}" if variable.dimensions else ""
            raise DescriptionError(f"input {name!r} is of type {variable.kind}; a command drives a single real input{hint}")
        return variable

    def readable(self, name: str) -> Variable:
        """The variable of that name that can be logged: a single number."""
        variable = self.find(name)
        if not variable.is_number:
            hint = f"; name one element, such as {_first(variable)}" if variable.dimensions and variable.type in NUMBER_TYPES else ""
            raise DescriptionError(f"{name!r} is of type {variable.kind}; only single numbers can be logged{hint}")
        return variable

    def _suggestion(self, name: str, causality: str | None) -> str:
        names = self.names(causality)
        near = difflib.get_close_matches(name, names, n=3, cutoff=0.5)
        what = {None: "variables", "independent": "independent variables"}.get(causality, f"{causality}s")
        if near:
            return "; did you mean " + " or ".join(map(repr, near)) + "?"
        listed = ", ".join(names[:12]) + (", …" if len(names) > 12 else "")
        return f"; its {what} are: {listed}" if names else f"; it has no {what}"


def _first(array: Variable) -> str:
    return array.elements[0] if array.size else f"{array.name}[1]"


def read_description(xml: bytes) -> Description:
    """Parse and validate a modelDescription.xml (FMI 2.0 or 3.0).

    `DescriptionError` for a DOCTYPE (entities could read files or fill the memory), another FMI version, an FMU for
    scheduled execution only, or anything that the standard's schema refuses.
    """
    intermediate: set[str] = set()
    interfaces = _interfaces(xml, intermediate)
    from fmus.instances import parse_description  # heavy: validation needs the XML schemas

    raw = parse_description(xml)
    cs, me = raw.coSimulation, raw.modelExchange
    either = cs or me
    if either is None:
        tool = one_line(raw.generationTool or "its tool")
        raise DescriptionError(
            f"{one_line(raw.modelName or 'this FMU')} offers scheduled execution only; Co-Simulation or Model Exchange is needed: "
            f"export it anew from {tool}"
        )
    fixed = _number(cs.fixedInternalStepSize) if cs else None
    capabilities = Capabilities(
        co_simulation=cs.modelIdentifier if cs else None,
        model_exchange=me.modelIdentifier if me else None,
        variable_step=bool(cs and cs.canHandleVariableCommunicationStepSize),
        interpolates_inputs=bool(cs and cs.canInterpolateInputs),
        directional_derivatives=_directional(interfaces.get("ModelExchange", {})),
        directional_in_steps=_directional(interfaces.get("CoSimulation", {})),
        once_per_process=bool(either.canBeInstantiatedOnlyOncePerProcess),
        needs_execution_tool=bool(either.needsExecutionTool),
        fixed_internal_step=fixed,
        event_mode=bool(cs and cs.hasEventMode),
        early_return=bool(cs and (cs.mightReturnEarlyFromDoStep or cs.hasEventMode)),
        intermediate_update=bool(cs and cs.providesIntermediateUpdate),
        restores_steps=bool(cs and cs.canGetAndSetFMUstate),
        completed_steps=bool(me and me.needsCompletedIntegratorStep),
        event_indicators=raw.numberOfEventIndicators or 0,
    )
    require_in_all(sum(require_elements(v.name, v.shape) for v in raw.modelVariables if v.shape))  # before any of them is made
    variables = tuple(_variable(v, v.name in intermediate) for v in raw.modelVariables)
    experiment = raw.defaultExperiment
    return Description(
        fmi_version=raw.fmiVersion or "",
        model_name=one_line(raw.modelName or ""),
        guid=raw.guid or "",
        tool=one_line(raw.generationTool or ""),
        variables=variables,
        capabilities=capabilities,
        default_step=_number(experiment.stepSize) if experiment else None,
        default_tolerance=_number(experiment.tolerance) if experiment else None,
        units=tuple(_unit(u) for u in raw.unitDefinitions),
        log_categories=tuple(category.name for category in raw.logCategories),
        interfaces=tuple((name, tuple(interfaces[name].items())) for name in INTERFACES if name in interfaces),
        states=tuple(_states(raw)),
    )


def _states(raw: ModelDescription) -> Iterator[tuple[str, str]]:
    for unknown in raw.derivatives:
        derivative = unknown.variable
        if derivative is None or derivative.derivative is None:
            raise DescriptionError("modelDescription.xml lists a derivative of a continuous state that derives nothing")
        yield derivative.derivative.name, derivative.name


def _directional(interface: Mapping[str, str]) -> bool:
    # The attribute of FMI 3.0 has a plural "s" that the parser does not know.
    return any(interface.get(f"providesDirectionalDerivative{s}") in ("true", "1") for s in ("", "s"))


def _unit(raw: RawUnit) -> Unit:
    base = raw.baseUnit
    powers = tuple((symbol, int(getattr(base, symbol, 0))) for symbol in ("kg", "m", "s", "A", "K", "mol", "cd", "rad"))
    factor, offset = float(getattr(base, "factor", 1.0)), float(getattr(base, "offset", 0.0))
    shown = tuple(DisplayUnit(d.name or "", float(d.factor), float(d.offset)) for d in raw.displayUnits)
    return Unit(raw.name or "", tuple(p for p in powers if p[1]), factor, offset, shown, base is not None)


def _variable(raw: ModelVariable, intermediate: bool) -> Variable:
    declared = raw.declaredType
    numeric = raw.type in NUMBER_TYPES
    start: float | str | None = raw.start
    starts: tuple[float, ...] = ()
    if numeric and raw.dimensions:
        # One value stands for all of them.
        given = [_start(word) for word in (raw.start or "").split()]
        starts, start = tuple(x for x in given if x is not None), None
        shape = tuple(raw.shape or ())
        starts = starts * math.prod(shape) if len(starts) == 1 else starts if len(starts) == math.prod(shape) else ()
    elif numeric and raw.start is not None:
        start = _start(raw.start)
    nominal = _number(raw.nominal) or (_number(declared.nominal) if declared else None)
    items = tuple((item.name or "", int(item.value or 0)) for item in declared.items) if declared else ()
    limits = (_number(own if own is not None else getattr(declared, key, None)) for key, own in (("min", raw.min), ("max", raw.max)))
    minimum, maximum = limits
    return Variable(
        name=raw.name,
        causality=raw.causality,
        variability=raw.variability,
        type=raw.type,
        unit=raw.unit or (declared.unit if declared else None) or "",
        start=start,
        value_reference=raw.valueReference,
        description=raw.description or "",
        initial=raw.initial,
        nominal=abs(nominal or 1.0),  # some tools export a nominal of 0, which must be read as 1
        shape=tuple(raw.shape or ()),
        derivative_of=raw.derivative.name if raw.derivative is not None else None,
        intermediate=intermediate,
        dimensions=tuple(d.variable.name if d.variable is not None else int(d.start) for d in raw.dimensions),
        starts=starts,
        items=items if raw.type == "Enumeration" else (),
        minimum=minimum if numeric else None,
        maximum=maximum if numeric else None,
        display_unit=raw.displayUnit or (declared.displayUnit if declared else None) or "",
    )


def _start(word: str) -> float | None:
    return float(word == "true") if word in ("true", "false") else _number(word)


def _number(text: str | float | None) -> float | None:
    if text is None:
        return None
    try:
        value = float(text)
    except ValueError:
        raise DescriptionError(f"modelDescription.xml has {text!r} where a number belongs") from None
    return value if math.isfinite(value) else None


def _interfaces(xml: bytes, intermediate: set[str]) -> dict[str, dict[str, str]]:
    """The attributes of the root's direct children, after refusing what must not reach a full XML parser.

    `intermediate` receives the variables that can be set within a step, an attribute that the parser does not know.
    """
    found: dict[str, dict[str, str]] = {}

    def start(name: str, attributes: dict[str, str], depth: int) -> None:
        if depth == 0:
            _check_root(name, attributes)
        elif depth == 1:
            found[name] = attributes
        elif depth == 2 and attributes.get("intermediateUpdate") in ("true", "1"):
            intermediate.add(attributes.get("name", ""))

    read_markup(xml, "modelDescription.xml", start)
    return found


def _check_root(name: str, attributes: dict[str, str]) -> None:
    version = attributes.get("fmiVersion", "")
    if name != "fmiModelDescription":
        raise DescriptionError(f"modelDescription.xml starts with <{one_line(name)}>, not <fmiModelDescription>")
    model, tool = (one_line(attributes.get(key, other)) for key, other in (("modelName", "this FMU"), ("generationTool", "its tool")))
    if version != "2.0" and not FMI3.fullmatch(version):
        early = ", a preliminary version of the standard," if version.startswith("3.") else ""
        raise DescriptionError(
            f"FMI version {one_line(version) or 'missing'}{early} is not supported; 2.0 and 3.0 are: export {model} anew from {tool}"
        )
