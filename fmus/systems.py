"""A command or shaper and the plant that it drives as one archive: System Structure and Parameterization (SSP), version 1.0 for FMI 2.0
and 2.0 for FMI 3.0.

SystemStructure.ssd holds the two and what joins them; the shaper's reference is an input that is free. Subsystem.ssd is the same with the
reference and the plant's outputs as connectors of the system itself, for a place inside a larger one (importers exist that know no
connectors of systems). Every FMU starts from its own start values: the command or shaper rests where the plant's input does, so that
nothing needs to be bound.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from fmus.archives import Fmu
from fmus.blocks import Block, Signal
from fmus.descriptions import Description, Unit, Variable
from fmus.errors import BuildError
from fmus.generation import TOOL, base_unit
from fmus.packing import zipped

SSD = "http://ssp-standard.org/SSP1/SystemStructureDescription"
SSC = "http://ssp-standard.org/SSP1/SystemStructureCommon"
FMU_TYPE = "application/x-fmu-sharedlibrary"


def plant_input(description: Description, name: str | None) -> Variable:
    """The input of that name that a command can drive; without a name the plant's only one.

    Raises `BuildError` if there is none or several to choose from, `DescriptionError` for a name that is none.
    """
    if name is not None:
        return description.drivable_input(name)
    real = [v for v in description.variables if v.causality == "input" and v.is_real]
    if len(real) != 1:
        which = ", ".join(v.name for v in real) or "none"
        raise BuildError(f"{description.model_name} has no single real input to drive (its real inputs: {which}): name one with --input")
    return real[0]


def signal_for(description: Description, variable: Variable, name: str) -> Signal:
    """The signal `name` that fits this input: its unit, and as rest the value at which it starts."""
    start = variable.start if isinstance(variable.start, float) else 0.0
    unit = next((u for u in description.units if u.name == variable.unit and u.exponents), None)
    return Signal(name, variable.unit, _base(unit) if unit else None, start)


def system(name: str, block: Block, fmu: bytes, plant: Fmu, driven: Variable) -> bytes:
    """The .ssp of `block` (whose archive is `fmu`, of the plant's FMI version) driving the input `driven` of the plant.

    Raises `BuildError` if the plant has no Co-Simulation, which the coupling needs.
    """
    description, own = plant.description, block.plant.name
    if description.capabilities.co_simulation is None:
        raise BuildError(f"{plant.path.name} offers Model Exchange only; Co-Simulation is needed to couple it")
    other = "plant" if own != "plant" else "driven_plant"
    files = {
        file: _description(name, block, other, description, driven, border=border)
        for file, border in (("SystemStructure.ssd", False), ("Subsystem.ssd", True))
    }
    return zipped({**files, f"resources/{own}.fmu": fmu, f"resources/{other}.fmu": plant.path.read_bytes()})


def _description(name: str, block: Block, other: str, plant: Description, driven: Variable, *, border: bool) -> bytes:
    own = block.plant.name
    references = [_Port(v.name, "input", v.unit) for v in block.plant.of_kind("input")]
    (output,) = (_Port(v.name, "output", v.unit) for v in block.plant.of_kind("output"))
    actuated = _Port(driven.name, "input", driven.unit)
    observed = [_Port(v.name, "output", v.unit) for v in plant.variables if v.causality == "output" and v.is_real]
    components = {own: [*references, output], other: [actuated, *observed]}
    links = [(own, output.name, other, actuated.name)]
    outside: list[_Port] = []
    if border:
        taken = {port.name for port in references}  # at the border an output that is called like the reference gives way
        names = {port.name: f"{other}.{port.name}" if port.name in taken else port.name for port in observed}
        outside = [*references, *(_Port(names[port.name], "output", port.unit) for port in observed)]
        links += [("", port.name, own, port.name) for port in references]
        links += [(other, port.name, "", names[port.name]) for port in observed]
    units = {u.name: u for u in plant.units if u.exponents}
    of_fmi_2 = plant.major == 2

    def connectors(parent: Element, ports: Sequence[_Port]) -> None:
        listed = SubElement(parent, f"{{{SSD}}}Connectors")
        for port in ports:
            connector = SubElement(listed, f"{{{SSD}}}Connector", name=port.name, kind=port.kind)
            SubElement(connector, f"{{{SSC}}}{'Real' if of_fmi_2 else 'Float64'}", {"unit": port.unit} if port.unit in units else {})

    root = Element(f"{{{SSD}}}SystemStructureDescription", version="1.0" if of_fmi_2 else "2.0", name=name, generationTool=TOOL)
    top = SubElement(root, f"{{{SSD}}}System", name=name)
    if outside:
        connectors(top, outside)
    elements = SubElement(top, f"{{{SSD}}}Elements")
    for element, ports in components.items():
        attributes = {"name": element, "type": FMU_TYPE, "source": f"resources/{element}.fmu", "implementation": "CoSimulation"}
        connectors(SubElement(elements, f"{{{SSD}}}Component", attributes), ports)
    connections = SubElement(top, f"{{{SSD}}}Connections")
    for link in links:
        ends = zip(("startElement", "startConnector", "endElement", "endConnector"), link, strict=True)
        SubElement(connections, f"{{{SSD}}}Connection", {key: value for key, value in ends if value})
    if used := sorted({port.unit for ports in components.values() for port in ports} & units.keys()):
        listed = SubElement(root, f"{{{SSD}}}Units")
        for unit in used:
            SubElement(SubElement(listed, f"{{{SSC}}}Unit", name=unit), f"{{{SSC}}}BaseUnit", base_unit(_base(units[unit])))
    SubElement(root, f"{{{SSD}}}DefaultExperiment", startTime="0.0", stopTime=repr(block.plant.stop))
    ElementTree.register_namespace("ssd", SSD)
    ElementTree.register_namespace("ssc", SSC)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n"


@dataclass(frozen=True, slots=True)
class _Port:
    name: str
    kind: str
    unit: str


def _base(unit: Unit) -> dict[str, float]:
    parts: dict[str, float] = dict(unit.exponents)
    return parts | ({"factor": unit.factor} if unit.factor != 1.0 else {}) | ({"offset": unit.offset} if unit.offset else {})
