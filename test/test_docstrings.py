# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Rules for docstrings, over all modules of both packages.

Every public module, class, function and method has one, whose title is no question. What `docs/api.md` promises names every parameter
and has numpydoc's sections. Sources are parsed, not imported.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SOURCES = {
    path.relative_to(ROOT).as_posix(): path
    for package in ("hyst_control", "hyst_plant_sim", "evaluation")
    for path in sorted((ROOT / package).rglob("*.py"))
}
QUESTIONS = ("What", "Where", "How", "Whether", "Which", "When", "Who", "Why")
PAGES = ("api.md", "extension_api.md")
LISTED = re.compile(r"^::: ([\w.]+)$(?:\n    options:\n      members: \[(.*)\])?", re.M)
API = {
    module: members.split(", ") if members else None
    for page in PAGES
    for module, members in LISTED.findall((ROOT / "docs" / page).read_text(encoding="utf-8"))
}
"""Modules of the public API, and what they promise: all (None), or the named classes and functions."""


Function = ast.FunctionDef | ast.AsyncFunctionDef


@dataclass(frozen=True)
class Definition:
    """A class, function or method: `owner` is the class of a method."""

    node: ast.ClassDef | Function
    owner: ast.ClassDef | None

    @property
    def name(self) -> str:
        return f"{self.owner.name}.{self.node.name}" if self.owner else self.node.name

    @property
    def text(self) -> str:
        return ast.get_docstring(self.node) or ""

    def decorated(self, *names: str) -> bool:
        """Whether a decorator, or the last part of its name, is one of some."""
        found = (node.func if isinstance(node, ast.Call) else node for node in self.node.decorator_list)
        return any((getattr(node, "id", None) or getattr(node, "attr", None)) in names for node in found)

    @property
    def parameters(self) -> list[str]:
        """Names of a function's parameters, without self and private ones."""
        if isinstance(self.node, ast.ClassDef):
            return []
        found = self.node.args
        every = [*found.posonlyargs, *found.args, *found.kwonlyargs, *(each for each in (found.vararg, found.kwarg) if each)]
        first = 0 if self.owner is None or self.decorated("staticmethod") else 1
        return [each.arg for each in every[first:] if not each.arg.startswith("_")]


@cache
def tree(name: str) -> ast.Module:
    return ast.parse(SOURCES[name].read_text(encoding="utf-8"))


def definitions(name: str) -> Iterator[Definition]:
    """Public classes, functions and methods of a file."""
    for node in tree(name).body:
        if isinstance(node, (ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)) and not node.name.startswith("_"):
            yield Definition(node, None)
            if isinstance(node, ast.ClassDef):
                for inner in node.body:
                    if isinstance(inner, (ast.FunctionDef, ast.AsyncFunctionDef)) and not inner.name.startswith("_"):
                        yield Definition(inner, node)


@cache
def classes() -> dict[str, list[ast.ClassDef]]:
    """Classes of both packages by name."""
    found: dict[str, list[ast.ClassDef]] = {}
    for name in SOURCES:
        for node in ast.walk(tree(name)):
            if isinstance(node, ast.ClassDef):
                found.setdefault(node.name, []).append(node)
    return found


def bases(node: ast.ClassDef) -> list[str]:
    """Names of the classes that a class is derived from, without their type arguments."""
    heads = (base.value if isinstance(base, ast.Subscript) else base for base in node.bases)
    return [head.id if isinstance(head, ast.Name) else head.attr for head in heads if isinstance(head, (ast.Name, ast.Attribute))]


def overrides(definition: Definition) -> bool:
    """Whether a method overrides a documented one of these packages, or one of another package's class."""
    pending, seen = bases(definition.owner) if definition.owner else [], set()
    while pending:
        name = pending.pop()
        if name in seen:
            continue
        seen.add(name)
        for base in classes().get(name, []):
            method = next((each for each in base.body if isinstance(each, Function) and each.name == definition.node.name), None)
            if method is not None and ast.get_docstring(method):
                return True
            pending += bases(base)
    foreign = seen - set(classes()) - {"Protocol", "Generic", "NamedTuple", "TypedDict", "Enum", "Exception", "object"}
    return bool(foreign)


def exempt(definition: Definition) -> bool:
    """Whether a definition needs no docstring: an override of a documented one, an overload, or a setter."""
    return definition.decorated("overload", "setter") or (definition.owner is not None and overrides(definition))


def sections(text: str) -> set[str]:
    """Names of the numpydoc sections of a docstring."""
    return set(re.findall(r"^(\w[\w ]*)\n-{3,}$", text, re.M))


def raises(definition: Definition) -> bool:
    """Whether a function raises by itself what its caller has to know of."""
    own = [node for node in ast.walk(definition.node) if isinstance(node, ast.Raise) and node.exc is not None]
    names = [node.exc.func if isinstance(node.exc, ast.Call) else node.exc for node in own]
    return any(isinstance(name, ast.Name) and name.id == "InputError" for name in names)


def returns(definition: Definition) -> bool:
    """Whether a function returns or yields something."""
    hint = getattr(definition.node, "returns", None)
    return hint is not None and not (isinstance(hint, ast.Constant) and hint.value is None)


def public(name: str, definition: Definition) -> bool:
    """True for a definition of a file that belongs to the public API."""
    module = name.removesuffix(".py").removesuffix("/__init__").replace("/", ".")
    members = API.get(module, [])
    return members is None or (definition.owner or definition.node).name in members


def faults(name: str) -> list[str]:
    """What a file's docstrings lack."""
    found = [] if ast.get_docstring(tree(name)) else ["the module: no docstring"]
    title = (ast.get_docstring(tree(name)) or "x").split()[0]
    found += [f"the module: its title begins with {title}"] * (title in QUESTIONS)
    for definition in definitions(name):
        text, where = definition.text, f"{definition.node.lineno}: {definition.name}"
        if not text:
            found += [] if exempt(definition) else [f"{where}: no docstring"]
            continue
        first = text.split()[0].rstrip(".,:")
        found += [f"{where}: its title begins with {first}"] * (first in QUESTIONS)
        if not public(name, definition):
            continue
        context = text + (ast.get_docstring(definition.owner) or "" if definition.owner else "")
        due = [] if exempt(definition) else definition.parameters  # an override's are those of what it overrides
        missing = [each for each in due if not re.search(rf"\b{re.escape(each)}\b", context)]
        found += [f"{where}: {', '.join(missing)} not named"] * bool(missing)
        if definition.owner is None and not isinstance(definition.node, ast.ClassDef):
            due = {"Parameters"} if definition.parameters else set()
            due |= {"Returns"} if definition.parameters and returns(definition) else set()
            due |= {"Raises"} if raises(definition) else set()
            lacking = sorted(due - sections(text) - ({"Returns"} if "Yields" in sections(text) else set()))
            found += [f"{where}: no section {', '.join(lacking)}"] * bool(lacking)
    return found


def test_docstrings_keep_the_rules():
    assert not [f"{name}: {fault}" for name in SOURCES for fault in faults(name)], "see CONTRIBUTING.md"


@pytest.mark.parametrize(
    ("source", "fault"),
    [
        ("x = 1\n", "no docstring"),
        ('"""Whether it rains."""\n', "begins with Whether"),
        ('"""A module."""\nclass A:\n    """A class."""\n    def f(self):\n        return 1\n', "A.f: no docstring"),
        ('"""A module."""\nclass A:\n    """A class."""\n    @property\n    def f(self):\n        """How."""\n', "begins with How"),
    ],
)
def test_a_fault_is_found(source, fault, tmp_path, monkeypatch):
    path = tmp_path / "module.py"
    path.write_text(source, encoding="utf-8")
    monkeypatch.setitem(SOURCES, fault, path)
    (found,) = faults(fault)
    assert fault in found


def test_a_parameter_without_a_word_is_found(tmp_path, monkeypatch):
    path = tmp_path / "module.py"
    path.write_text('"""A module."""\ndef f(u):\n    """Twice a number."""\n', encoding="utf-8")
    monkeypatch.setitem(SOURCES, "public.py", path)
    monkeypatch.setitem(API, "public", None)
    assert faults("public.py") == ["2: f: u not named", "2: f: no section Parameters"]


def test_the_public_api_is_there():
    names = {name.removesuffix(".py").removesuffix("/__init__").replace("/", "."): name for name in SOURCES}
    assert len(API) > 15 and set(API) <= set(names)
    for module, members in API.items():
        assert set(members or ()) <= {each.name for each in definitions(names[module])}, module


def test_what_a_page_does_not_list_may_have_one_sentence(tmp_path, monkeypatch):
    path = tmp_path / "module.py"
    path.write_text('"""A module."""\ndef f(u):\n    """Twice a number."""\n', encoding="utf-8")
    monkeypatch.setitem(SOURCES, "public.py", path)
    monkeypatch.setitem(API, "public", ["g"])
    assert not faults("public.py")
