# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The import rules of the architecture, read from the sources."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
SOURCES = sorted(path for package in ("hyst_control", "hyst_plant_sim", "evaluation") for path in (ROOT / package).rglob("*.py"))
ROS = {"rclpy", "std_msgs", "std_srvs", "diagnostic_msgs", "rcl_interfaces"}
ROOMS = (  # from the top of the house down: a room imports from itself and from those below it
    "__main__",
    "cli",
    "api",
    "labs",
    "hardware",
    "nodes",
    "dashboard",
    "demo",
    "fleet",
    "export",
    "diagnose",
    "control",
    "identify",
    "reporting",
    "processes",
    "model_file",
    "records",
    "effects",
    "chain",
    "base",
)
ROS_OUTSIDE = {  # nodes that a benchmark compares ours with; a bridge that listens to them
    "hyst_control.labs.foxglove_bridge",
    "evaluation.benchmarks.plain_loop",
}
ONE_PLACE = {  # what only one module may use, so that there is one way of doing it
    "concurrent": "hyst_control.base.parallel",
    "multiprocessing": "hyst_control.base.parallel",
    "tqdm": "hyst_control.base.progress",
    "distributed": "hyst_control.base.cluster",
}


@cache
def import_statements(path: Path) -> list[ast.Import | ast.ImportFrom]:
    """Import statements of a file, also those within functions."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return [node for node in ast.walk(tree) if isinstance(node, (ast.Import, ast.ImportFrom))]


@cache
def imported(path: Path) -> frozenset[str]:
    """Full names of all modules a file imports, also within functions."""
    names: set[str] = set()
    for node in import_statements(path):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, f"{path}: imports are absolute"
            names |= {str(node.module), *(f"{node.module}.{alias.name}" for alias in node.names)}
    return frozenset(names)


def module_name(path: Path) -> str:
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


def room(module: str) -> str | None:
    """Room of a module of this package; None for the package itself and what belongs to others."""
    parts = module.split(".")
    if parts[:2] == ["hyst_plant_sim", "node"]:
        return "nodes"
    return parts[1] if parts[0] == "hyst_control" and len(parts) > 1 else None


def test_there_are_sources_to_read():
    assert len(SOURCES) > 20


def test_every_module_is_in_a_room():
    assert {found for path in SOURCES if (found := room(module_name(path)))} <= set(ROOMS)


def test_ros_only_in_nodes():
    outside = [path for path in SOURCES if room(module_name(path)) != "nodes" and module_name(path) not in ROS_OUTSIDE]
    assert not [f"{module_name(path)} imports {name}" for path in outside for name in imported(path) if name.split(".")[0] in ROS]


def test_the_package_works_without_the_evaluation():
    inside = [path for path in SOURCES if not module_name(path).startswith("evaluation")]
    assert not [
        f"{module_name(path)} imports {name}" for path in inside for name in imported(path) if name.startswith("evaluation")
    ]


def test_physics_shares_nothing_with_the_models():
    physics = [path for path in SOURCES if "physics" in path.relative_to(ROOT).parts]
    assert len(physics) > 5
    assert not [
        f"{module_name(path)} imports {name}"
        for path in physics
        for name in imported(path)
        if name.split(".")[0] == "hyst_control" or name == "hyst_plant_sim.node"
    ]


def test_imports_run_downward():
    upward = []
    for path in SOURCES:
        own = room(module_name(path))
        if own is not None:
            above = ROOMS[: ROOMS.index(own)]
            upward += [f"{module_name(path)} imports {name}" for name in imported(path) if room(name) in above]
    assert not upward


def test_private_names_stay_within_their_module():
    private = [
        f"{module_name(path)} imports {name}"
        for path in SOURCES
        for name in imported(path)
        if name.startswith(("hyst_control.", "hyst_plant_sim.", "evaluation."))
        and any(part.startswith("_") for part in name.split("."))
    ]
    assert not private


def test_what_has_one_place_is_used_there_only():
    found = []
    for path in SOURCES:
        used = {name.split(".")[0] for name in imported(path)}
        found += [
            f"{module_name(path)} uses {name}" for name, place in ONE_PLACE.items() if name in used and module_name(path) != place
        ]
    assert not found


def circles(graph: dict[str, set[str]]) -> set[frozenset[str]]:
    """Sets of nodes of a directed graph that all lead to one another, single ones without an edge to themselves left out."""

    def reached(start: str) -> set[str]:
        found: set[str] = set()
        waiting = [start]
        while waiting:
            for name in graph[waiting.pop()] - found:
                found.add(name)
                waiting.append(name)
        return found

    after = {name: reached(name) for name in graph}
    return {frozenset({name} | {other for other in after[name] if name in after[other]}) for name in graph if name in after[name]}


def import_graph() -> dict[str, set[str]]:
    """Modules of both packages that each of them names in an import, also within functions and for types alone."""
    modules = {module_name(path): path for path in SOURCES}
    graph: dict[str, set[str]] = {name: set() for name in modules}
    for name, path in modules.items():
        for node in import_statements(path):
            if isinstance(node, ast.Import):
                graph[name] |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                # A name of a package is a module of it, or else the package's own.
                full = [f"{node.module}.{alias.name}" for alias in node.names]
                graph[name] |= {each if each in modules else str(node.module) for each in full}
    return {name: targets & set(modules) for name, targets in graph.items()}


def test_a_circle_of_imports_is_found():
    graph = {"a": {"b"}, "b": {"c"}, "c": {"b", "d"}, "d": set(), "e": {"e"}}
    assert circles(graph) == {frozenset("bc"), frozenset("e")}


def test_no_imports_run_in_circles():
    assert not circles(import_graph())
