"""Figure of a model choice: error on held-out rows over the number of parameters, for every family and structure that was tried."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from hyst_control.identify.data.dataset import TriedRow


def write_choice(path: str | Path, rows: Sequence[TriedRow]) -> None:
    """Draw what was tried."""
    # Here, not above: the families are looked for in every module of this folder, and few runs draw.
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.2, 4.5), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    for index, row in enumerate(rows):
        if row["held_out_nrmse"] is None:
            continue
        color = f"C{index % 10}"
        tried = [each for each in row["structures"] if each["held_out_nrmse"] is not None]
        if tried:
            axes.plot(
                [each["parameters"] for each in tried], [each["held_out_nrmse"] for each in tried], ".", color=color, alpha=0.35
            )
        label = f"{row['family']}, {row['seconds']:.1f} s" + (" (chosen)" if row["chosen"] else "")
        marker = "*" if row["chosen"] else "o"
        axes.plot(row["parameters"], row["held_out_nrmse"], marker, color=color, markersize=13 if row["chosen"] else 7, label=label)
    axes.set_yscale("log")
    axes.set_xlabel("number of parameters")
    axes.set_ylabel("NRMSE on held-out rows (% of range)")
    axes.grid(True, which="both", alpha=0.3)
    axes.legend(title="large: each family's choice\nsmall: structures of G(s) tried", fontsize=8, title_fontsize=8)
    figure.savefig(path)
