"""The gap report as one self-contained HTML page: the verdict, where the gap lies, what it looks like, what explains it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots
from scipy.signal import welch

from hyst_control.chain.stage import Array
from hyst_control.diagnose.chain_drawing import chain_picture
from hyst_control.diagnose.diagnosis import AxisDiagnosis, Diagnosis
from hyst_control.diagnose.gap_reduction import shares
from hyst_control.diagnose.gap_report import sentence
from hyst_control.model_file import Model
from hyst_control.reporting.html_page import figure_markup
from hyst_control.reporting.html_page import write_page as write_template

BINS = 3000
"""Stretches of a drawn signal of which the least and the greatest sample are kept."""

LOOP_POINTS = 5000
MOST_PIECES = 4
MOST_CANDIDATES = 12
MOST_COEFFICIENTS = 15
INK, ORANGE, BLUE = "#1c2430", "#c2542d", "#2a6f97"
WHERE = {
    "stage": "by place in the chain",
    "kind": "by kind",
    "band": "by frequency",
    "amplitude": "by displacement",
    "axis": "by axis",
    "time": "by time",
}


@dataclass(frozen=True)
class Traces:
    """A piece as it is drawn: time (N,) s, then command, measured, simulated and augmented (None: nothing added), (N, A) each."""

    time: Array
    command: Array
    measured: Array
    simulated: Array
    augmented: Array | None


def write_page(path: Path, document: Mapping[str, Any], diagnosis: Diagnosis, better: Model | None) -> None:
    """Write the page of a diagnosis.

    Parameters
    ----------
    path
        HTML file to write.
    document
        The diagnosis' gap report.
    diagnosis
        The diagnosis itself, for the figures.
    better
        The augmented model; None where nothing was added.

    Raises
    ------
    InputError
        When the file cannot be written.
    """
    pieces, unit = _traces(diagnosis, better), document["gap"]["unit"]
    signals = [
        figure_markup(_signals(piece, axis, _title(index, name, len(pieces), diagnosis), unit), 560)
        for index, piece in enumerate(pieces)
        for axis, name in enumerate(diagnosis.model.axes)
    ]
    weighed = document["candidates"][:MOST_CANDIDATES]
    write_template(
        path,
        "diagnose/templates/gap.html",
        "Where simulation and record part",
        sentence(dict(document)),
        chain=chain_picture(document),
        effects=[_effect_row(effect) for effect in document["effects"]],
        meanings=list(dict.fromkeys(f"{effect['name'].replace('_', ' ')}: {effect['meaning']}" for effect in document["effects"])),
        augmented=better is not None,
        signals=signals,
        pieces_drawn=len(pieces),
        pieces=len(diagnosis.problem.pieces),
        waterfall=figure_markup(_waterfall(diagnosis, document), 380),
        spectrum=figure_markup(_spectrum(pieces, diagnosis, unit), 400),
        loops=figure_markup(_loops(pieces[0], diagnosis, unit), 440),
        where=figure_markup(_where(document), 620),
        candidates=figure_markup(_candidates(weighed), 150 + 28 * len(weighed)) if weighed else None,
        next_experiment=document["next_experiment"],
        coefficients=[(row["name"], f"{row['z']:+.1f}") for row in document["parameters"][:MOST_COEFFICIENTS]],
        replay=[(block["name"], block["text"]) for block in document["replay"]],
        notes=document["notes"],
    )


def _traces(diagnosis: Diagnosis, better: Model | None) -> list[Traces]:
    """The first pieces, whole, in the measurement's unit."""
    problem, found = diagnosis.problem, []
    for piece in problem.pieces[:MOST_PIECES]:
        whole = type(problem)(
            problem.model, (type(piece)(piece.command, piece.measurement),), problem.sample_time, problem.hold, problem.sigma
        )
        augmented = None if better is None else whole.rows(whole.simulate(better.chain.stages))
        found.append(
            Traces(
                np.arange(len(piece.command), dtype=np.float64) * problem.sample_time,
                piece.command,
                piece.measurement,
                whole.rows(whole.simulate(diagnosis.model.chain.stages)),
                augmented,
            )
        )
    return found


def _title(index: int, axis: str, pieces: int, diagnosis: Diagnosis) -> str:
    parts = ([f"stretch {index + 1}"] if pieces > 1 else []) + ([f"axis {axis}"] if len(diagnosis.model.axes) > 1 else [])
    return ", ".join(parts)


def envelope(time: Array, values: Array, bins: int = BINS) -> tuple[Array, Array]:
    """Thin a signal to the least and greatest sample of every bin, in order; a short signal is kept whole.

    Parameters
    ----------
    time : ndarray, shape (N,)
        Time, s.
    values : ndarray, shape (N,)
        Signal, any unit.
    bins : int
        Number of bins.

    Returns
    -------
    time
        Times (2 bins,) of the kept samples, s, as float32.
    values
        Kept samples (2 bins,), as float32.
    """
    if len(values) <= 2 * bins:
        return time.astype(np.float32), values.astype(np.float32)
    edges = np.linspace(0, len(values), bins + 1).astype(int)
    kept = []
    for begin, end in zip(edges[:-1], edges[1:], strict=True):
        kept += sorted((begin + int(np.argmin(values[begin:end])), begin + int(np.argmax(values[begin:end]))))
    return time[kept].astype(np.float32), values[kept].astype(np.float32)


def _signals(piece: Traces, axis: int, title: str, unit: str) -> go.Figure:
    figure = make_subplots(rows=2, cols=1, shared_xaxes=True, vertical_spacing=0.06, row_heights=[0.58, 0.42])
    lines = [("measured", piece.measured, INK), ("simulated", piece.simulated, ORANGE)]
    if piece.augmented is not None:
        lines.append(("augmented", piece.augmented, BLUE))
    for name, values, colour in lines:
        x, y = envelope(piece.time, values[:, axis])
        figure.add_scatter(x=x, y=y, name=name, legendgroup=name, line={"color": colour, "width": 1.2}, row=1, col=1)
        if name != "measured":
            x, y = envelope(piece.time, piece.measured[:, axis] - values[:, axis])
            figure.add_scatter(
                x=x, y=y, name=name, legendgroup=name, showlegend=False, line={"color": colour, "width": 1.0}, row=2, col=1
            )
    figure.update_yaxes(title_text=f"displacement ({unit})", row=1, col=1)
    figure.update_yaxes(title_text=f"residual ({unit})", row=2, col=1)
    figure.update_xaxes(title_text="time (s)", row=2, col=1)
    figure.update_layout(title=title, hovermode="x unified")
    return figure


def _waterfall(diagnosis: Diagnosis, document: Mapping[str, Any]) -> go.Figure:
    names, energies = steps(diagnosis)
    rms = np.sqrt(energies)
    labels = ["simulator as given", *(f"+ {name.replace('_', ' ')}" for name in names), "+ coefficients", "left"]
    values = [rms[0], *np.diff(rms), rms[-1]]
    figure = go.Figure(
        go.Waterfall(
            x=labels,
            y=values,
            measure=["absolute", *["relative"] * (len(rms) - 1), "total"],
            text=[f"{value:.3g}" for value in (*rms, rms[-1])],
            textposition=["outside", *["auto"] * (len(rms) - 1), "outside"],
            connector={"line": {"color": "#9aa1ab"}},
            totals={"marker": {"color": BLUE}},
            decreasing={"marker": {"color": "#5b8e3e"}},
            increasing={"marker": {"color": ORANGE}},
        )
    )
    floor = document["gap"]["floor_rms"]
    figure.add_hline(y=floor, line={"dash": "dash", "color": INK})
    figure.update_traces(cliponaxis=False)
    figure.update_layout(title={"text": f"dashed: noise floor {floor:.3g} {document['gap']['unit']}", "font": {"size": 13}})
    figure.update_yaxes(title_text=f"rms ({document['gap']['unit']})", range=[0.0, 1.15 * float(rms.max())])
    return figure


def steps(diagnosis: Diagnosis) -> tuple[list[str], Array]:
    """Compute the mean squared residual as the effects of the best explanation are added one by one.

    Parameters
    ----------
    diagnosis : Diagnosis
        Diagnosis of all axes.

    Returns
    -------
    names
        Effects (E,), the largest share first.
    energies
        Mean squares (E + 2,) over all axes: no effect, each more of them, and fitted coefficients as well.
    """
    size: dict[str, float] = {}
    for part in diagnosis.parts:
        chosen = part.chosen
        if chosen.candidate is not None:
            for name, share in zip(chosen.names, shares(part.linearised, chosen), strict=True):
                size[name] = size.get(name, 0.0) + share
    names = sorted(size, key=lambda name: -size[name])
    energies = [_energy(diagnosis, names[:count]) for count in range(len(names) + 1)]
    fitted = [_square(part, part.chosen.solution.residual) for part in diagnosis.parts]
    return names, np.array([*energies, _mean(diagnosis, fitted)])


def _energy(diagnosis: Diagnosis, names: Sequence[str]) -> float:
    found = []
    for part in diagnosis.parts:
        lin, chosen = part.linearised, part.chosen
        unknowns, x = None, None
        if chosen.candidate is not None:
            kept = [i for i, name in enumerate(chosen.names) if name in names]
            if kept:
                unknowns = type(chosen.candidate)(tuple(chosen.candidate.members[i] for i in kept)).unknowns()
                x = np.concatenate([chosen.solution.x[chosen.candidate.slices()[i]] for i in kept])
        found.append(_square(part, lin.measured - lin.simulate(np.zeros(lin.count), unknowns, x)))
    return _mean(diagnosis, found)


def _square(part: AxisDiagnosis, residual: Array) -> float:
    return float(np.mean(part.problem.rows(residual) ** 2))


def _mean(diagnosis: Diagnosis, found: Sequence[float]) -> float:
    return float(np.average(found, weights=[len(part.axes) for part in diagnosis.parts]))


def _spectrum(pieces: Sequence[Traces], diagnosis: Diagnosis, unit: str) -> go.Figure:
    rate, figure = 1.0 / diagnosis.problem.sample_time, go.Figure()
    axes = diagnosis.model.axes
    longest = max(pieces, key=lambda piece: len(piece.time))
    window = min(len(longest.time), max(len(longest.time) // 4, 256))
    for axis, name in enumerate(axes):
        lines = [("before", longest.simulated, ORANGE)]
        if longest.augmented is not None:
            lines.append(("after", longest.augmented, BLUE))
        suffix = f", {name}" if len(axes) > 1 else ""
        dash = ("solid", "dot", "dashdot")[axis % 3]
        for label, values, colour in lines:
            frequency, power = welch(longest.measured[:, axis] - values[:, axis], rate, nperseg=window, detrend=False)
            figure.add_scatter(
                x=frequency[1:], y=np.sqrt(power[1:]), name=label + suffix, line={"color": colour, "width": 1.3, "dash": dash}
            )
        floor = float(diagnosis.parts[_part(diagnosis, axis)].problem.sigma[_within(diagnosis, axis)]) * np.sqrt(2.0 / rate)
        figure.add_scatter(x=frequency[[1, -1]], y=[floor, floor], name="noise floor" + suffix, line={"color": INK, "dash": "dash"})
    figure.update_xaxes(type="log", title_text="frequency (Hz)")
    figure.update_yaxes(type="log", title_text=f"residual ({unit}/√Hz)", exponentformat="power")
    return figure


def _part(diagnosis: Diagnosis, axis: int) -> int:
    return next(i for i, part in enumerate(diagnosis.parts) if axis in part.axes)


def _within(diagnosis: Diagnosis, axis: int) -> int:
    return diagnosis.parts[_part(diagnosis, axis)].axes.index(axis)


def _loops(piece: Traces, diagnosis: Diagnosis, unit: str) -> go.Figure:
    axes = diagnosis.model.axes
    figure = make_subplots(rows=1, cols=len(axes), subplot_titles=[f"axis {name}" for name in axes] if len(axes) > 1 else None)
    every = max(len(piece.time) // LOOP_POINTS, 1)
    for axis in range(len(axes)):
        for name, values, colour in (
            ("measured", piece.measured, INK),
            ("simulated", piece.simulated, ORANGE),
            ("augmented", piece.augmented, BLUE),
        ):
            if values is not None:
                figure.add_scatter(
                    x=piece.command[::every, axis].astype(np.float32),
                    y=values[::every, axis].astype(np.float32),
                    name=name,
                    legendgroup=name,
                    showlegend=axis == 0,
                    line={"color": colour, "width": 1.0},
                    row=1,
                    col=axis + 1,
                )
    figure.update_xaxes(title_text="command (V)")
    figure.update_yaxes(title_text=f"displacement ({unit})", col=1)
    return figure


def _where(document: Mapping[str, Any]) -> go.Figure:
    figure = make_subplots(
        rows=2, cols=3, subplot_titles=[f"<b>{WHERE[name]}</b>" for name in WHERE], horizontal_spacing=0.14, vertical_spacing=0.16
    )
    for index, name in enumerate(WHERE):
        rows = document["where"][name][::-1]
        share = 100.0 * np.array([row["share"] for row in rows])
        low, high = 100.0 * np.array([row["ci90"] for row in rows], dtype=float).reshape(-1, 2).T
        figure.add_bar(
            x=share,
            y=[row["name"] for row in rows],
            orientation="h",
            marker={"color": BLUE},
            showlegend=False,
            error_x={"type": "data", "symmetric": False, "array": high - share, "arrayminus": share - low, "thickness": 1},
            row=index // 3 + 1,
            col=index % 3 + 1,
        )
    figure.update_xaxes(range=[0, 105], ticksuffix=" %", nticks=4)
    figure.update_annotations(font_size=13)
    return figure


def _effect_row(effect: Mapping[str, Any]) -> tuple[str, ...]:
    """Cells of an effect's row."""
    values = "; ".join(
        f"{name} {_number(row['value'])} {row['unit']} [{_number(row['ci90'][0])} … {_number(row['ci90'][1])}]"
        for name, row in effect["parameters"].items()
    )
    spread = effect["shrink_ci90"]
    return (
        effect["name"].replace("_", " "),
        ", ".join(effect["axis"]),
        f"{effect['probability']:.2f}",
        values,
        _share(effect["shrink"]) + (f" [{_share(spread[0])} … {_share(spread[1])}]" if spread else ""),
        _share(effect["shrink_reidentified"]),
        _share(effect["share"]),
        ", ".join(effect["equivalent"]) or "–",
    )


def _candidates(rows: Sequence[Mapping[str, Any]]) -> go.Figure:
    figure = go.Figure(
        go.Bar(
            x=[row["probability"] for row in rows][::-1],
            y=[row["name"].replace("_", " ") for row in rows][::-1],
            orientation="h",
            marker={"color": ORANGE},
            text=[f"{row['probability']:.3f}" for row in rows][::-1],
        )
    )
    figure.update_xaxes(range=[0, 1.05], title_text="probability")
    return figure


def _number(value: float | None) -> str:
    return "?" if value is None else f"{value:.4g}"


def _share(value: float | None) -> str:
    return "–" if value is None else f"{100 * value:.1f} %"
