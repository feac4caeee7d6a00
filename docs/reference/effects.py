# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Reference of the effects: a page for each with its parameters, the range of the diagnosis, and its figure."""

from __future__ import annotations

from dataclasses import replace

from docs.reference.tables import table
from evaluation.blind_test.effect_figures import EXAMPLES, SAMPLE_TIME, UPPER_FREQUENCY, Example
from hyst_control.effects import EFFECTS as CATALOGUE
from hyst_control.effects.effect import Surroundings
from hyst_plant_sim.physics import EFFECTS
from hyst_plant_sim.physics.signal_path import PLACES

RECORD = Surroundings(SAMPLE_TIME, 1.0, (0.0, 100.0), 2e4, (0.0, 10.0), 1)
"""Record for which the pages give the ranges of the diagnosis."""
TITLES = {
    "dac": "Converter of the commands",
    "drive": "Drive",
    "amplifier": "Amplifier",
    "hysteresis": "Hysteresis",
    "piezo": "Piezo",
    "mechanics": "Mechanics",
    "motion": "Motion",
    "sensor": "Sensor",
    "adc": "Converter of the measurement",
    "transport": "Way of the samples",
}
HEAD = """# Effects

Each effect acts at its physical place. The reference simulations have {simulated} effects: the diagnosis has {known} of them in its
catalogue, the {unknown} others test the verdict `unknown`.

A plant file or a case lists them: `effects: [{{name: delay, tau: 4.0e-4, axis: x, from: 0.5}}]`. The plant node's parameter `effects` is a
text of that form. Without `axis` an effect acts on every axis, without `from` (s) at all times. `unit` is the plant's measurement unit,
um or mrad.
"""
FIGURE = """The figure shows the reference simulation of the {plant} without noise: gray without the effect, blue with it, orange
the gap. Left: steps and the gap below them. Center: the spectrum of the response to a multisine up to {upper:g} Hz. Right: a loop over the
voltage at {frequency:g} Hz. Effect: {shown}.

![{name}: with and without](../../figures/effects/{name}.png)
"""


def effect_pages() -> dict[str, str]:
    """Every effect's page by its name, and their list by place as `index`."""
    known = sum(name in CATALOGUE for name in EFFECTS)
    parts = [HEAD.format(simulated=len(EFFECTS), known=known, unknown=len(EFFECTS) - known)]
    for place in PLACES:
        here = [name for name, effect in EFFECTS.items() if effect.place == place]
        if here:
            parts.append(f"\n## {TITLES[place]}\n\n" + "".join(map(_line, here)))
    others = [name for name in CATALOGUE if name not in EFFECTS]
    if others:
        parts.append("\n## Without a reference simulation\n\n" + "".join(map(_line, others)))
    return {"index": "".join(parts)} | {name: _page(name) for name in (*EFFECTS, *others)}


def _line(name: str) -> str:
    return f"- [`{name}`]({name}.md){'' if name in CATALOGUE else ' (*outside the catalogue*)'}: {_meaning(name)}\n"


def _meaning(name: str) -> str:
    return (EFFECTS if name in EFFECTS else CATALOGUE)[name].meaning


def _page(name: str) -> str:
    parts = [f"# {name}\n\n{_meaning(name)}"]
    example = EXAMPLES.get(name)
    if example is not None:
        parts += ["" if name in CATALOGUE else "This effect is outside the catalogue of the diagnosis.", example.sign, _given(name)]
    if name in CATALOGUE:
        parts.append(_searched(name))
    if example is not None:
        parts.append(_figure(name, example))
    return "\n\n".join(part.strip() for part in parts if part) + "\n"


def _given(name: str) -> str:
    effect = EFFECTS[name]
    texts = {key: f"absent at {value:g}" for key, value in effect.absent.items()}
    texts |= {key: f"{value:g} by default" for key, value in effect.others.items()}
    return table("parameter | unit | ", ((f"`{key}`", effect.units.get(key) or "-", text) for key, text in texts.items()))


def _searched(name: str) -> str:
    """Parameters of an effect in the gap report, with the range in which the diagnosis of `RECORD` searches."""
    effect = CATALOGUE[name]
    rows = [
        (f"`{each.name}`", each.unit.replace("unit", "um").replace("command", "V") or "-", f"{each.lower:.3g}", f"{each.upper:.3g}")
        for each in effect.parameters(replace(RECORD, axes=2) if effect.couples else RECORD)
        if each.told
    ]
    head = f"In the gap report, with ranges for {described_record()}:"
    return f"{head}\n\n{table('parameter | unit | searched from | to', rows)}"


def described_record() -> str:
    """The record whose ranges the pages give, in words."""
    command, measured = (f"{low:g} to {high:g}" for low, high in (RECORD.command, RECORD.measurement))
    return (
        f"a record of {RECORD.duration:g} s at {1 / RECORD.sample_time:g} Hz, {command} V at up to {RECORD.slew:g} V/s, "
        f"with a measurement from {measured} um"
    )


def _figure(name: str, example: Example) -> str:
    units = {key: unit.replace("unit", {"pea": "um", "fsm": "mrad"}[example.plant]) for key, unit in EFFECTS[name].units.items()}
    shown = ", ".join(f"{key} {value:g} {units.get(key, '')}".strip() for key, value in example.values.items())
    plant = {"pea": "PEA", "fsm": "mirror"}[example.plant]
    return FIGURE.format(name=name, plant=plant, upper=UPPER_FREQUENCY, frequency=example.frequency, shown=shown)
