"""The import rules of the architecture, read from the sources."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
SOURCES = sorted(path for package in ("hyst_control", "hyst_plant_sim") for path in (ROOT / package).rglob("*.py"))
ROS = {"rclpy", "std_msgs", "std_srvs", "diagnostic_msgs", "rcl_interfaces"}
LAYERS = [  # a module imports from its own layer and from those after it
    {"cli", "nodes"},
    {"identify", "diagnose", "control", "experiments"},
    {"record", "model_file", "excitation", "bag_writer", "importing"},
    {"effects"},
    {"chain"},
]


def imported(path: Path) -> set[str]:
    """Full names of all modules a file imports, also within functions."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                parents = path.relative_to(ROOT).with_suffix("").parts[:-node.level]
                base = ".".join([*parents, *([base] if base else [])])
            names |= {base, *(f"{base}.{alias.name}" for alias in node.names)}
    return names


def layer(module: str) -> int | None:
    """Layer of a module of hyst_control, None for one that all may use (errors, signal message, …)."""
    parts = module.split(".")
    found = [index for index, names in enumerate(LAYERS) if len(parts) > 1 and parts[0] == "hyst_control" and parts[1] in names]
    return found[0] if found else None


def module_name(path: Path) -> str:
    return ".".join(path.relative_to(ROOT).with_suffix("").parts)


def test_there_are_sources_to_read():
    assert len(SOURCES) > 20


@pytest.mark.parametrize("path", SOURCES, ids=module_name)
def test_ros_only_in_nodes(path):
    allowed = module_name(path).startswith("hyst_control.nodes.") or module_name(path) == "hyst_plant_sim.node"
    ros = {name for name in imported(path) if name.split(".")[0] in ROS}
    assert allowed or not ros


@pytest.mark.parametrize("path", [path for path in SOURCES if "physics" in path.relative_to(ROOT).parts], ids=module_name)
def test_physics_shares_nothing_with_the_models(path):
    assert not {name for name in imported(path) if name.split(".")[0] == "hyst_control"}
    assert not {name for name in imported(path) if name == "hyst_plant_sim.node"}


@pytest.mark.parametrize("path", SOURCES, ids=module_name)
def test_imports_run_downward(path):
    own = layer(module_name(path))
    if own is not None:
        upward = {name for name in imported(path) if (other := layer(name)) is not None and other < own}
        assert not upward
