# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""No list of stages or effects outside the things themselves: a name stands in its own file, and nowhere else in the sources."""

from __future__ import annotations

import ast
import inspect
import re
from functools import cache
from pathlib import Path

import hyst_control.effects
from hyst_control.chain import STAGES
from hyst_control.chain.parameter import declared
from hyst_control.effects import EFFECTS

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "hyst_control"
SOURCES = [path for path in sorted(PACKAGE.rglob("*.py")) if path.relative_to(PACKAGE).parts[0] != "demo"]
NAMES = {*STAGES, *EFFECTS}
PARAMETERS = {name for stage in STAGES.values() for name in declared(stage)}
WORDS = {"gain", "offset", "delay", "saturation", "quantization", "resonance", "vibration", "creep", "parallel", "slew_limit"}
"""Names that are words of the language or of other interfaces as well (options, columns, quantities): they are looked for only where
they are compared with a name, listed or looked up beside another name of the catalogue."""


QUOTED = re.compile(rf"""(["'])({"|".join(map(re.escape, sorted(NAMES)))})\1""")


@cache
def parsed(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


@cache
def own_files() -> dict[str, set[Path]]:
    """Files in which a name may stand: that of the stage's class, and those called by it (an effect, a family of models)."""
    found = {name: {path for path in SOURCES if path.stem == name} for name in NAMES}
    for name, stage in STAGES.items():
        found[name].add(Path(inspect.getfile(stage)))
    return found


def documentation(tree: ast.AST) -> set[int]:
    """Identities of the nodes that are docstrings."""
    owners = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    return {
        id(node.body[0].value)
        for node in ast.walk(tree)
        if isinstance(node, owners)
        and node.body
        and isinstance(node.body[0], ast.Expr)
        and isinstance(node.body[0].value, ast.Constant)
    }


def of_something(tree: ast.AST) -> set[int]:
    """Identities of literals that are compared with a `name`, or listed in one collection with a name that is no word."""
    found: set[int] = set()
    for node in ast.walk(tree):
        if not isinstance(node, (ast.Compare, ast.Tuple, ast.List, ast.Set, ast.Dict)):
            continue
        literals = [child for child in ast.walk(node) if isinstance(child, ast.Constant) and child.value in NAMES]
        if isinstance(node, ast.Compare):
            sides = [node.left, *node.comparators]
            if any(isinstance(side, ast.Attribute) and side.attr == "name" for side in sides):
                found |= {id(literal) for literal in literals}
        elif any(literal.value not in WORDS for literal in literals):
            found |= {id(literal) for literal in literals}
    return found


def named(path: Path, own: dict[str, set[Path]]) -> list[str]:
    """Stages and effects that a source file names though it is another's."""
    if not QUOTED.search(path.read_text(encoding="utf-8")):
        return []  # most files: a name that is a literal stands there in quotes
    tree = parsed(path)
    told, about = documentation(tree), of_something(tree)
    return [
        f"{path.relative_to(ROOT)}:{node.lineno}: {node.value!r}"
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant)
        and isinstance(node.value, str)
        and node.value in NAMES
        and id(node) not in told
        and (node.value not in WORDS or id(node) in about)
        and path not in own[node.value]
    ]


def test_a_source_names_no_stage_or_effect_of_another_file():
    assert not [fault for path in SOURCES for fault in named(path, own_files())], (
        "ask the stage or the effect (a property, a method, a declared parameter) instead of naming it"
    )


def lists_of_parameters(tree: ast.Module) -> list[str]:
    """Constants of a module that list parameters of stages by name, as the uncertain ones or the matrices once were."""
    found = []
    for node in tree.body:
        if isinstance(node, (ast.Assign, ast.AnnAssign)) and isinstance(node.value, (ast.Tuple, ast.List, ast.Set, ast.Dict)):
            words = [child for child in ast.walk(node.value) if isinstance(child, ast.Constant) and isinstance(child.value, str)]
            if len(words) > 1 and {word.value for word in words} <= PARAMETERS:
                found.append(f"line {node.lineno}: {', '.join(word.value for word in words)}")
    return found


def test_a_source_has_no_constant_list_of_parameters():
    found = [f"{path.relative_to(ROOT)}: {fault}" for path in SOURCES for fault in lists_of_parameters(parsed(path))]
    assert not found, "declare what is known about a parameter where the stage declares it (hyst_control.chain.parameter)"


def test_a_list_of_parameters_is_found():
    old = 'LISTS = ("weights", "thresholds", "num")\nMATRICES = ("A", "B")\nWORDS = ("num", "no such parameter")\nONE = ("A",)\n'
    assert lists_of_parameters(ast.parse(old)) == ["line 1: weights, thresholds, num", "line 2: A, B"]


def test_a_list_of_names_is_found(tmp_path):
    """The test can fail: what it is against is recognized."""
    text = 'FOLLOWERS = {"piezo": ("creep", "backlash")}\nif stage.name == "delay":\n    pass\ntext = "a gain"\nkey = "gain"\n'
    path = PACKAGE / "effects" / "no_such_file.py"
    tree = ast.parse(text)
    about = of_something(tree)
    seen = {node.value for node in ast.walk(tree) if isinstance(node, ast.Constant) and id(node) in about}
    assert seen == {"creep", "backlash", "delay"} and path not in SOURCES


def test_every_effect_is_a_file_of_its_name():
    files = {path.stem for path in Path(hyst_control.effects.__file__).parent.glob("*.py")}
    assert set(EFFECTS) <= files
