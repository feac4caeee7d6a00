# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Reference pages of the site, one for each command, node, stage and effect; written when the site is built, and not tracked."""

from __future__ import annotations

from docs.reference.commands import command_pages
from docs.reference.effects import effect_pages
from docs.reference.nodes import node_pages
from docs.reference.stages import stage_pages
from hyst_control.cli import parser


def pages() -> dict[str, str]:
    """Text of every page by its path in the site, such as `reference/stages/play.md`; `index.md` is the first of its folder."""
    folders = {"commands": command_pages(parser()), "nodes": node_pages(), "stages": stage_pages(), "effects": effect_pages()}
    return {f"reference/{folder}/{name}.md": text for folder, found in folders.items() for name, text in found.items()}
