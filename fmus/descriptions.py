"""What an FMU says about itself: its variables, units and capabilities, as plain frozen data."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING
from xml.parsers import expat

from fmus.errors import DescriptionError

if TYPE_CHECKING:
    from fmus.instances import ModelDescription, ModelVariable, RawUnit

REAL_TYPES = ("Real", "Float64", "Float32")
NUMBER_TYPES = (
    *REAL_TYPES,
    *("Integer", "Enumeration", "Boolean"),
    *("Int8", "UInt8", "Int16", "UInt16", "Int32", "UInt32", "Int64", "UInt64"),
)


@dataclass(frozen=True, slots=True)
class Unit:
    """A unit in SI base units: `factor · base + offset`; `exponents` such as (("kg", 1), ("m", 1), ("s", -2))."""

    name: str
    exponents: tuple[tuple[str, int], ...]
    factor: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True, slots=True)
class Variable:
    """One variable of the FMU. `start` is in `unit`; `derivative_of` names the state whose time derivative this is."""

    name: str
    causality: str
    variability: str
    type: str
    unit: str
    start: float | str | None
    value_reference: int
    description: str = ""
    initial: str | None = None
    nominal: float = 1.0
    shape: tuple[int, ...] = ()
    derivative_of: str | None = None
    intermediate: bool = False  # can be set within a step (FMI 3.0)

    @property
    def is_number(self) -> bool:
        """Whether it is one number (no text, clock or array), so that it can be logged."""
        return self.type in NUMBER_TYPES and not self.shape

    @property
    def is_real(self) -> bool:
        """Whether it is one floating-point number."""
        return self.type in REAL_TYPES and not self.shape


@dataclass(frozen=True, slots=True)
class Capabilities:
    """What the FMU can do. The identifiers are the file names of its binaries, None where the interface is missing.

    Of co-simulation: `variable_step` … `restores_steps` (FMU states can be saved and restored) and `fixed_internal_step` [s]. Of model
    exchange: `completed_steps` (it wants to know of each accepted integrator step) and, in FMI 2.0, the number of `event_indicators`.
    """

    co_simulation: str | None = None
    model_exchange: str | None = None
    variable_step: bool = False
    interpolates_inputs: bool = False
    directional_derivatives: bool = False
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
    states: tuple[tuple[str, str], ...] = ()
    """Name of each continuous state and of its derivative, in the order of the FMU's state vector."""

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

    def find(self, name: str, causality: str | None = None) -> Variable:
        """The variable of that name; `DescriptionError` with the nearest names, or if its causality is another one."""
        for variable in self.variables:
            if variable.name == name:
                break
        else:
            raise DescriptionError(f"{self.model_name} has no variable {name!r}{self._suggestion(name, causality)}")
        if causality is not None and variable.causality != causality:
            raise DescriptionError(
                f"{name!r} of {self.model_name} has causality {variable.causality}, not {causality}{self._suggestion(name, causality)}"
            )
        return variable

    def settable_parameter(self, name: str, driven: str = "") -> Variable:
        """The variable of that name that can be set before the run and keeps its value: a parameter, or an input that is not `driven`."""
        variable = self.find(name)
        if variable.causality != "input" or name == driven:
            variable = self.find(name, "parameter")
        if not variable.is_number:
            raise DescriptionError(f"parameter {name!r} is of type {variable.type}; only single numbers can be set")
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
            raise DescriptionError(f"input {name!r} is of type {variable.type}; a command drives a single real input")
        return variable

    def readable(self, name: str) -> Variable:
        """The variable of that name that can be logged: a single number."""
        variable = self.find(name)
        if not variable.is_number:
            raise DescriptionError(f"{name!r} is of type {variable.type}{list(variable.shape) or ''}; only single numbers can be logged")
        return variable

    def _suggestion(self, name: str, causality: str | None) -> str:
        names = self.names(causality)
        near = difflib.get_close_matches(name, names, n=3, cutoff=0.5)
        what = {None: "variables", "independent": "independent variables"}.get(causality, f"{causality}s")
        if near:
            return "; did you mean " + " or ".join(map(repr, near)) + "?"
        listed = ", ".join(names[:12]) + (", …" if len(names) > 12 else "")
        return f"; its {what} are: {listed}" if names else f"; it has no {what}"


def read_description(xml: bytes) -> Description:
    """Parse and validate a modelDescription.xml (FMI 2.0 or 3.0).

    `DescriptionError` for a DOCTYPE (entities could read files or fill the memory), another FMI version, an FMU for
    scheduled execution only, or anything that the standard's schema refuses.
    """
    intermediate: set[str] = set()
    interfaces = _interfaces(xml, intermediate)
    from fmus.instances import parse_description  # heavy: validation needs the XML schemas

    raw = parse_description(xml)
    own = interfaces.get("ModelExchange", {})
    # The FMI 3 attribute has a plural "s" that the parser does not know.
    directional = own.get("providesDirectionalDerivative", own.get("providesDirectionalDerivatives", "false"))
    cs, me = raw.coSimulation, raw.modelExchange
    either = cs or me
    if either is None:
        raise DescriptionError(f"{raw.modelName} offers scheduled execution only; Co-Simulation or Model Exchange is needed")
    fixed = _number(cs.fixedInternalStepSize) if cs else None
    capabilities = Capabilities(
        co_simulation=cs.modelIdentifier if cs else None,
        model_exchange=me.modelIdentifier if me else None,
        variable_step=bool(cs and cs.canHandleVariableCommunicationStepSize),
        interpolates_inputs=bool(cs and cs.canInterpolateInputs),
        directional_derivatives=directional in ("true", "1"),
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
    variables = tuple(_variable(v, v.name in intermediate) for v in raw.modelVariables)
    experiment = raw.defaultExperiment
    return Description(
        fmi_version=raw.fmiVersion or "",
        model_name=raw.modelName or "",
        guid=raw.guid or "",
        tool=raw.generationTool or "",
        variables=variables,
        capabilities=capabilities,
        default_step=_number(experiment.stepSize) if experiment else None,
        default_tolerance=_number(experiment.tolerance) if experiment else None,
        units=tuple(_unit(u) for u in raw.unitDefinitions),
        log_categories=tuple(category.name for category in raw.logCategories),
        states=tuple(_states(raw)),
    )


def _states(raw: ModelDescription) -> Iterator[tuple[str, str]]:
    for unknown in raw.derivatives:
        derivative = unknown.variable
        if derivative is None or derivative.derivative is None:
            raise DescriptionError("modelDescription.xml lists a derivative of a continuous state that derives nothing")
        yield derivative.derivative.name, derivative.name


def _unit(raw: RawUnit) -> Unit:
    base = raw.baseUnit
    powers = tuple((symbol, int(getattr(base, symbol, 0))) for symbol in ("kg", "m", "s", "A", "K", "mol", "cd", "rad"))
    factor, offset = float(getattr(base, "factor", 1.0)), float(getattr(base, "offset", 0.0))
    return Unit(raw.name or "", tuple(p for p in powers if p[1]), factor, offset)


def _variable(raw: ModelVariable, intermediate: bool) -> Variable:
    declared = raw.declaredType
    start: float | str | None = raw.start
    if raw.start in ("true", "false"):
        start = float(raw.start == "true")
    elif raw.start is not None and raw.type in NUMBER_TYPES and not raw.shape:
        start = _number(raw.start)
    nominal = _number(raw.nominal) or (_number(declared.nominal) if declared else None)
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
    )


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
    depth = 0

    def refuse(*_: object) -> None:
        raise DescriptionError("modelDescription.xml has a DOCTYPE, which an FMU does not need and which could pull in other files")

    def start(name: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        if depth == 0:
            _check_root(name, attributes)
        elif depth == 1:
            found[name] = attributes
        elif depth == 2 and attributes.get("intermediateUpdate") in ("true", "1"):
            intermediate.add(attributes.get("name", ""))
        depth += 1

    def end(_: str) -> None:
        nonlocal depth
        depth -= 1

    parser = expat.ParserCreate()
    parser.StartDoctypeDeclHandler = refuse
    parser.StartElementHandler = start
    parser.EndElementHandler = end
    try:
        parser.Parse(xml, True)
    except expat.ExpatError as problem:
        raise DescriptionError(f"modelDescription.xml is no well-formed XML: {problem}") from None
    return found


def _check_root(name: str, attributes: dict[str, str]) -> None:
    version = attributes.get("fmiVersion", "")
    if name != "fmiModelDescription":
        raise DescriptionError(f"modelDescription.xml starts with <{name}>, not <fmiModelDescription>")
    if version != "2.0" and not version.startswith("3."):
        raise DescriptionError(f"FMI version {version or 'missing'} is not supported; 2.0 and 3.0 are")
