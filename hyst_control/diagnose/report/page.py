# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The gap report as one self-contained HTML page: the verdict, the signals before and after, what to do; all else is folded.

Three numbers are told apart everywhere on the page: a *share* is a part of the gap's energy (mean square) on the whole record, *shrink*
is how much less energy beyond the noise floor is left on samples that did not fit, and a *probability* is that of an explanation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from hyst_control.base.arrays import Array
from hyst_control.base.signals import averaged_periodogram
from hyst_control.diagnose.problem.per_record_stages import SessionZero
from hyst_control.diagnose.report.chain_drawing import chain_picture
from hyst_control.diagnose.report.coefficient_changes import LIKELY, coefficient_changes
from hyst_control.diagnose.report.document import SAID, plain, reduction, sentence, within
from hyst_control.diagnose.report.rejected_hypotheses import rejected
from hyst_control.diagnose.report.slow_loops import slow_loops
from hyst_control.diagnose.run.diagnosis import AxisDiagnosis, Diagnosis
from hyst_control.diagnose.verdict import Verdict
from hyst_control.model_file import Model
from hyst_control.reporting.figure import Figure
from hyst_control.reporting.html_page import BAND, Palette, figure_markup, library
from hyst_control.reporting.html_page import write_page as write_template
from hyst_control.reporting.provenance import Origin
from hyst_control.reporting.quantities import quantity
from hyst_control.reporting.signal_figures import thinned

BINS = 1000  # Stretches of a drawn signal of which the least and the greatest sample are kept

BAND_POINTS = 400
LOOP_POINTS = 1500
MAX_FIGURES = 4
MAX_CANDIDATES = 12
MAX_REJECTED = 8
MAX_COEFFICIENTS = 15
PALETTE = Palette("measured", "simulated", "augmented", "taken off", "noise")
MEASURED, SIMULATED, AUGMENTED, TAKEN_OFF = (PALETTE.color(name) for name in ("measured", "simulated", "augmented", "taken off"))
ADVICE = {
    Verdict.NO_GAP: "Nothing: the simulator explains the record within noise and tolerance.",
    Verdict.PARAMETERS: "Take the values above, or identify the model again: the machine changed, or the model was never right there.",
    Verdict.EFFECT: "Look for its cause ({effects}) in the machine, or simulate with the augmented model. Confirm it with a second record.",
    Verdict.AMBIGUOUS: "Record another signal: {effects} explain this record equally well.",
    Verdict.UNKNOWN: "Look at the residual and at where the gap lies: no effect of the catalogue explains it.",
}
"""Advice by verdict."""
WHERE = ("stage", "kind", "band", "amplitude", "axis", "time")


@dataclass(frozen=True)
class Traces:
    """A piece as it is drawn: time (N,) s, then command, measured, simulated and augmented (None: nothing added), (N, A) each.

    band: half of the interval (N, A) that 90 % of the residual lie in where only noise, the tolerance of the coefficients and the
    model's own error are at work; NaN in rows that do not count.
    """

    time: Array
    command: Array
    measured: Array
    simulated: Array
    augmented: Array | None
    band: Array

    @property
    def curves(self) -> dict[str, Array]:
        """Simulated signals by name."""
        return {"simulated": self.simulated} | ({} if self.augmented is None else {"augmented": self.augmented})


def write_page(
    path: Path, document: Mapping[str, Any], diagnosis: Diagnosis, better: Model | None, origins: Sequence[Origin] = ()
) -> None:
    """Write the page of a diagnosis."""
    library()  # is compressed while the figures are drawn
    pieces, unit = traces_of(diagnosis, better), document["gap"]["unit"]
    signals = [
        figure_markup(_signals(piece, axis, _title(index, name, len(pieces), diagnosis), unit), 620)
        for index, piece in enumerate(pieces)
        for axis, name in enumerate(diagnosis.model.axes)
    ]
    weighed = document["candidates"][:MAX_CANDIDATES]
    write_template(
        path,
        "diagnose/templates/gap.html",
        "Gap report",
        sentence(dict(document)),
        origins=origins,
        chain=chain_picture(document),
        effects=[_effect_row(effect) for effect in document["effects"]],
        meanings=list(dict.fromkeys(f"{effect['name'].replace('_', ' ')}: {effect['meaning']}" for effect in document["effects"])),
        rivals=[
            (row.name, row.axes, plain(row.behind, 3), _percent(row.left), row.why) for row in rejected(diagnosis, MAX_REJECTED)
        ],
        augmented=better is not None,
        signals=signals,
        actions=actions(document),
        pieces_drawn=len(pieces),
        pieces=len(diagnosis.problem.pieces),
        waterfall=figure_markup(_waterfall(document), 400),
        spectrum=figure_markup(_spectrum(pieces, diagnosis, unit), 400),
        loops=figure_markup(_loops(pieces[0], diagnosis, unit), 760),
        where=_where(document, len(diagnosis.model.axes)),
        candidates=figure_markup(_candidates(weighed), 150 + 28 * len(weighed)) if weighed else None,
        next_experiment=document["next_experiment"],
        coefficients=[
            (row.name, plain(row.before, 5), f"{within(row.after, row.spread)} {row.unit}".rstrip(), f"{row.deviations:+.1f}")
            for row in [each for each in coefficient_changes(diagnosis) if each.is_certain][:MAX_COEFFICIENTS]
        ],
        replay=[(block["name"], block["text"]) for block in document["replay"]],
        notes=document["notes"],
    )


def actions(document: Mapping[str, Any]) -> list[str]:
    """Advice on a gap, a sentence each."""
    effects = " and ".join(dict.fromkeys(effect["name"].replace("_", " ") for effect in document["effects"])) or "the cause"
    found = [ADVICE[Verdict(document["verdict"])].format(effects=effects)]
    following = document["next_experiment"]
    if following:
        found.append(
            f"{following['excitation']} separates {' from '.join(following['separates'])} by {following['distance']:.1f} standard "
            f"deviations{'; ' + following['note'] if following['note'] else ''}. Its configuration is below."
        )
    return found


def traces_of(diagnosis: Diagnosis, better: Model | None) -> list[Traces]:
    """The first pieces, whole, in the measurement's unit."""
    problem, found = diagnosis.problem, []
    for index, piece in enumerate(problem.pieces[: max(MAX_FIGURES // len(diagnosis.model.axes), 1)]):
        whole = type(problem)(
            problem.model, (type(piece)(piece.command, piece.measurement),), problem.sample_time, problem.hold, problem.sigma
        )
        usual = np.concatenate([_usual_zero(part, index, len(piece.command)) for part in diagnosis.parts], axis=1)
        augmented = None if better is None else whole.rows(whole.simulate(better.chain.stages)) + usual
        found.append(
            Traces(
                np.arange(len(piece.command), dtype=np.float64) * problem.sample_time,
                piece.command,
                piece.measurement,
                whole.rows(whole.simulate(diagnosis.model.chain.stages)) + usual,
                augmented,
                np.concatenate([_band(part, index, len(piece.command)) for part in diagnosis.parts], axis=1),
            )
        )
    return found


def _usual_zero(part: AxisDiagnosis, index: int, rows: int) -> Array:
    """Zero and drift (N, A) that a session of the unit usually has, measurement unit."""
    time, zero = part.problem.sample_time * np.arange(rows, dtype=np.float64)[:, None], np.zeros((rows, len(part.axes)))
    for stage in part.problem.model.chain.stages:
        if isinstance(stage, SessionZero):
            zero = replace(stage, record=index).function(len(part.axes))(zero, time)
    return zero


def _band(part: AxisDiagnosis, index: int, rows: int) -> Array:
    """Half interval (N, A) of a piece: noise, coefficients within their tolerance, and the model discrepancy."""
    problem, linearized = part.problem, part.linearized
    axes = len(problem.model.axes)
    own = np.zeros(axes) if problem.own_error is None else problem.own_error
    uncertain = 1.0 - linearized.scatter.companions if linearized.count else np.zeros(0)
    energy = (linearized.columns**2 @ uncertain).reshape(-1, axes) * problem.sigma**2 + problem.sigma**2 + own**2
    band = np.full((rows, axes), np.nan)
    if len(problem.pieces[index].command) == rows:
        band[problem.pieces[index].mask] = LIKELY * np.sqrt(np.split(energy, problem.edges)[index])
    return band


def _title(index: int, axis: str, pieces: int, diagnosis: Diagnosis) -> str:
    parts = ([f"stretch {index + 1}"] if pieces > 1 else []) + ([f"axis {axis}"] if len(diagnosis.model.axes) > 1 else [])
    return ", ".join(parts)


def _curve(time: Array, values: Array) -> dict[str, Any]:
    """A signal thinned to the least and greatest sample of every stretch."""
    x, y = thinned(time, values, 2 * BINS)
    return {"x": x.astype(np.float32), "y": y.astype(np.float32)}


def _signals(piece: Traces, axis: int, title: str, unit: str) -> Figure:
    """Signals small, as they nearly coincide; what they differ by large, over the band of what the model does not claim to know."""
    figure = Figure(2, spacing=(None, 0.06), heights=[0.34, 0.66], shared_x=True)
    x, half = _thinned_band(piece.time, piece.band[:, axis])
    look: dict[str, Any] = {"mode": "lines", "line": {"width": 0}, "legendgroup": "band", "hoverinfo": "skip"}
    figure.add("scatter", 2, x=x, y=-half, showlegend=False, **look)
    name = "noise, tolerance and model discrepancy, 90 %"
    figure.add("scatter", 2, x=x, y=half, name=name, fill="tonexty", fillcolor=BAND, **look)
    for name, values in {"measured": piece.measured, **piece.curves}.items():
        look = {"name": name, "legendgroup": name, "line": {"color": PALETTE.color(name), "width": 1.2}}
        figure.add("scatter", **_curve(piece.time, values[:, axis]), **look)
        if name != "measured":
            look |= {"showlegend": False, "line": {"color": PALETTE.color(name), "width": 1.0}}
            figure.add("scatter", 2, **_curve(piece.time, piece.measured[:, axis] - values[:, axis]), **look)
    figure.axes("y", 1, title=f"displacement [{unit}]")
    figure.axes("y", 2, title=f"residual [{unit}]")
    figure.axes("x", 2, title="time [s]")
    figure.layout |= {"title": {"text": title}, "hovermode": "x unified"}
    return figure


def _thinned_band(time: Array, half: Array) -> tuple[Array, Array]:
    """The largest half interval of every stretch, as the residual is drawn by its extremes."""
    edges = np.unique(np.linspace(0, len(time), min(BAND_POINTS, len(time)) + 1).astype(int))
    counted = np.where(np.isnan(half), 0.0, half)
    return time[edges[:-1]].astype(np.float32), np.maximum.reduceat(counted, edges[:-1]).astype(np.float32)


def _waterfall(document: Mapping[str, Any]) -> Figure:
    """The gap's energy from the simulator as given to what is left: each bar carries what it takes off, in shares of the gap."""
    rows = taken_off(document)
    left = 1.0 - sum(share for _, share in rows)
    gap, unit = document["gap"], document["gap"]["unit"]
    labels = ["gap", *(f"− {name.replace('_', ' ')}" for name, _ in rows), "left"]
    values = [100.0, *(-100.0 * share for _, share in rows), 0.0]
    figure = Figure()
    figure.add(
        "waterfall",
        x=labels,
        y=np.array(values),
        measure=["absolute", *["relative"] * len(rows), "total"],
        text=[
            f"100 %, {gap['rms']:.3g} {unit} rms",
            *(f"−{_percent(share)}" for _, share in rows),
            f"{_percent(left)}, {gap['rms'] * np.sqrt(max(left, 0.0)):.3g} {unit} rms",
        ],
        textposition=["outside", *["inside" if share > 0.2 else "outside" for _, share in rows], "outside"],
        connector={"line": {"color": "#9aa1ab"}},
        totals={"marker": {"color": SIMULATED}},
        decreasing={"marker": {"color": TAKEN_OFF}},
        cliponaxis=False,
    )
    figure.axes("y", title="share of the gap's energy", ticksuffix=" %", range=[-12.0, 118.0])
    return figure


def taken_off(document: Mapping[str, Any]) -> list[tuple[str, float]]:
    """Shares of the gap's energy that the named effects and the coefficients take off, as the chain's picture has them."""
    stage = {row["name"]: row["share"] for row in document["where"]["stage"]}
    effects = [effect for effect in document["effects"] if effect["shrink"] is not None]
    whole = sum(share for name, share in stage.items() if name not in ("coefficients", "noise", "unexplained"))
    rows = [(effect["name"], whole * effect["share"]) for effect in effects]
    return [*rows, ("coefficients", stage.get("coefficients", 0.0))]


def _spectrum(pieces: Sequence[Traces], diagnosis: Diagnosis, unit: str) -> Figure:
    rate, figure = 1.0 / diagnosis.problem.sample_time, Figure()
    axes = diagnosis.model.axes
    longest = max(pieces, key=lambda piece: len(piece.time))
    window = min(len(longest.time), max(len(longest.time) // 4, 256))
    sigma = np.concatenate([part.problem.sigma for part in diagnosis.parts])
    for axis, name in enumerate(axes):
        suffix = f", {name}" if len(axes) > 1 else ""
        dash = ("solid", "dot", "dashdot")[axis % 3]
        for label, values in longest.curves.items():
            frequency, power = averaged_periodogram(longest.measured[:, axis] - values[:, axis], rate, window, centered=False)
            line = {"color": PALETTE.color(label), "width": 1.3, "dash": dash}
            figure.add("scatter", x=frequency[1:], y=np.sqrt(power[1:]), name=label + suffix, line=line)
        floor = float(sigma[axis]) * np.sqrt(2.0 / rate)
        line = {"color": MEASURED, "dash": "dash"}
        figure.add(
            "scatter", x=frequency[[1, -1]], y=np.array([floor, floor]), name="noise floor" + suffix, mode="lines", line=line
        )
    figure.axes("x", type="log", title="frequency [Hz]")
    figure.axes("y", type="log", title=f"residual [{unit}/√Hz]", exponentformat="power")
    return figure


def _loops(piece: Traces, diagnosis: Diagnosis, unit: str) -> Figure:
    """Slow loops of the first piece, and below what the curves differ from the measured one by, which the loops are too large to show."""
    axes = diagnosis.model.axes
    titles = [f"axis {name}" for name in axes] if len(axes) > 1 else []
    figure = Figure(2, len(axes), titles=titles, spacing=(None, 0.05), shared_x=True)
    looks: dict[str, dict[str, Any]] = {
        "measured": {"width": 3.0},
        "simulated": {"width": 1.6, "dash": "dash"},
        "augmented": {"width": 1.6, "dash": "dot"},
    }
    for axis in range(len(axes)):
        chosen = slow_loops(piece.command[:, axis])
        for name, values in {"measured": piece.measured, **piece.curves}.items():
            x = _joined([piece.command[rows, axis] for rows in chosen])
            y = _joined([values[rows, axis] for rows in chosen])
            look = {"name": name, "legendgroup": name, "line": {"color": PALETTE.color(name), **looks[name]}, "mode": "lines"}
            figure.add("scatter", 1, axis + 1, x=x, y=y, showlegend=axis == 0, **look)
            if name != "measured":
                error = _joined([piece.measured[rows, axis] - values[rows, axis] for rows in chosen])
                figure.add("scatter", 2, axis + 1, x=x, y=error, showlegend=False, **look)
    figure.axes("x", 2, title=f"command [{diagnosis.model.units['command']}]")
    figure.axes("y", 1, 1, title=f"displacement [{unit}]")
    figure.axes("y", 2, 1, title=f"measured − curve [{unit}]")
    return figure


def _joined(loops: Sequence[Array]) -> Array:
    """Loops one after the other with a break between, thinned."""
    most = LOOP_POINTS // max(len(loops), 1)
    parts = [np.append(loop[:: max(len(loop) // most, 1)], np.nan) for loop in loops]
    return np.concatenate(parts)[:-1].astype(np.float32)


def _where(document: Mapping[str, Any], axes: int) -> Markup:
    """Bars of shares: one group beside the other, axes only where there are several."""
    names = [name for name in WHERE if axes > 1 or name != "axis"]
    columns = 2
    counts = [max(len(document["where"][name]) for name in names[i : i + columns]) for i in range(0, len(names), columns)]
    lines = len(counts)
    titles = [f"<b>by {SAID.get(name, name)}</b>" for name in names]
    figure = Figure(lines, columns, titles=titles, spacing=(0.2, 0.22 / lines), heights=counts)
    for index, name in enumerate(names):
        rows = document["where"][name][::-1]
        share = 100.0 * np.array([row["share"] for row in rows])
        low, high = 100.0 * np.array([row["ci90"] for row in rows], dtype=float).reshape(-1, 2).T
        figure.add(
            "bar",
            index // columns + 1,
            index % columns + 1,
            x=share,
            y=[SAID.get(row["name"], row["name"]) for row in rows],
            orientation="h",
            marker={"color": SIMULATED},
            showlegend=False,
            error_x={"type": "data", "symmetric": False, "array": high - share, "arrayminus": share - low, "thickness": 1},
        )
    figure.axes("x", range=[0, 105], ticksuffix=" %", nticks=4)
    return figure_markup(figure, 120 * lines + 24 * sum(counts), 560)


def _effect_row(effect: Mapping[str, Any]) -> tuple[str, ...]:
    """Cells of an effect's row."""
    values = "; ".join(
        f"{name} {_number(row['value'], row['unit'])} [{_number(row['ci90'][0], row['unit'])} … {_number(row['ci90'][1], row['unit'])}]"
        for name, row in effect["parameters"].items()
    )
    return (
        effect["name"].replace("_", " "),
        ", ".join(effect["axis"]),
        f"{effect['probability']:.2f}",
        values,
        reduction(effect["shrink"], effect["shrink_ci90"]),
        reduction(effect["shrink_reidentified"]),
        ", ".join(effect["equivalent"]) or "–",
    )


def _candidates(rows: Sequence[Mapping[str, Any]]) -> Figure:
    figure = Figure()
    figure.add(
        "bar",
        x=np.array([row["probability"] for row in rows][::-1]),
        y=[row["name"].replace("_", " ") for row in rows][::-1],
        orientation="h",
        marker={"color": AUGMENTED},
        text=[f"{row['probability']:.3f}" for row in rows][::-1],
    )
    figure.axes("x", range=[0, 1.05], title="probability")
    return figure


def _number(value: float | None, unit: str) -> str:
    if value is None:
        return "?"
    return quantity(value, unit, 4) if unit else f"{value:.4g}"


def _percent(share: float) -> str:
    digits = 0 if abs(share) >= 0.1 else 1 if abs(share) >= 0.01 else 2
    return f"{100 * share:.{digits}f} %"
