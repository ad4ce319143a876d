"""What is generated from a plant.toml: the C header and the model descriptions of FMI 2.0 and FMI 3.0."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import groupby
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from fmus.plant_files import Kind, PlantFile, PlantVariable

TOOL = "slewcert"
LOG_CATEGORIES = ("logAll", "logStatusWarning", "logStatusDiscard", "logStatusError", "logStatusFatal")
CAUSALITY: dict[Kind, str] = {
    "time": "independent",
    "parameter": "parameter",
    "input": "input",
    "state": "local",
    "derivative": "local",
    "output": "output",
}


def c_header(plant: PlantFile, token: str) -> str:
    """variables.h: the struct `Plant`, the counts, start values, and the token that ties the library to its description."""
    kinds: tuple[tuple[Kind, str], ...] = (
        ("parameter", "PARAMETER"),
        ("input", "INPUT"),
        ("state", "STATE"),
        ("derivative", "DERIVATIVE"),
        ("output", "OUTPUT"),
    )
    lines = [
        "/* Generated. */",
        "#ifndef VARIABLES_H",
        "#define VARIABLES_H",
        "",
        f"#define PLANT_PREFIX {plant.name}_",
        f'#define PLANT_TOKEN "{token}"',
        f"#define PLANT_HAS_TANGENT {int(plant.tangent)}",
        f"#define PLANT_HAS_STEP_HOOK {int(plant.step_hook)}",
        f"#define PLANT_HAS_EVENTS {int(plant.events)}",
        f"#define PLANT_OUTPUTS_BEFORE {int(plant.outputs_before)}",
        f"#define PLANT_VARIABLES {len(plant.variables)}",
        f"#define PLANT_INPUT_DERIVATIVES {plant.input_derivatives}",
        *([f"#define {plant.size.name.upper()} {plant.size.value}"] if plant.size else []),
    ]
    first = 1
    for kind, word in kinds:
        count = len(plant.of_kind(kind))
        if kind != "derivative":
            lines.append(f"#define PLANT_{word}S {count}")
        lines.append(f"#define PLANT_FIRST_{word} {first}")
        first += count
    lines += ["", *([f'#include "{plant.memory}"', ""] if plant.memory else [])]
    lines += ["typedef union {", "    double value[PLANT_VARIABLES];", "    struct {"]
    for field, group in groupby(plant.variables, key=lambda v: v.field):
        members = tuple(group)
        lines.append(f"        double {field}{f'[{len(members)}]' if members[0].array else ''}; /* {members[0].unit} */")
    lines += ["        int before;"] * plant.events + ["        Memory memory;"] * bool(plant.memory)
    lines += ["    };", "} Plant;", ""]
    arrays = {
        "double PLANT_START[PLANT_VARIABLES]": [repr(v.start or 0.0) for v in plant.variables],
        "double PLANT_NOMINAL[PLANT_STATES + !PLANT_STATES]": [repr(v.nominal or 1.0) for v in plant.of_kind("state")] or ["1.0"],
        "char PLANT_POSITIVE[PLANT_VARIABLES]": [str(int(v.positive)) for v in plant.variables],
        "char PLANT_BOOLEAN[PLANT_VARIABLES]": [str(int(v.boolean)) for v in plant.variables],
        "char *const PLANT_NAMES[PLANT_VARIABLES]": [f'"{v.name}"' for v in plant.variables],
    }
    # Not every source file uses every table.
    lines += ["#ifdef __GNUC__", "#define UNUSED __attribute__((unused))", "#else", "#define UNUSED", "#endif", ""]
    lines += [f"UNUSED static const {name} = {{{', '.join(values)}}};" for name, values in arrays.items()]
    return "\n".join([*lines, "", "#endif", ""])


def model_description_2(plant: PlantFile, token: str, sources: tuple[str, ...]) -> bytes:
    """modelDescription.xml of FMI 2.0; `sources` are the C files to compile."""
    head = {"fmiVersion": "2.0", "modelName": plant.title, "guid": token, **_about(plant), "numberOfEventIndicators": "0"}
    root = Element("fmiModelDescription", head)
    for interface in plant.interfaces:
        flags = {"canNotUseMemoryManagementFunctions": "true", "canGetAndSetFMUstate": "true", "canSerializeFMUstate": "true"}
        flags["providesDirectionalDerivative"] = _flag(plant.tangent)
        if interface == "ModelExchange":
            flags["completedIntegratorStepNotNeeded"] = _flag(not plant.step_hook)
        else:
            flags["canHandleVariableCommunicationStepSize"] = _flag(plant.variable_step)
            flags["canInterpolateInputs"] = _flag(bool(plant.of_kind("input")))
        files = SubElement(SubElement(root, interface, {"modelIdentifier": plant.name, **flags}), "SourceFiles")
        for source in sources:
            SubElement(files, "File", name=source)
    _common(root, plant)
    variables = SubElement(root, "ModelVariables")
    for v in plant.variables:
        numbers = _numbers(v)
        if v.state is not None:
            numbers["derivative"] = str(v.state + 1)  # FMI 2.0 counts variables from 1; here reference = position
        SubElement(SubElement(variables, "ScalarVariable", _attributes(v)), "Boolean" if v.boolean else "Real", numbers)
    structure = SubElement(root, "ModelStructure")
    for group, members in _structure(plant):
        parent = SubElement(structure, group + "s") if members else structure
        for v in members:
            SubElement(parent, "Unknown", {"index": str(v.reference + 1), **_dependencies(v, group, offset=1)})
    return _document(root)


def model_description_3(plant: PlantFile, token: str) -> bytes:
    """modelDescription.xml of FMI 3.0."""
    head = {"fmiVersion": "3.0", "modelName": plant.title, "instantiationToken": token, **_about(plant)}
    root = Element("fmiModelDescription", head)
    for interface in plant.interfaces:
        flags = {"canGetAndSetFMUState": "true", "canSerializeFMUState": "true"}
        flags["providesDirectionalDerivatives"] = flags["providesAdjointDerivatives"] = _flag(plant.tangent)
        if interface == "ModelExchange":
            flags["needsCompletedIntegratorStep"] = _flag(plant.step_hook)
        else:
            flags["providesIntermediateUpdate"] = _flag(plant.asks)
            flags["canHandleVariableCommunicationStepSize"] = _flag(plant.variable_step)
            if not plant.variable_step:
                flags["fixedInternalStepSize"] = repr(plant.step)
            if plant.events:
                flags["hasEventMode"] = "true"
        SubElement(root, interface, {"modelIdentifier": plant.name, **flags})
    _common(root, plant)
    variables = SubElement(root, "ModelVariables")
    for v in plant.variables:
        more = {} if v.state is None else {"derivative": str(v.state)}
        if v.kind == "input" and plant.asks:
            more["intermediateUpdate"] = "true"
        SubElement(variables, "Boolean" if v.boolean else "Float64", {**_attributes(v), **_numbers(v), **more})
    structure = SubElement(root, "ModelStructure")
    for group, members in _structure(plant):
        element = "ContinuousStateDerivative" if group == "Derivative" else group
        for v in members:
            SubElement(structure, element, {"valueReference": str(v.reference), **_dependencies(v, group, offset=0)})
    return _document(root)


def build_description_3(plant: PlantFile, sources: tuple[str, ...]) -> bytes:
    """sources/buildDescription.xml of FMI 3.0."""
    root = Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = SubElement(root, "BuildConfiguration", modelIdentifier=plant.name)
    files = SubElement(configuration, "SourceFileSet", language="C11")
    for source in sources:
        SubElement(files, "SourceFile", name=source)
    return _document(root)


def _about(plant: PlantFile) -> dict[str, str]:
    # No generationDateAndTime: the same sources give the same bytes.
    return {
        "description": plant.description,
        "version": plant.version,
        "generationTool": TOOL,
        "variableNamingConvention": "structured",
    }


def _common(root: Element, plant: PlantFile) -> None:
    units = SubElement(root, "UnitDefinitions")
    for name in sorted(plant.units):
        unit = SubElement(units, "Unit", name=name)
        if (exponents := plant.units[name]) is not None:
            SubElement(unit, "BaseUnit", base_unit(exponents))
    categories = SubElement(root, "LogCategories")
    for category in LOG_CATEGORIES:
        SubElement(categories, "Category", name=category)
    SubElement(root, "DefaultExperiment", startTime="0", stopTime=repr(plant.stop), stepSize=repr(plant.step))


def base_unit(numbers: Mapping[str, float]) -> dict[str, str]:
    """Exponents of the SI base units, factor and offset, as XML has them: whole numbers without a point, others with every digit."""
    return {key: str(int(x)) if x == int(x) else repr(float(x)) for key, x in numbers.items()}


def _attributes(v: PlantVariable) -> dict[str, str]:
    causality = "output" if v.is_output else CAUSALITY[v.kind]
    attributes = {"name": v.name, "valueReference": str(v.reference), "description": v.description, "causality": causality}
    attributes["variability"] = "fixed" if v.kind == "parameter" else "continuous"
    if v.kind in ("parameter", "state"):
        attributes["initial"] = "exact"
    elif v.kind in ("derivative", "output"):
        attributes["initial"] = "calculated"
    return attributes


def _numbers(v: PlantVariable) -> dict[str, str]:
    if v.boolean:
        return {"start": _flag(bool(v.start))}
    numbers = {"unit": v.unit} if v.unit else {}
    if v.positive:
        numbers["min"] = "0"
    if v.nominal is not None and v.nominal != 1.0:
        numbers["nominal"] = repr(v.nominal)
    if v.start is not None:
        numbers["start"] = repr(v.start)
    return numbers


def _structure(plant: PlantFile) -> tuple[tuple[str, tuple[PlantVariable, ...]], ...]:
    derivatives = plant.of_kind("derivative")
    return (
        ("Output", tuple(v for v in plant.variables if v.is_output)),
        ("Derivative", derivatives),
        ("InitialUnknown", (*derivatives, *plant.of_kind("output"))),
    )


def _dependencies(v: PlantVariable, group: str, offset: int) -> dict[str, str]:
    # At initialisation, unknowns depend on parameters too: the attribute is left out there, which means "on everything".
    if v.depends is None or group == "InitialUnknown":
        return {}
    return {"dependencies": " ".join(str(r + offset) for r in v.depends)}


def _flag(value: bool) -> str:
    return "true" if value else "false"


def _document(root: Element) -> bytes:
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n"
