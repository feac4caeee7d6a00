# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Figures of the effects: a record with each and without it.

`hyst cases figures --output docs/figures/effects` draws them. The records are of the reference simulation of the PEA (effects that need
two axes: of the mirror) without noise. The effects are stronger than in a blind case, so that they are visible.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

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


EXAMPLES: dict[str, Example] = {
    "dac_hold": Example(
        {"samples": 12},
        0.008,
        200.0,
        "Stairs after every command, images of the motion above half the slower rate, on average a delay of half of what is held.",
    ),
    "clock_rate_mismatch": Example(
        {"share": 0.005},
        0.2,
        100.0,
        "A delay that grows from the first sample to the last: a fitted one is another in every stretch.",
    ),
    "delay": Example(
        {"tau": 0.0004},
        0.008,
        100.0,
        "The gap is the motion's own velocity times the delay: nothing at rest, growing with frequency, no change of amplitude.",
    ),
    "slew_limit": Example({"rate": 3e4}, 0.02, 200.0, "Ramps after large jumps only; small or slow motion has no gap at all."),
    "saturation": Example(
        {"lower": 15.0, "upper": 110.0},
        0.02,
        10.0,
        "Flat tops at one voltage, whatever the frequency; harmonics when the range is used.",
    ),
    "crossover_dead_band": Example(
        {"half_width": 6.0},
        0.02,
        10.0,
        "A flat piece in the middle of the range, at every frequency, on the way up as on the way down.",
    ),
    "amplifier_lowpass": Example(
        {"cutoff": 500.0},
        0.01,
        100.0,
        "Less and later at high frequencies. Before the hysteresis: the loop's turning points move too.",
    ),
    "hysteresis_width": Example(
        {"width": 0.5}, 0.02, 10.0, "Loops grow wider at every frequency; the curve through their middle stays."
    ),
    "hysteresis_shape": Example({"amount": 0.06}, 0.02, 10.0, "A bow over the range that both branches share; none at its ends."),
    "hysteresis_rate": Example(
        {"factor": 3.0}, 0.01, 200.0, "Slow loops stay; fast ones turn and widen, the more the higher the drive."
    ),
    "gain_scheduled_hysteresis": Example(
        {"amount": 1.5},
        0.2,
        5.0,
        "The loop's width follows where the drive was lately: loops at the bottom and at the top of the range differ.",
    ),
    "creep": Example(
        {"gamma": 0.06}, 4, 1.0, "After a step the output goes on, by about the same every time the elapsed time is tenfold."
    ),
    "resonance": Example(
        {"frequency": 600.0, "damping": 0.02, "gain": 0.08},
        0.03,
        100.0,
        "A ringing after steps and a narrow peak that no nominal mode explains.",
    ),
    "added_mass": Example(
        {"mass_ratio": 0.8}, 0.008, 300.0, "The main mode comes down in frequency and rings more; slow motion is untouched."
    ),
    "duffing_stiffness": Example(
        {"share": 0.25},
        0.01,
        10.0,
        "Less stroke at large displacements, at every frequency; the mode goes up in frequency where the displacement is large.",
    ),
    "guide_friction": Example(
        {"share": 0.04},
        0.02,
        10.0,
        "A wider loop with a soft start after every turning point, of one height for slow and fast motion.",
    ),
    "wandering_mode": Example(
        {"change": 0.35, "period": 0.7},
        0.008,
        300.0,
        "The peak is smeared: what fits one stretch of the record does not fit the next.",
    ),
    "backlash": Example(
        {"half_width": 0.4}, 0.02, 10.0, "Standstill after every reversal, of one width for small and large motion."
    ),
    "vibration": Example(
        {"amplitude": 0.3, "frequency": 173.0},
        0.1,
        10.0,
        "A line in the spectrum a little wider than a tone, whether or not the drive moves.",
    ),
    "cross_coupling": Example(
        {"coupling": 0.08, "corner": 2000.0},
        0.02,
        10.0,
        "The axis moves while its own command rests, with the spectrum of the other axis.",
        plant="fsm",
    ),
    "sensor_lowpass": Example(
        {"cutoff": 500.0},
        0.01,
        100.0,
        "Less and later at high frequencies, after the hysteresis: as if the motion were seen through a filter.",
    ),
    "sensor_nonlinearity": Example(
        {"second": 0.3, "third": 0.2},
        0.02,
        10.0,
        "An error that depends on the reading alone, at every frequency and on both branches.",
    ),
    "gain": Example({"gain": 0.08}, 0.02, 10.0, "A gap in proportion to the motion, at every frequency alike."),
    "gain_drift": Example(
        {"change": 0.1, "tau": 1.0}, 4, 1.0, "Nothing at the start, then a share of the motion that grows over the record."
    ),
    "offset": Example({"offset": 0.6}, 0.02, 10.0, "A constant, at rest too; nothing in the spectrum but its zero line."),
    "offset_drift": Example({"change": 0.8, "tau": 1.0}, 4, 1.0, "A slow curve over the record that does not know the command."),
    "mains_hum": Example(
        {"amplitude": 0.25, "frequency": 50.0},
        0.1,
        10.0,
        "Lines at 50 Hz, 150 Hz and 250 Hz, of one phase throughout, with and without drive.",
    ),
    "sensor_noise": Example({"rms": 0.08}, 0.02, 10.0, "Flat in the spectrum, the same at rest and in motion."),
    "flicker_noise": Example({"rms": 0.15}, 0.2, 10.0, "Rises towards low frequencies, wanders at rest."),
    "outliers": Example({"fraction": 0.01, "size": 2.0}, 0.02, 10.0, "Single samples far off, their neighbors untouched."),
    "quantization": Example(
        {"step": 0.25},
        0.02,
        10.0,
        "Readings on a lattice, best seen at rest; flat in the spectrum when the motion crosses many steps.",
    ),
    "held_samples": Example({"fraction": 0.3}, 0.008, 200.0, "Readings that repeat; the gap is as large as the motion is fast."),
}


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
    without, found = (_answer(plant, rows) for plant in plants)
    above, below = left.subplots(2, 1, sharex=True, height_ratios=[2, 1])
    scale, seconds = (1e3, "ms") if example.span < 0.5 else (1.0, "s")
    above.plot(scale * time, without, color=grey, lw=1.2)
    above.plot(scale * time, found, color=blue, lw=0.8)
    below.plot(scale * time, found - without, color=orange, lw=0.8)
    above.set_ylabel(unit)
    below.set(xlabel=f"time, {seconds}", ylabel="gap")

    rows = multisine(plants[0])
    without, found = (_answer(plant, rows) for plant in plants)
    axes = middle.subplots()
    for values, color, width in ((without, grey, 1.6), (found, blue, 0.8), (found - without, orange, 0.8)):
        frequency, density = welch(values, 1.0 / SAMPLE_TIME, nperseg=4096, detrend=False)
        axes.loglog(frequency[1:], np.sqrt(density[1:]) + 1e-300, color=color, lw=width)
    top = np.sqrt(welch(without, 1.0 / SAMPLE_TIME, nperseg=4096)[1].max())
    axes.set(xlabel="frequency, Hz", ylabel=f"{unit} / √Hz", xlim=(5.0, 1e4), ylim=(1e-6 * top, 4.0 * top))

    command, rows = loop(example, plants[0])
    without, found = (_answer(plant, rows)[-len(command) :] for plant in plants)
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


def _answer(plant: Plant, rows: Array) -> Array:
    """The first axis' measurement (N,)."""
    return np.concatenate([plant.reset(rows[0])[None], plant.step(rows)[:-1]])[:, 0]


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
