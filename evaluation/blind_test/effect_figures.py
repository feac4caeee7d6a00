# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Figures of the effects (`hyst cases figures`): a record with each and without it, stronger than in a blind case."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from evaluation.blind_test.case_records import respond
from evaluation.blind_test.effect_sizes import FILE
from hyst_control.base.arrays import Array
from hyst_plant_sim.physics import EFFECTS, Plant, load_plant

if TYPE_CHECKING:
    from matplotlib.backends.backend_agg import FigureCanvasAgg


SAMPLE_TIME = 5e-5
UPPER_FREQUENCY = 4000.0
"""Hz, of the multisine whose response is drawn."""


@dataclass(frozen=True)
class Example:
    """Example of an effect for its figure."""

    values: Mapping[str, float]  # Parameters of the effect
    span: float  # Length of the record of jumps, s
    frequency: float  # Frequency of the loop, Hz
    sign: str  # Sign of the effect in a record, in words
    plant: str = "pea"  # Truth plant


EXAMPLES = {name: Example(**values) for name, values in FILE["examples"].items()}


def write(folder: Path) -> list[Path]:
    """Write a figure for each effect."""
    folder.mkdir(parents=True, exist_ok=True)
    written = [folder / f"{name}.png" for name in EFFECTS]
    for path in written:
        draw(path.stem, path)
    return written


def draw(name: str, path: Path) -> None:
    """Draw the figure of one effect: jumps and the gap in time, spectrum, loop."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from scipy.signal import welch

    example = EXAMPLES[name]
    plants = [_plant(example, []), _plant(example, [{"name": name, **example.values, "axis": "x"}])]
    unit = plants[0].units["measurement"]
    grey, blue, orange = "0.55", "tab:blue", "tab:orange"
    figure = Figure(figsize=(9.6, 2.7), layout="constrained")
    canvas = FigureCanvasAgg(figure)
    parts = figure.subfigures(1, 3)
    assert isinstance(parts, np.ndarray)
    left, middle, right = parts

    time, rows = jumps(example, plants[0])
    without, found = (respond(plant, rows)[:, 0] for plant in plants)
    above, below = left.subplots(2, 1, sharex=True, height_ratios=[2, 1])
    scale, seconds = (1e3, "ms") if example.span < 0.5 else (1.0, "s")
    above.plot(scale * time, without, color=grey, lw=1.2)
    above.plot(scale * time, found, color=blue, lw=0.8)
    below.plot(scale * time, found - without, color=orange, lw=0.8)
    above.set_ylabel(unit)
    below.set(xlabel=f"time, {seconds}", ylabel="gap")

    rows = multisine(plants[0])
    without, found = (respond(plant, rows)[:, 0] for plant in plants)
    axes = middle.subplots()
    for values, color, width in ((without, grey, 1.6), (found, blue, 0.8), (found - without, orange, 0.8)):
        frequency, density = welch(values, 1.0 / SAMPLE_TIME, nperseg=4096, detrend=False)
        axes.loglog(frequency[1:], np.sqrt(density[1:]) + 1e-300, color=color, lw=width)
    top = np.sqrt(welch(without, 1.0 / SAMPLE_TIME, nperseg=4096)[1].max())
    axes.set(xlabel="frequency, Hz", ylabel=f"{unit} / √Hz", xlim=(5.0, 1e4), ylim=(1e-6 * top, 4.0 * top))

    command, rows = loop(example, plants[0])
    without, found = (respond(plant, rows)[-len(command) :, 0] for plant in plants)
    axes = right.subplots()
    axes.plot(command, without, color=grey, lw=1.2)
    axes.plot(command, found, color=blue, lw=0.8)
    axes.set(xlabel="command, V", ylabel=unit)
    _save(canvas, path)


def _save(canvas: FigureCanvasAgg, path: Path) -> None:
    """Save a picture of few colors, which is a quarter of the size."""
    from PIL import Image

    canvas.figure.set_dpi(80)
    canvas.draw()  # type: ignore[no-untyped-call]  # matplotlib gives it no types
    pixels = np.asarray(canvas.buffer_rgba())  # type: ignore[no-untyped-call]  # as draw
    Image.fromarray(pixels[..., :3].copy()).quantize(48).save(path, optimize=True)


def _plant(example: Example, effects: list[dict[str, Any]]) -> Plant:
    return load_plant({"plant": example.plant, "effects": effects}, seed=1, sample_time=SAMPLE_TIME, noise=0.0)


def _on_axes(first: Array, second: Array, plant: Plant) -> Array:
    return np.stack([first, second][: len(plant.axes)], axis=1)


def jumps(example: Example, plant: Plant) -> tuple[Array, Array]:
    """Construct a rest, a jump up and a smaller one down; the second axis jumps meanwhile."""
    time = np.arange(int(example.span / SAMPLE_TIME), dtype=np.float64) * SAMPLE_TIME
    share, top = time / example.span, plant.rating[1]
    first = np.select([share < 0.1, share < 0.55], [0.1 * top, 0.8 * top], 0.45 * top)
    return time, _on_axes(first, np.select([share < 0.3, share < 0.75], [0.2 * top, 0.9 * top], 0.4 * top), plant)


def multisine(plant: Plant, duration: float = 2.0) -> Annotated[Array, "N A"]:
    """Construct lines of equal size and random phase up to `UPPER_FREQUENCY`, 1.5 Hz apart, about the middle of the rating."""
    time = np.arange(int(duration / SAMPLE_TIME)) * SAMPLE_TIME
    lines = int(UPPER_FREQUENCY / 1.5)
    spectrum = np.zeros((2, len(time) // 2 + 1), dtype=complex)
    places = 3 * np.arange(1, lines + 1)  # of a spacing of 1 / duration = 0.5 Hz
    spectrum[:, places] = np.exp(2j * np.pi * np.random.default_rng(0).random((2, lines)))
    waves = np.fft.irfft(spectrum, len(time), axis=1)
    waves *= 0.13 / waves.std(axis=1, keepdims=True)
    first, second = plant.rating[1] * np.clip(0.5 + waves, 0.0, 1.0)
    return _on_axes(first, second, plant)


def loop(example: Example, plant: Plant) -> tuple[Array, Array]:
    """Construct three cycles over most of the rating; the second axis moves at twice the frequency."""
    cycle = int(round(1.0 / example.frequency / SAMPLE_TIME))
    angle = 2 * np.pi * np.arange(3 * cycle + 1) / cycle
    first = plant.rating[1] * (0.5 - 0.45 * np.cos(angle))
    return first[-cycle - 1 :], _on_axes(first, plant.rating[1] * (0.5 - 0.45 * np.cos(2.0 * angle)), plant)
