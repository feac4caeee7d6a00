# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The layouts for PlotJuggler and Foxglove show topics that the nodes publish, and columns that these have."""

from __future__ import annotations

import ast
import json
import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SOURCES = (*sorted((ROOT / "hyst_control/nodes").rglob("*.py")), ROOT / "hyst_plant_sim/node.py")


def published() -> set[str]:
    """Topics that the nodes' sources publish: the first text of every output, sender and publisher."""
    topics = set()
    for path in SOURCES:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            name = getattr(node.func, "attr", getattr(node.func, "id", "")) if isinstance(node, ast.Call) else ""
            if isinstance(node, ast.Call) and name in ("output", "Sender", "create_publisher"):
                words = [word.value for word in node.args if isinstance(word, ast.Constant) and isinstance(word.value, str)]
                topics.update("/" + word.lstrip("/") for word in words[:1])
    return topics


def test_plotjuggler_shows_what_is_published():
    layout = ElementTree.parse(ROOT / "config/plotjuggler/loop.xml")
    curves = [
        value
        for curve in layout.iter("curve")
        for key, value in curve.items()
        if key in ("curve_x", "curve_y") or (key == "name" and "curve_x" not in curve.attrib)
    ]
    columns = [re.fullmatch(r"(/\w+)/data\[([12])\]", curve) for curve in curves]
    assert len(curves) > 5 and all(columns)
    assert {column[1] for column in columns} <= published()


def test_foxglove_shows_what_is_published():
    layout = json.loads((ROOT / "config/foxglove/loop.json").read_text())
    panels = layout["configById"]
    paths = [
        path["value"] for panel in panels.values() for path in [*panel.get("paths", []), *filter(None, [panel.get("xAxisPath")])]
    ]
    columns = [re.fullmatch(r"(/\w+)\.data\[([12])\]", path) for path in paths]
    assert len(paths) > 5 and all(columns)
    assert {column[1] for column in columns} | {panels["DiagnosticSummary!nodes"]["topicToRender"]} <= published()


def test_foxglove_places_every_panel():
    layout = json.loads((ROOT / "config/foxglove/loop.json").read_text())

    def leaves(tree):
        return [tree] if isinstance(tree, str) else leaves(tree["first"]) + leaves(tree["second"])

    assert sorted(leaves(layout["layout"])) == sorted(layout["configById"])
