"""The MHL paper's tables, and the figures' numbers, as rows beside the published values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hyst_control.chain.stage import Array
from hyst_control.control.measured_margins import measured_margins
from hyst_control.control.tuning import Tuning
from hyst_control.errors import InputError
from hyst_control.identify.dataset import Dataset, Fit
from hyst_control.model_file import Model, simulate
from hyst_control.reporting.tables import Table
from hyst_plant_sim.physics import load_plant

TABLE_1 = {
    ("ascending", "model"): (-0.4624, 1.788, -2.398, 2.037, 2.228),
    ("descending", "model"): (0.9457, -3.005, 3.248, -2.083, 4.104),
    ("ascending", "inverse"): (0.4523, -1.422, 1.7, -1.125, 1.397),
    ("descending", "inverse"): (-0.04333, 0.3898, -0.5418, 0.4221, 0.7696),
}
"""Paper Table 1, signs by closure and monotony; the model's curves end at 3.193 and 3.210 sensor volts."""
TABLE_2 = {"k1": -0.001265 / 3.2, "k2": 0.0007}
"""Paper Table 2; k1 in s, relative to the curves' full output, its sign by the loop's lag."""
TABLE_3 = {
    500.0: (2.65, 1.46),
    1000.0: (8.47, 4.84),
    1500.0: (8.96, 4.88),
    2000.0: (8.99, 4.44),
    3000.0: (6.28, 2.85),
    4000.0: (4.29, 1.87),
}
TABLE_4 = {
    "single": {"traditional composite": (2.43, 1.59), "proposed composite": (0.52, 0.22)},
    "decreasing": {"traditional composite": (2.56, 1.47), "proposed composite": (0.97, 0.58)},
    "multi": {"traditional composite": (1.87, 1.02), "proposed composite": (0.96, 0.58)},
}
"""(NME, NRMSE) in %."""
LOWER = {"single": 86.16, "decreasing": 60.54, "multi": 43.14}
"""Reduction of the NRMSE in % (paper §4.4)."""
NOTES = [
    "MHL Table 4: both composites invert the model of the paper's sequence, as published; the whole inverse and the lifted one invert the "
    "model of all records together, the former of the reference behind a low-pass without phase.",
    "MHL Fig. 18: the lifted inverse has no such low-pass: a jump makes it ring near half the sampling rate, where a model of sampled "
    "records knows least.",
]
COMPOSITES = ("proposed composite", "whole inverse")
Complex = NDArray[np.complex128]


def errors(wanted: Array, actual: Array) -> tuple[float, float, float]:
    """NME and NRMSE in % of the range of `wanted` (paper Eq. 10, 11), and the NRMSE with the means removed."""
    error, span = actual - wanted, float(np.ptp(wanted))
    return tuple(100.0 * float(value) / span for value in (np.abs(error).max(), np.sqrt(np.mean(error**2)), error.std()))


def parameters(table: Table, fit: Fit) -> None:
    """Tables 1 and 2: the curves normalised to end at 1, both axes; the published ones are of another mirror."""
    for index, axis in enumerate(fit.model.axes):
        rows = {row["name"]: row["value"] for row in fit.report["parameters"] if row["axis"] == axis}
        core = next(stage for stage in fit.model.chain.stages if stage.name == "parallel").branches[0][0]
        for (curve, kind), published in TABLE_1.items():
            own = np.array(
                getattr(core, curve)[index] if kind == "model" else fit.report["steps"][index]["inverse"][curve], dtype=float
            )
            for power, value, theirs in zip(range(5, 0, -1), own / own.sum(), np.array(published) / sum(published), strict=True):
                table.add(
                    "MHL Table 1", f"{curve}, power {power}", f"{kind}, axis {axis}", "coefficient", "", value, published=theirs
                )
        table.add(
            "MHL Table 2",
            f"axis {axis}",
            "model",
            "k1 over full output",
            "s",
            rows["k1"] * RATING_OVER / rows["output_scale"],
            published=TABLE_2["k1"],
        )
        table.add("MHL Table 2", f"axis {axis}", "model", "k2", "s", rows["k2"], published=TABLE_2["k2"])
        table.add(
            "MHL Fig. 5", f"axis {axis}", "model", "delay", "us", 1e6 * fit.report["steps"][index]["delay"]["tau"], published=68.0
        )


RATING_OVER = 100.0
"""V, at which the paper's input is 1."""


def predictions(table: Table, models: Mapping[str, Model], static: Dataset, multi: Dataset) -> None:
    """Figs. 9 and 11: held-out records; rows count once the drive has been at the top of the major loop."""
    for title, data, (nme, nrmse) in (("MHL Fig. 9", static, (0.96, 0.25)), ("MHL Fig. 11", multi, (2.66, 0.85))):
        first = int(np.flatnonzero(data.command[:, 0] >= 99.0)[0])
        for method, model in models.items():
            predicted = simulate(model, data.command, data.sample_time)
            for index, axis in enumerate(model.axes):
                found = errors(data.measurement[first:, index], predicted[first:, index])
                add_errors(table, title, f"axis {axis}", f"MHL, {method}", found, (nme, nrmse))


def fast(table: Table, model: Model, data: Dataset, places: Sequence[tuple[float, int, int]]) -> None:
    """Table 3, sines of 10 V about mid-drive."""
    predicted = simulate(model, data.command, data.sample_time)
    for frequency, begin, end in places:
        found = errors(data.measurement[begin:end, 0], predicted[begin:end, 0])
        add_errors(table, "MHL Table 3", f"{frequency:g} Hz", "MHL, paper", found, TABLE_3[frequency])


def add_errors(
    table: Table, title: str, case: str, subject: str, found: tuple[float, float, float], published: tuple[float, float] | None
) -> None:
    """NME, NRMSE, and the NRMSE with the means removed."""
    table.add(title, case, subject, "nme", "%", found[0], published=published[0] if published else None)
    table.add(title, case, subject, "nrmse", "%", found[1], published=published[1] if published else None)
    table.add(title, case, subject, "nrmse, means removed", "%", found[2])


def tracking(table: Table, tracked: Mapping[str, Mapping[str, Array]], parts: Mapping[str, Any]) -> None:
    """Table 4, the reductions of §4.4, and Fig. 17's spiral."""
    for case, published in TABLE_4.items():
        part = parts[case]
        found = {}
        for name, signals in tracked.items():
            found[name] = errors(*(signals[key][part.scored : part.end, 0] for key in ("reference", "measurement")))
            theirs = published.get(name, published["proposed composite"] if name == "whole inverse" else None)
            add_errors(table, "MHL Table 4", case, name, found[name], theirs)
        for name in COMPOSITES:
            lower = 100.0 * (1.0 - found[name][1] / found["traditional composite"][1])
            table.add(
                "MHL Table 4", case, f"{name} against the traditional one", "nrmse lower by", "%", lower, published=LOWER[case]
            )
    part = parts["spiral"]
    for name, signals in tracked.items():
        for index, axis in enumerate("xy"):
            add_errors(
                table,
                "MHL Fig. 17",
                f"spiral, axis {axis}",
                name,
                errors(*(signals[key][part.scored : part.end, index] for key in ("reference", "measurement"))),
                None,
            )


def error_spectrum(
    table: Table,
    tracked: Mapping[str, Mapping[str, Array]],
    part: Any,
    sample_time: float,
    frequency: float = 100.0,
    highest: int = 10,
) -> None:
    """What the error of the single frequency consists of, in % of the range: fundamental, harmonics up to `highest`, and the rest."""
    for name, signals in tracked.items():
        wanted, actual = (signals[key][part.scored : part.end, 0] for key in ("reference", "measurement"))
        spectrum = np.fft.rfft(actual - wanted) / len(wanted)
        power = 2.0 * np.abs(spectrum) ** 2
        power[0] /= 2.0
        if len(wanted) % 2 == 0:
            power[-1] /= 2.0
        cycle = int(round(frequency * sample_time * len(wanted)))
        lines = {
            "mean": power[:1],
            "fundamental": power[cycle : cycle + 1],
            "second harmonic": power[2 * cycle : 2 * cycle + 1],
            "third harmonic": power[3 * cycle : 3 * cycle + 1],
            f"harmonics 4 to {highest}": power[4 * cycle : highest * cycle + 1 : cycle],
        }
        rest = power.sum() - sum(part.sum() for part in lines.values())
        for quantity, value in (*((key, each.sum()) for key, each in lines.items()), ("rest", max(rest, 0.0))):
            table.add(
                "MHL Table 4: the error at 100 Hz", "single", name, quantity, "%", 100.0 * float(np.sqrt(value) / np.ptp(wanted))
            )


def response(signals: Mapping[str, Array], part: Any, sample_time: float, period: float = 0.2) -> tuple[Array, Complex]:
    """Frequency response from reference to measurement of axis x: frequencies (F,) Hz and values, from the small multisine."""
    count = int(round(period / sample_time))
    r, y = (
        np.fft.rfft(signals[key][part.scored : part.end, 0].reshape(-1, count).mean(axis=0)) for key in ("reference", "measurement")
    )
    line = np.flatnonzero(np.abs(r) > 1e-3 * np.abs(r[1:]).max())
    line = line[line > 0]
    return line / period, y[line] / r[line]


def fundamental(signals: Mapping[str, Array], part: Any, sample_time: float, frequency: float) -> complex:
    """Measurement over reference at one frequency, over whole cycles."""
    rows = slice(part.scored, part.end)
    turn = np.exp(-2j * np.pi * frequency * sample_time * np.arange(part.end - part.scored))
    return complex((turn @ signals["measurement"][rows, 0]) / (turn @ signals["reference"][rows, 0]))


def bandwidth(frequency: Array, value: Complex) -> float:
    """The first frequency (Hz) from which a mean over 30 Hz stays below -3 dB of it; the last line when there is none."""
    size = np.sqrt(np.convolve(np.abs(value) ** 2, np.ones(3) / 3.0, "valid"))
    below = np.flatnonzero(size < np.sqrt(0.5))
    return float(frequency[1:-1][below[0]]) if len(below) else float(frequency[-1])


def settling_time(signals: Mapping[str, Array], part: Any, sample_time: float) -> float:
    """Time (s) after the step from which the measurement stays within 2 % of its height."""
    reference, measurement = (signals[key][part.begin : part.end, 0] for key in ("reference", "measurement"))
    height = reference[-1] - reference[0]
    start = int(np.flatnonzero(reference != reference[0])[0])
    outside = np.flatnonzero(np.abs(measurement[start:] - reference[-1]) > 0.02 * abs(height))
    return sample_time * float(outside[-1] + 1 if len(outside) else 0)


def closed_loop(table: Table, tracked: Mapping[str, Mapping[str, Array]], parts: Mapping[str, Any], sample_time: float) -> None:
    """Fig. 18: bandwidth, peak, gain and phase at 100 Hz, settling time."""
    for name, signals in tracked.items():
        composite = name in COMPOSITES
        frequency, value = response(signals, parts["response"], sample_time)
        table.add(
            "MHL Fig. 18",
            "closed loop",
            name,
            "bandwidth",
            "Hz",
            bandwidth(frequency, value),
            published=1500.0 if composite else None,
        )
        table.add(
            "MHL Fig. 18",
            "closed loop",
            name,
            "peak",
            "dB",
            20 * np.log10(np.abs(value).max()),
            published=2.94 if composite else None,
        )
        at = fundamental(signals, parts["single"], sample_time, 100.0)
        table.add("MHL Fig. 18", "100 Hz", name, "gain", "dB", 20 * np.log10(abs(at)), published=0.2 if composite else None)
        table.add("MHL Fig. 18", "100 Hz", name, "lag", "deg", -np.degrees(np.angle(at)), published=0.69 if composite else None)
        table.add(
            "MHL Fig. 18",
            "step",
            name,
            "settling_time",
            "ms",
            1e3 * settling_time(signals, parts["step"], sample_time),
            published=2.0 if composite else None,
        )
        for case in (case for case in parts if case.startswith("step of")):
            table.add("MHL Fig. 18", case, name, "settling_time", "ms", 1e3 * settling_time(signals, parts[case], sample_time))


def robustness(table: Table, tuning: Tuning, plant: str = "fsm", title: str = "MHL robustness") -> None:
    """The tuned loop of its model, and its margins as measured on the truth plant with other gains and first modes."""
    for quantity, unit in (("kp", "V/unit"), ("ki", "V/(unit s)"), ("settling_time", "s")):
        table.add(title, "model", "tuned PI", quantity, unit, getattr(tuning, quantity))
    table.add(title, "model", "tuned PI", "bandwidth", "Hz", tuning.nominal.bandwidth)
    for quantity, unit in (("gain_margin", "dB"), ("phase_margin", "deg"), ("peak_sensitivity", "")):
        table.add(title, "model, worst case", "tuned PI", quantity, unit, getattr(tuning.worst, quantity))
    for gain in (0.9, 1.0, 1.1):
        for mode in (0.8, 1.0, 1.2):
            found = truth_margins(tuning, gain, mode, plant)
            case = f"truth, gain {gain - 1:+.0%}, first mode {mode - 1:+.0%}"
            table.add(title, case, "tuned PI", "gain_margin", "dB", found[0])
            table.add(title, case, "tuned PI", "phase_margin", "deg", found[1])


def truth_margins(tuning: Tuning, gain: float, mode: float, plant: str = "fsm") -> tuple[float, float]:
    """Gain (dB) and phase margin (degrees), the lesser of all axes; not a number where the loop is not stable."""
    modes, centre, rms, top = MEASURED[plant]
    found = []
    for axis in range(len(modes)):
        given = {"plant": plant, "effects": [{"name": "gain", "gain": gain - 1.0}] if gain != 1.0 else []}
        frequency = [mode * value for value in modes] if len(modes) > 1 else mode * modes[0]
        truth = load_plant(given, seed=axis, sample_time=tuning.sample_time, mode_frequency=frequency)
        try:
            found.append(measured_margins(truth, tuning.controller(0.0, top), len(modes), axis, centre, rms))
        except InputError:
            return float("nan"), float("nan")
    return min(each.gain_margin for each in found), min(each.phase_margin for each in found)


MEASURED = {"fsm": ((1930.0, 1965.0), 1.0, 0.02, 100.0), "pea": ((1231.0,), 6.0, 0.1, 150.0)}
"""First modes in Hz, of the plants' files: only for moving them where the tuned loop is put to the test; operating point and rms
of the reference's multisine in the measurement unit; upper rating in V."""
