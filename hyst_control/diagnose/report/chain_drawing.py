# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A drawing of the signal chain with the places of the gap marked: inline SVG, no script."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from textwrap import wrap
from typing import Any

from markupsafe import Markup

from hyst_control.reporting.templates import render_markup

BOXES = {
    "reference": ("reference",),
    "feedforward + feedback": ("feedforward", "feedback", "command sum"),
    "DAC": ("dac",),
    "amplifier": ("drive",),
    "hysteresis": ("hysteresis",),
    "piezo": ("piezo",),
    "mechanics": ("mechanics", "motion"),
    "sensor": ("sensor",),
    "ADC + transport": ("adc", "transport"),
}
"""Boxes, each with the places of `effects.effect.PLACES` and the software blocks of the replay that belong to it."""
BOX_OF = {place: index for index, places in enumerate(BOXES.values()) for place in places}

WIDTH, HEIGHT, TOP, GAP = 104, 62, 22, 14
LETTERS = 13  # Most letters that fit on a line in a box
MIN_SHARE = 0.005  # Share of the gap under which a box stays white


def chain_picture(document: Mapping[str, Any]) -> Markup:
    """Draw the chain from reference to measurement."""
    shares = dict.fromkeys(range(len(BOXES)), 0.0)
    for row in document["where"]["stage"]:
        if row["name"] in BOX_OF:
            shares[BOX_OF[row["name"]]] += row["share"]
    labels: dict[int, list[str]] = {}
    for effect in document["effects"]:
        sure = "" if document["verdict"] == "effect" else "?"
        labels.setdefault(BOX_OF[effect["place"]], []).append(effect["name"].replace("_", " ") + sure)
    for block in document["replay"]:
        if not block["faithful"]:
            labels.setdefault(BOX_OF[block["name"]], []).append(f"{block['name']} at fault")
    lines = max((len(found) for found in labels.values()), default=0)
    rest = {row["name"]: row["share"] for row in document["where"]["stage"] if row["name"] not in BOX_OF}
    return render_markup(
        "diagnose/templates/chain.svg",
        width=len(BOXES) * (WIDTH + GAP) - GAP,
        height=TOP + HEIGHT + 20 + 18 * lines,
        gap=GAP,
        min_share=MIN_SHARE,
        boxes=[_box(index, name, shares[index], labels.get(index, [])) for index, name in enumerate(BOXES)],
        elsewhere=[f"{name} {100 * share:.0f} %" for name, share in rest.items()],
    )


def _box(index: int, name: str, share: float, labels: Sequence[str]) -> dict[str, object]:
    """Values of a box: its place, its words and what stands beneath it."""
    left, middle = index * (WIDTH + GAP), TOP + HEIGHT / 2
    words = wrap(name, LETTERS)
    return {
        "left": left,
        "top": TOP,
        "width": WIDTH,
        "height": HEIGHT,
        "center": left + WIDTH / 2,
        "middle": middle,
        "marked": bool(labels) or share > MIN_SHARE,
        "opacity": 0.14 + 0.6 * min(share, 1.0),
        "share": share,
        "words": [{"y": middle + 5 + 17 * (row - (len(words) - 1) / 2), "text": text} for row, text in enumerate(words)],
        "labels": [{"y": TOP + HEIGHT + 20 + 18 * row, "text": text} for row, text in enumerate(labels)],
    }
