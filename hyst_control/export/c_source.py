# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""C99 source of a program: one header and one source file, from the C that its filters bring (`chain.c_code`).

Numbers are hexadecimal literals, and every expression has the order of the Python kernels, so that a compiler that does not contract
expressions (`-ffp-contract=off`) gives the same bits in double.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from hyst_control.base.errors import InputError
from hyst_control.chain.c_code.c_code import CCode, Member
from hyst_control.export.c_text import c_comment, c_identifier, c_identifiers

REALS = ("double", "float")

DEVIATIONS = (
    "Rules of MISRA C:2012 that are not kept, all of them advisory but 10.6:",
    "2.4, 2.5    enumerations without a tag name sizes; a macro may be there for a filter that is not",
    "8.7, 8.9    the interface is for other files; constants stand together",
    "10.6        cppcheck takes (a < b) ? 1 : 0 for a composite expression",
    "12.1, 15.4  conditional expressions without further parentheses; a search ends where it has found",
    "20.10       M(fabs) names the function of the chosen type",
)

MATH = re.compile(r"\bM\((\w+)\)|\b(pow|exp|expm1|log1p|sin|cos|tanh|fabs|ceil|floor|sqrt)\(")
"""Functions of math.h: of the type of the signals, or of double."""
EXACT_MATH = ("fabs", "rint", "sqrt", "floor", "ceil")  # Functions of math.h that give the same bits on every machine


@dataclass(frozen=True)
class Slot:
    """One number that goes in or comes out."""

    name: str  # Such as `reference_x`
    text: str  # Unit and meaning


@dataclass(frozen=True)
class Program:
    """A filter to be written as C, with its inputs and outputs."""

    name: str  # From which the prefix of everything in C is made
    code: CCode  # C of the filter
    axes: int  # Number of axes
    inputs: tuple[Slot, ...]
    outputs: tuple[Slot, ...]
    sample_time: float  # S, between two steps
    facts: tuple[str, ...]  # Lines for the header's comment
    real: str = "double"  # Type of the signals where nothing else is defined, "double" or "float"

    def __post_init__(self) -> None:
        if self.real not in REALS:
            raise InputError(f"real: {self.real!r} is not one of {', '.join(REALS)}")
        object.__setattr__(self, "name", c_identifier(self.name))
        for unit in _units(self):
            _check_numbers(unit.code, self.real)

    @property
    def exact(self) -> bool:
        """True where double gives the same bits on every machine: nothing of math.h that may differ between libraries."""
        used = {name for unit in _units(self) for text in (unit.code.step, unit.code.settle, *unit.code.functions)
                for found in MATH.findall(text) for name in found if name}  # fmt: skip
        return used <= set(EXACT_MATH)


@dataclass(frozen=True)
class Unit:
    """One filter of a program, with the names that it has in C."""

    name: str
    code: CCode
    parts: tuple[Unit, ...]

    @property
    def has_state(self) -> bool:
        """True where it, or a part of it, has a state."""
        return bool(self.code.state) or any(part.has_state for part in self.parts)


def header(program: Program) -> str:
    """Text of the header."""
    name, upper = program.name, program.name.upper()
    lines = [
        "/*",
        *(f" * {c_comment(fact)}".rstrip() for fact in program.facts),
        " *",
        f" * {name}_init(state)                    at rest with inputs of 0",
        f" * {name}_settle(state, in, out)         at rest with these inputs, for which all has settled",
        f" * {name}_step(state, in, out)           one tick of {program.sample_time!r} s",
        f" * {name}_block(state, in, out, rows)    as many ticks, row after row",
        " *",
        " * Compile with -ffp-contract=off. The state is plain memory without pointers: a copy of it is a saved state.",
        " *",
        *(f" * {line}" for line in DEVIATIONS),
        " */",
        f"#ifndef {upper}_H",
        f"#define {upper}_H",
        "",
        f"#ifndef {upper}_FLOAT",
        f"#define {upper}_FLOAT {int(program.real == 'float')} /* 1: signals are float, 0: double */",
        "#endif",
        "",
        "#ifdef __cplusplus",
        'extern "C" {',
        "#endif",
        "",
        f"#if {upper}_FLOAT",
        f"typedef float {name}_real;",
        "#else",
        f"typedef double {name}_real;",
        "#endif",
        "",
        f"#define {upper}_SAMPLE_TIME {_hexadecimal(program.sample_time)} /* s */",
        "",
        *_slots(f"{upper}_IN", f"{upper}_INPUTS", program.inputs),
        "",
        *_slots(f"{upper}_OUT", f"{upper}_OUTPUTS", program.outputs),
        "",
    ]
    units = _units(program)
    root = units[-1]
    for unit in units:
        if unit.has_state:
            lines += [*_state(program, unit), ""]
    member = f"    {root.name}_state chain;" if root.has_state else "    int nothing; /* it has no memory */"
    lines += ["typedef struct {", member, f"}} {name}_state;", ""]
    lines += [
        f"void {name}_init({name}_state *state);",
        f"void {name}_settle({name}_state *state, const {name}_real in[], {name}_real out[]);",
        f"void {name}_step({name}_state *state, const {name}_real in[], {name}_real out[]);",
        f"void {name}_block({name}_state *state, const {name}_real in[], {name}_real out[], int rows);",
        "",
        "#ifdef __cplusplus",
        "}",
        "#endif",
        "",
        "#endif",
        "",
    ]
    return "\n".join(lines)


def source(program: Program) -> str:
    """Text of the source file."""
    name, upper = program.name, program.name.upper()
    units = _units(program)
    functions = list(dict.fromkeys(text.strip() for unit in units for text in unit.code.functions))
    texts = "\n".join([*functions, *(text for unit in units for text in (unit.code.step, unit.code.settle))])
    lines = ["/*", *(f" * {c_comment(fact)}".rstrip() for fact in program.facts), " */", f'#include "{name}.h"', ""]
    numbers = "\n".join(_initializer(member) for unit in units for member in unit.code.constants.values())
    if MATH.search(texts) or re.search(r"\b(isnan|isfinite|INFINITY|NAN)\b", texts + numbers):
        lines += ["#include <math.h>", ""]
    lines += [f"typedef {name}_real real;", "", "#define R(value) ((real)(value))"]
    macros = {
        "M": ("M(function)", "function##f", "function"),
        "TINY": ("TINY", "1e-30f", "1e-80"),
        "LAST_DIGIT": ("LAST_DIGIT", "6e-8f", "1e-16"),
        "RESOLUTION": ("RESOLUTION", "2e-7f", "1e-13"),
    }
    chosen = [macro for word, macro in macros.items() if re.search(rf"\b{word}\b", texts)]
    if chosen:
        lines += [f"#if {upper}_FLOAT", *(f"#define {left} {single}" for left, single, _ in chosen), "#else"]
        lines += [*(f"#define {left} {double}" for left, _, double in chosen), "#endif"]
    lines.append("")
    for text in functions:
        lines += [text, ""]
    for unit in units:
        lines += [*_constants(unit), *_work(program, unit)]
    root = units[-1]
    pointer = "&state->chain, " if root.has_state else ""
    unused = [] if root.has_state else ["    (void)state;"]
    width = f"{upper}_INPUTS", f"{upper}_OUTPUTS"
    lines += [
        f"void {name}_settle({name}_state *state, const {name}_real in[], {name}_real out[])",
        "{",
        *unused,
        f"    {root.name}_settle({pointer}in, out);",
        "}",
        "",
        f"void {name}_init({name}_state *state)",
        "{",
        f"    static const {name}_state fresh = {{0}};",
        f"    static const {name}_real zero[{width[0]}] = {{0}};",
        f"    {name}_real out[{width[1]}];",
        "    *state = fresh;",
        f"    {name}_settle(state, zero, out);",
        "}",
        "",
        f"void {name}_step({name}_state *state, const {name}_real in[], {name}_real out[])",
        "{",
        *unused,
        f"    {root.name}_step({pointer}in, out);",
        "}",
        "",
        f"void {name}_block({name}_state *state, const {name}_real in[], {name}_real out[], int rows)",
        "{",
        "    for (int row = 0; row < rows; row++) {",
        f"        {name}_step(state, &in[row * (int){width[0]}], &out[row * (int){width[1]}]);",
        "    }",
        "}",
        "",
    ]
    return "\n".join(lines)


def _slots(prefix: str, count: str, slots: tuple[Slot, ...]) -> list[str]:
    names = c_identifiers([slot.name for slot in slots])
    rows = [
        f"    {prefix}_{name.upper()} = {i}, /* {c_comment(slot.text)} */"
        for i, (name, slot) in enumerate(zip(names, slots, strict=True))
    ]
    return ["enum {", *rows, f"    {count} = {len(slots)}", "};"]


def _units(program: Program) -> list[Unit]:
    """Filters of a program, parts before what they are parts of."""
    units: list[Unit] = []

    def add(code: CCode) -> Unit:
        parts = tuple(add(part) for part in code.parts)
        units.append(Unit(f"{program.name}_{len(units) + 1}_{c_identifier(code.title)}", code, parts))
        return units[-1]

    add(program.code)
    return units


def _type(member: Member, real: str) -> str:
    if member.value.dtype.kind in "iub":
        return "int"
    return "double" if member.wide else real


def _dimensions(member: Member) -> str:
    return "".join(f"[{max(length, 1)}]" for length in member.value.shape)


def _state(program: Program, unit: Unit) -> list[str]:
    rows = [
        f"    {_type(member, f'{program.name}_real')} {name}{_dimensions(member)}; /* {c_comment(member.text)} */"
        for name, member in unit.code.state.items()
    ]
    rows += [f"    {part.name}_state part{i};" for i, part in enumerate(unit.parts) if part.has_state]
    return ["typedef struct {", *rows, f"}} {unit.name}_state;"]


def _constants(unit: Unit) -> list[str]:
    if not unit.code.constants:
        return []
    rows, values = [], []
    for name, member in unit.code.constants.items():
        rows.append(f"    {_type(member, 'real')} {name}{_dimensions(member)}; /* {c_comment(member.text)} */")
        values.append(f"    {_initializer(member)}, /* {name} */")
    return [
        "typedef struct {",
        *rows,
        f"}} {unit.name}_parameters;",
        "",
        f"static const {unit.name}_parameters {unit.name}_given = {{",
        *values,
        "};",
        "",
    ]


def _initializer(member: Member) -> str:
    value = np.asarray(member.value)
    if 0 in value.shape:
        value = np.zeros([max(length, 1) for length in value.shape], value.dtype)
    whole = value.dtype.kind in "iub"

    def literal(number: float) -> str:
        if whole:
            return str(int(number))
        text = _hexadecimal(float(number))
        return text if member.wide else f"R({text})"

    def nested(part: np.ndarray) -> str:
        if not part.ndim:
            return literal(part.item())
        return "{" + ", ".join(nested(row) for row in part) + "}"

    return nested(value)


def _hexadecimal(number: float) -> str:
    if np.isnan(number):
        return "NAN"
    if np.isinf(number):
        return "INFINITY" if number > 0 else "-INFINITY"
    if number == int(number) and abs(number) < 2**53:
        return f"{number:.1f}"
    return re.sub(r"\.?0*p", "p", number.hex())


def _check_numbers(code: CCode, real: str) -> None:
    """Refuse what the types in C cannot hold."""
    for name, size in code.sizes.items():
        if abs(size) >= 2**31:
            raise InputError(f"{code.title}: {name.lower()} = {size} is beyond an int of C: take a smaller one")
    for name, member in code.constants.items():
        largest = float(np.abs(member.value[np.isfinite(member.value)]).max(initial=0))
        if member.value.dtype.kind in "iub":
            if largest >= 2**31:
                raise InputError(f"{code.title}: {name} = {largest:.15g} is beyond an int of C: take a smaller one")
        elif real == "float" and not member.wide and largest > float(np.finfo(np.float32).max):
            raise InputError(f"{code.title}: {name} = {largest:g} is beyond float: export with --real double, or take other units")


def _work(program: Program, unit: Unit) -> list[str]:
    code = unit.code
    given = f"{unit.name}_state *s, " if unit.has_state else ""
    lines = []
    for work, text in (("step", code.step), ("settle", code.settle or "SELF_step(s, in, out);")):
        body = _called(text, unit)
        sizes = {"AXES": program.axes, **code.sizes}
        used = [f"{name} = {size}" for name, size in sizes.items() if re.search(rf"\b{name}\b", body)]
        body = re.sub(r"\bnumber\b", "double" if code.wide else "real", body)
        lines += [f"static void {unit.name}_{work}({given}const real in[], real out[])", "{"]
        if used:
            lines.append(f"    enum {{ {', '.join(used)} }};")
        if "p->" in body:
            lines.append(f"    const {unit.name}_parameters *p = &{unit.name}_given;")
        lines += [f"    {line}".rstrip() for line in body.strip().splitlines()]
        if unit.has_state and not re.search(r"\bs\b", body):
            lines.append("    (void)s;")
        lines += ["}", ""]
    return lines


def _called(text: str, unit: Unit) -> str:
    """The calls of the filter's own functions and of its parts, by their names in C; who has no state is given none."""

    def own(found: re.Match[str]) -> str:
        return f"{unit.name}_{found[1]}({'s, ' if unit.has_state else ''}"

    def inner(found: re.Match[str]) -> str:
        part = unit.parts[int(found[1])]
        return f"{part.name}_{found[2]}({f'&s->part{found[3]}, ' if part.has_state else ''}"

    text = re.sub(r"\bSELF_(\w+)\(s, ", own, text)
    return re.sub(r"\bPART(\d+)_(\w+)\(&s->part(\d+), ", inner, text)
