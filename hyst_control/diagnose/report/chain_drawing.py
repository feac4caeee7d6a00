# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A drawing of the signal chain with the places of the gap marked: inline SVG, no script."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from markupsafe import Markup

from hyst_control.reporting.templates import render_markup

BOXES = ("reference", "feedforward + feedback", "DAC", "amplifier", "hysteresis", "piezo", "mechanics", "sensor", "ADC + transport")
BOX_OF = {
    "reference": 0,
    "feedforward": 1,
    "feedback": 1,
    "command sum": 1,
    "dac": 2,
    "drive": 3,
    "hysteresis": 4,
    "piezo": 5,
    "mechanics": 6,
    "motion": 6,
    "sensor": 7,
    "adc": 8,
    "transport": 8,
}
"""Which box a place of `effects.effect.PLACES`, or a software block of the replay, belongs to."""

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
    words = _wrapped(name)
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


def _wrapped(name: str) -> list[str]:
    lines = [""]
    for word in name.split():
        joined = f"{lines[-1]} {word}".strip()
        if len(joined) > LETTERS and lines[-1]:
            lines.append(word)
        else:
            lines[-1] = joined
    return lines
