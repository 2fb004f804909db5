"""Size and instructions of the exported C header on a Cortex-M4.

    python benchmarks/firmware.py [--write]

needs ``arm-none-eabi-gcc`` with newlib, and ``qemu-arm``, which runs the functions and counts their instructions.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from importlib import import_module
from pathlib import Path

import numpy as np
from reporting import write_between

from drive_id.exchange.exports.exporting import content_of
from drive_id.exchange.exports.options import ExportOptions
from drive_id.fitting.result import Identification

_PAGE = Path(__file__).parent.parent / "docs" / "engineering" / "control_measured.md"
_POINTS = 21
_FLAGS = ["-mcpu=cortex-m4", "-mthumb", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard", "-std=c99", "-Os"]
_CALLS = 64
_CYCLES = (1.0, 2.0)
"""Cycles per instruction of a Cortex-M4 without wait states: loads take two, divisions 14, most others one."""
FUNCTIONS = {
    "drive_id_psi_d": "drive_id_psi_d(d, q)",
    "drive_id_psi_d_bicubic": "drive_id_psi_d_bicubic(d, q)",
    "drive_id_kp_d": "drive_id_kp_d(d, q)",
    "drive_id_feedforward": "(drive_id_feedforward(d, q, 200.0f, 0.1f, u), u[0])",
    "drive_id_drop": "drive_id_drop(d)",
    "drive_id_active_flux": "drive_id_active_flux(d, q)",
    "drive_id_inside": "(float)drive_id_inside(d, q)",
}


def main() -> None:
    """Print the table, and write it if wanted."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help="write it into docs/engineering/control_measured.md")
    text = measured(_example())
    if parser.parse_args().write:
        write_between(_PAGE, "benchmarks/firmware.py", text)
    print(text)


def measured(result: Identification) -> str:
    """Return a table of code size (bytes) and instructions per call of each function."""
    axis = np.linspace(-result.i_max, result.i_max, _POINTS)
    options = ExportOptions(axis, axis, bandwidth=950.0, sample_period=1e-4)
    header, _ = content_of(result, "c-header", options)
    lines = ["| function | code, bytes | instructions per call | cycles, about |", "|---|---:|---:|---:|"]
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        (folder / "map.h").write_bytes(header)
        empty = _run(folder, "0.0f")
        for name, call in FUNCTIONS.items():
            size = _code(folder, call) - _code(folder, "0.0f")
            count = (_run(folder, call) - empty) / _CALLS
            low, high = (round(count * factor) for factor in _CYCLES)
            lines.append(f"| `{name}` | {size} | {count:.0f} | {low} to {high} |")
    points = _POINTS**2
    lines += ["", f"Constants: each map {4 * points} bytes, each gain in 16 bits {2 * points}, the mask {points}."]
    return "\n".join(lines)


def _example() -> Identification:
    sys.path.insert(0, str(Path(__file__).parent.parent / "test" / "support"))  # where an exact machine is
    found: Identification = import_module("exchange_machine").result(drop=lambda i: 2.5 * np.tanh(i / 0.8))
    return found


def _program(call: str) -> str:
    return f"""#include "map.h"
float called(float d, float q, float *u);
float called(float d, float q, float *u) {{ (void)d; (void)q; (void)u; return {call}; }}
volatile float sink;
void _start(void)
{{
    float u[2];
    int k;
    for (k = 0; k < {_CALLS}; k++) {{
        sink = called(0.3f * (float)k - 14.0f, 9.0f - 0.25f * (float)k, u);
    }}
    __asm__ volatile("movs r0, #0; movs r7, #1; svc 0"); /* leave, for the emulator */
}}
"""


def _code(folder: Path, call: str) -> int:
    """Return the bytes of code of a program that holds one function."""
    (folder / "code.c").write_text(_program(call))
    _tool(folder, "arm-none-eabi-gcc", *_FLAGS, "-c", "code.c", "-o", "code.o")
    text = _tool(folder, "arm-none-eabi-size", "-A", "code.o")
    return sum(int(line.split()[1]) for line in text.splitlines() if line.startswith(".text"))


def _run(folder: Path, call: str) -> int:
    """Return how many instructions the program executes."""
    (folder / "run.c").write_text(_program(call))
    _tool(folder, "arm-none-eabi-gcc", *_FLAGS, "-nostartfiles", "--specs=nosys.specs", "run.c", "-o", "run.elf", "-lm")
    _tool(folder, "qemu-arm", "-cpu", "cortex-a15", "-singlestep", "-d", "nochain,exec", "-D", "log", "run.elf")
    return (folder / "log").read_text().count("Trace ")


def _tool(folder: Path, *command: str) -> str:
    try:
        return subprocess.run(command, cwd=folder, check=True, stdout=subprocess.PIPE, text=True).stdout
    except FileNotFoundError as error:
        needed = "gcc-arm-none-eabi, libnewlib-arm-none-eabi and qemu-user"
        raise SystemExit(f"{command[0]} is missing: install {needed}.") from error


if __name__ == "__main__":
    main()
