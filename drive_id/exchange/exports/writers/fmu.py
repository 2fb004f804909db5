"""FMU: the identified drive as C code, compiled, for FMI 2.0 and 3.0 (model exchange and co-simulation)."""

from __future__ import annotations

import hashlib
import io
import math
import platform
import shutil
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree as ET

import numpy as np

from drive_id.analysis.machine import MachineModel, halved
from drive_id.errors import ConfigurationError
from drive_id.exchange.exports.current_control import CurrentControl, cubic, divided
from drive_id.exchange.exports.options import ExportOptions
from drive_id.exchange.exports.table import MapTable
from drive_id.exchange.exports.writers import c_header
from drive_id.types import FloatArray

_FOLDER = Path(__file__).with_name("fmu")
_STEP = 1e-5  # largest step of the solver inside, s: a fifth of what the steepest inverter curves allow
_BEYOND = 1.5  # reach of the tables, in i_max: what overshoots of a controller reach
_ACCURATE = 5e-4  # error of a current by interpolation along both axes, in i_max, from which on tables are refined
_PARTS = 4  # of an interval between two points, between which errors are computed: in the middle alone, some cancel
_MOST_POINTS = 321  # of an axis that is refined: the sources then take 3 MB
_DATE = (1980, 1, 1, 0, 0, 0)  # of all files in the archive, so that equal models are equal files
_MACHINES = {"x86_64": "x86_64", "amd64": "x86_64", "aarch64": "aarch64", "arm64": "aarch64"}
_SYSTEMS = {"linux": ("linux", ".so"), "darwin": ("darwin", ".dylib"), "win32": ("windows", ".dll")}
_LONGEST_COMPILATION = 300.0  # s


class _Variable(NamedTuple):
    """A real number of the model; its place in the list is its value reference."""

    name: str
    causality: str
    unit: str
    description: str
    start: float | None = None


def _variables(resistance: float, celsius: float) -> list[_Variable]:
    inputs = [("u_a", "phase a"), ("u_b", "phase b"), ("u_c", "phase c"), ("u_d", "d axis"), ("u_q", "q axis")]
    return [
        _Variable("time", "independent", "s", "time"),
        *(_Variable(name, "input", "V", f"voltage, {axis}; phase and dq voltages add", 0.0) for name, axis in inputs),
        _Variable("speed", "input", "rad/s", "mechanical speed", 0.0),
        *(_Variable(f"i_{phase}", "output", "A", f"current, phase {phase}") for phase in "abc"),
        _Variable("i_d", "output", "A", "current, d axis", 0.0),
        _Variable("i_q", "output", "A", "current, q axis", 0.0),
        _Variable("angle", "output", "rad", "electrical angle of the d axis from phase a", 0.0),
        _Variable("torque", "output", "N.m", "3/2 p (psi_d i_q - psi_q i_d)"),
        _Variable("psi_d", "output", "Wb", "flux linkage, d axis"),
        _Variable("psi_q", "output", "Wb", "flux linkage, q axis"),
        _Variable("inside", "output", "", "1 where the map rests on data"),
        *(_Variable(f"der_{name}", "local", "", f"derivative of {name}") for name in ("i_d", "i_q", "angle")),
        _Variable("resistance", "parameter", "Ohm", "of a phase at the temperature of the experiment", resistance),
        _Variable("winding_temperature", "parameter", "degC", "R follows copper", celsius),
        _Variable("magnet_temperature", "parameter", "degC", "psi_d follows the coefficient, if identified", 20.0),
        _Variable("inverter", "parameter", "", "factor on the inverter's drop; 0: ideal inverter", 1.0),
        _Variable("step", "parameter", "s", "largest step of the solver inside", _STEP),
    ]


def write(table: MapTable, options: ExportOptions, version: int = 3) -> bytes:
    """Write an FMU of FMI 2.0 or 3.0: description, sources, and a library for this computer where it has a C compiler.

    The map is continued where there are no data; its harmonics and the iron loss are not included.

    Raises ConfigurationError when pole pairs or resistance are unknown, or the compiler fails.
    """
    table.machine.known_pole_pairs()
    held = table.result.provenance.temperature
    variables = _variables(table.known_resistance(), 20.0 if held is None else held)
    table, machine = _finer(table), table.machine
    slopes = machine.inductances(*table.grid)
    gains = {"d": slopes[..., 0, 0], "q": slopes[..., 1, 1]}  # which the model does not read
    count = len(table.i_d), len(table.i_q)
    control = CurrentControl(table, options.rate, gains, math.nan, math.nan, 0.0, 0, count)
    header = c_header.header(control, options, machine.inverter_current, machine.inverter_voltage).decode("ascii")
    code = {name: (_FOLDER / name).read_text(encoding="ascii") for name in ("model.h", "fmi.h", f"fmi{version}.c")}
    listed = _listed(variables)
    token = hashlib.sha256("".join([header, listed, *code.values()]).encode()).hexdigest()[:32]
    guid = f"{token[:8]}-{token[8:12]}-{token[12:16]}-{token[16:20]}-{token[20:]}"
    code |= {"map.h": header, "variables.h": f'{listed}#define TOKEN "{guid}"\n'}
    files = {f"sources/{name}": text.encode("ascii") for name, text in code.items()}
    files["modelDescription.xml"] = _xml(_description(table, variables, guid, version))
    if version == 3:
        files["sources/buildDescription.xml"] = _xml(_build_description())
    library = _library(code, version)
    if library is not None:
        files[library[0]] = library[1]
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            archive.writestr(zipfile.ZipInfo(name, _DATE), content, zipfile.ZIP_DEFLATED)
    return stream.getvalue()


def _finer(table: MapTable) -> MapTable:
    """Return the table on axes that reach 1.5 i_max or the data, with points as dense as its interpolation needs."""
    machine, known = table.machine, table.machine.flux_map
    rows = np.nonzero(known.inside)
    i_d, i_q = (
        _reaching(axis, max(_BEYOND * machine.i_max, float(np.abs(own[at]).max())))
        for axis, own, at in zip((table.i_d, table.i_q), (known.i_d, known.i_q), rows, strict=True)
    )
    while True:
        errors = [error / machine.i_max for error in current_errors(machine, i_d, i_q)]
        finer = [halved(axis, error > _ACCURATE / 2) for axis, error in zip((i_d, i_q), errors, strict=True)]
        if (len(finer[0]), len(finer[1])) == (len(i_d), len(i_q)):
            return table.on(i_d, i_q)
        if max(map(len, finer)) > _MOST_POINTS:
            table.remarks.append(
                f"Between the points of the FMU's tables, currents err by up to {sum(e.max() for e in errors):.1g} of "
                "i_max: the map changes too much there for more points."
            )
            return table.on(i_d, i_q)
        i_d, i_q = finer


def _reaching(axis: FloatArray, reach: float) -> FloatArray:
    """Return an axis with further points at its ends, up to both -reach and reach."""
    low, *_, high = np.diff(axis).tolist()
    before, after = (math.ceil(max(0.0, reach - x) / s - 1e-9) for x, s in ((-axis[0], low), (axis[-1], high)))
    return np.concatenate([axis[0] - low * np.arange(before, 0, -1), axis, axis[-1] + high * np.arange(1, after + 1)])


def current_errors(machine: MachineModel, i_d: FloatArray, i_q: FloatArray) -> list[FloatArray]:
    """Return the largest errors of a current by interpolation between points (D,), (Q,), A, along each of both axes.

    They are those in each interval of an axis, (D - 1,) and (Q - 1,), for the flux of a current up to 1.5 i_max or
    within the data; those of bicubic interpolation are about the sum of both.
    """
    out = []
    for axis, (own, other) in enumerate(((i_d, i_q), (i_q, i_d))):
        fine = divided(own, _PARTS)
        at = np.meshgrid(fine, other, indexing="ij")[:: 1 - 2 * axis]
        nodes = np.meshgrid(own, other, indexing="ij")[:: 1 - 2 * axis]
        fluxes = zip(machine.psi_dq(*at), machine.psi_dq(*nodes), strict=True)
        away = np.stack([cubic(own, known, fine) - true for true, known in fluxes], axis=-1)
        error = np.abs(np.linalg.solve(machine.inductances(*at), away[..., None]))[..., 0].max(axis=-1)
        counted = machine.inside(*at) | (np.hypot(*at) <= _BEYOND * machine.i_max)
        along = np.where(counted, error, 0.0).max(axis=1)
        out.append(along[:-1].reshape(-1, _PARTS).max(axis=1))  # at the points themselves there is none
    return out


def _listed(variables: list[_Variable]) -> str:
    """Return the variables as C: names, starts, and which of them may be set."""
    names = ", ".join(variable.name.upper() for variable in variables)
    starts = ", ".join(f"{variable.start or 0.0!r}" for variable in variables)
    settable = ", ".join(str(int(variable.start is not None)) for variable in variables)
    return (
        f"enum {{ {names}, VARIABLES }};\n"
        f"static const double starts[VARIABLES] = {{ {starts} }};\n"
        f"static const unsigned char settable[VARIABLES] = {{ {settable} }};\n"
    )


def _library(code: dict[str, str], version: int) -> tuple[str, bytes] | None:
    """Return place and content of the compiled library; None without a compiler or a name for this platform.

    Raises ConfigurationError when the compiler fails.
    """
    compiler = next(filter(None, map(shutil.which, ("cc", "gcc", "clang"))), None)
    system, suffix = _SYSTEMS.get(sys.platform, ("", ""))
    machine = _MACHINES.get(platform.machine().lower(), "")
    if version == 2:  # which names 64 bits of one architecture only
        place = {"linux": "linux64", "darwin": "darwin64", "windows": "win64"}.get(system, "")
        place = place if machine == "x86_64" else ""
    else:
        place = f"{machine}-{system}" if machine and system else ""
    if not (compiler and place):
        return None
    with tempfile.TemporaryDirectory() as folder:
        for name, text in code.items():
            Path(folder, name).write_text(text, encoding="ascii")
        flags = ["-std=c99", "-O2", "-fPIC", "-shared", "-fvisibility=hidden"]
        command = [compiler, *flags, f"fmi{version}.c", "-o", f"drive{suffix}", "-lm"]
        try:
            subprocess.run(command, cwd=folder, check=True, capture_output=True, timeout=_LONGEST_COMPILATION)
        except (OSError, subprocess.SubprocessError) as error:
            raise ConfigurationError(f"The C compiler {compiler} fails on the FMU ({error}): check it.") from error
        return f"binaries/{place}/drive{suffix}", Path(folder, f"drive{suffix}").read_bytes()


_STATES = ("i_d", "i_q", "angle")
_INTERFACES = {"ModelExchange": {}, "CoSimulation": {"canHandleVariableCommunicationStepSize": "true"}}
_UNITS = {
    "s": {"s": "1"},
    "V": {"kg": "1", "m": "2", "s": "-3", "A": "-1"},
    "A": {"A": "1"},
    "rad": {"rad": "1"},
    "rad/s": {"s": "-1", "rad": "1"},
    "N.m": {"kg": "1", "m": "2", "s": "-2"},
    "Wb": {"kg": "1", "m": "2", "s": "-2", "A": "-1"},
    "Ohm": {"kg": "1", "m": "2", "s": "-3", "A": "-2"},
    "degC": {"K": "1", "offset": "273.15"},
}


def _description(table: MapTable, variables: list[_Variable], guid: str, version: int) -> ET.Element:
    """Return the description of the model; where both versions tell the same, it differs in names and nesting."""
    old = version == 2
    root = ET.Element(
        "fmiModelDescription",
        {
            "fmiVersion": f"{version}.0",
            "modelName": "".join(c if c.isprintable() else " " for c in table.result.machine) or "drive",
            "guid" if old else "instantiationToken": guid,
            "description": table.source,
            "generationTool": "drive_id",
            "variableNamingConvention": "flat",
        },
    )
    if old:
        root.set("numberOfEventIndicators", "0")
    state = "state" if old else "State"
    handles = {f"canGetAndSetFMU{state}": "true", f"canSerializeFMU{state}": "true"}
    for kind, more in _INTERFACES.items():
        interface = ET.SubElement(root, kind, {"modelIdentifier": "drive"} | more | handles)
        if old:
            ET.SubElement(ET.SubElement(interface, "SourceFiles"), "File", name="fmi2.c")
    units = ET.SubElement(root, "UnitDefinitions")
    for name, powers in _UNITS.items():
        ET.SubElement(ET.SubElement(units, "Unit", name=name), "BaseUnit", powers)
    listed = ET.SubElement(root, "ModelVariables")
    first = 1 if old else 0  # number of the first variable
    for number, variable in enumerate(variables):
        attributes, value = _attributes(number, variable), {"unit": variable.unit} if variable.unit else {}
        value |= {} if variable.start is None else {"start": repr(variable.start)}
        if old:
            real = ET.SubElement(ET.SubElement(listed, "ScalarVariable", attributes), "Real", value)
        else:
            real = ET.SubElement(listed, "Float64", attributes | value)
        if variable.name.startswith("der_"):
            real.set("derivative", str(first + _place(variables, variable.name[4:])))
    structure = ET.SubElement(root, "ModelStructure")
    for kind, numbers in _structure(variables).items():
        group = ET.SubElement(structure, f"{kind}s") if old else structure
        name = "Unknown" if old else {"Derivative": "ContinuousStateDerivative"}.get(kind, kind)
        for number in numbers:
            ET.SubElement(group, name, {"index" if old else "valueReference": str(first + number)})
    return root


def _place(variables: list[_Variable], name: str) -> int:
    return [variable.name for variable in variables].index(name)


def _structure(variables: list[_Variable]) -> dict[str, list[int]]:
    """Return the numbers of outputs, derivatives and what is computed at the start."""
    outputs = [k for k, variable in enumerate(variables) if variable.causality == "output"]
    derivatives = [_place(variables, f"der_{state}") for state in _STATES]
    computed = [k for k in outputs if variables[k].start is None]
    return {"Output": outputs, "Derivative": derivatives, "InitialUnknown": sorted(computed + derivatives)}


def _attributes(number: int, variable: _Variable) -> dict[str, str]:
    out = {"name": variable.name, "valueReference": str(number), "description": variable.description}
    out["causality"] = variable.causality
    out["variability"] = "tunable" if variable.causality == "parameter" else "continuous"
    if (variable.causality == "output" and variable.start is not None) or variable.causality == "parameter":
        out["initial"] = "exact"
    return out


def _build_description() -> ET.Element:
    root = ET.Element("fmiBuildDescription", fmiVersion="3.0")
    build = ET.SubElement(root, "BuildConfiguration", modelIdentifier="drive")
    sources = ET.SubElement(build, "SourceFileSet", language="C99")
    ET.SubElement(sources, "SourceFile", name="fmi3.c")
    ET.SubElement(build, "Library", name="m", external="true")
    return root


def _xml(root: ET.Element) -> bytes:
    ET.indent(root)
    return b'<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="unicode").encode() + b"\n"
