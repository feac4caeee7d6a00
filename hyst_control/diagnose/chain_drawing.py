"""A drawing of the signal chain with the places of the gap marked: inline SVG, no script."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

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
LETTERS = 13
"""As many fit on a line in a box."""


def chain_picture(document: Mapping[str, Any]) -> str:
    """The chain from reference to measurement, the boxes coloured by their share of the gap, effects and faulty blocks named."""
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
    total = len(BOXES) * (WIDTH + GAP) - GAP
    bottom = TOP + HEIGHT + 20 + 18 * lines
    parts = [
        f"<svg viewBox='-4 0 {total + 8} {bottom + 34}' role='img' aria-label='Signal chain with the place of the gap' "
        "style='width:100%;font-family:inherit'>",
        "<defs><marker id='tip' viewBox='0 0 8 8' refX='7' refY='4' markerWidth='7' markerHeight='7' orient='auto'>"
        "<path d='M0 0 L8 4 L0 8 z' fill='#596273'/></marker></defs>",
    ]
    for i, name in enumerate(BOXES):
        parts += _box(i, name, shares[i], labels.get(i, []))
    rest = {row["name"]: row["share"] for row in document["where"]["stage"] if row["name"] not in BOX_OF}
    told = " · ".join(f"{name} {100 * share:.0f} %" for name, share in rest.items())
    parts.append(
        f"<text x='{total}' y='{bottom + 22}' font-size='14' fill='#596273' text-anchor='end'>"
        f"of the gap's energy at no one place: {escape(told)}</text></svg>"
    )
    return "".join(parts)


def _box(index: int, name: str, share: float, labels: Sequence[str]) -> list[str]:
    x, marked = index * (WIDTH + GAP), bool(labels) or share > 0.005
    centre = x + WIDTH / 2
    fill = f"rgba(194,84,45,{0.14 + 0.6 * min(share, 1.0):.2f})" if marked else "#ffffff"
    parts = [
        f"<rect x='{x}' y='{TOP}' width='{WIDTH}' height='{HEIGHT}' rx='7' fill='{fill}' "
        f"stroke='{'#c2542d' if marked else '#9aa1ab'}' stroke-width='{2.5 if marked else 1.2}'/>"
    ]
    words = _wrapped(name)
    for row, text in enumerate(words):
        parts.append(
            f"<text x='{centre}' y='{TOP + HEIGHT / 2 + 5 + 17 * (row - (len(words) - 1) / 2)}' font-size='14' "
            f"text-anchor='middle' fill='#1c2430'>{escape(text)}</text>"
        )
    if index + 1 < len(BOXES):
        parts.append(
            f"<line x1='{x + WIDTH}' y1='{TOP + HEIGHT / 2}' x2='{x + WIDTH + GAP}' y2='{TOP + HEIGHT / 2}' "
            "stroke='#596273' stroke-width='1.5' marker-end='url(#tip)'/>"
        )
    if share > 0.005:
        parts.append(
            f"<text x='{centre}' y='{TOP - 7}' font-size='14' font-weight='600' text-anchor='middle' "
            f"fill='#c2542d'>{100 * share:.0f} %</text>"
        )
    for row, text in enumerate(labels):
        parts.append(
            f"<text x='{centre}' y='{TOP + HEIGHT + 20 + 18 * row}' font-size='14' font-weight='600' text-anchor='middle' "
            f"fill='#c2542d'>{escape(text)}</text>"
        )
    return parts


def _wrapped(name: str) -> list[str]:
    lines = [""]
    for word in name.split():
        joined = f"{lines[-1]} {word}".strip()
        if len(joined) > LETTERS and lines[-1]:
            lines.append(word)
        else:
            lines[-1] = joined
    return lines
