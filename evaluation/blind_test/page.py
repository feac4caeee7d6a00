"""Page of a blind test: the published table as measured, the confusion matrix, the worst cases, and what was put in or withheld."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from evaluation.blind_test.case import VERDICTS
from evaluation.blind_test.scores import BY_MACHINE, ERROR, Metric, Result, group_by
from hyst_control.base.files import write_text
from hyst_control.effects import EFFECTS
from hyst_control.reporting.templates import render

WORST = 12
"""Simulated cases that are shown of those that went wrong."""


def write_page(
    path: Path, found: Sequence[Metric], results: Sequence[Result], command: str, asked: int, digests: Mapping[str, str]
) -> None:
    """Write the page, and blind_confusion.svg in `figures` beside it where cases were simulated."""
    simulated = [r for r in results if r.case.source == "simulated" and not r.role]
    done = sum(r.role != "left_out" for r in results)
    if simulated:
        figure = path.parent / "figures" / "blind_confusion.svg"
        figure.parent.mkdir(parents=True, exist_ok=True)
        _draw(figure, simulated)
    wrong = [r for r in results if r.case.source == "simulated" and r.role != "left_out" and not r.right]
    text = render(
        "blind_test/templates/blind_test.md",
        command=command,
        interrupted="" if done == asked else f" and stopped after {done} of the {asked} cases, in their order",
        digests=digests,
        counts=Counter(r.role or r.case.source for r in results),
        kinds=Counter(r.kind for r in simulated),
        hidden=sum(bool(r.hidden) for r in simulated),
        metrics=found,
        simulated=simulated,
        worst=sorted(wrong, key=lambda r: -r.size)[:WORST],
        machines=[
            (*metric.name.split(" | "), round(metric.value * metric.n), metric.n) for metric in group_by(results, BY_MACHINE)
        ],
        measured=[r for r in results if r.case.source != "simulated"],
        effects_of=_effects,
    )
    write_text(path, text)


def _effects(result: Result) -> str:
    """What is in a case, with its sizes."""
    shown = []
    for effect in result.case.effects:
        sizes = {name: f"{value:.3g}" if isinstance(value, float) else value for name, value in effect.items() if value != ""}
        name = sizes.pop("name")
        shown.append(f"{name} ({', '.join(f'{key} {value}' for key, value in sizes.items())})" if sizes else name)
    return "; ".join(shown) or result.case.kind.replace("none", "nothing")


def _draw(path: Path, results: Sequence[Result]) -> None:
    import matplotlib

    matplotlib.use("svg")
    import matplotlib.pyplot as plt

    rows, columns, counts = confusion(results)
    figure, axes = plt.subplots(figsize=(0.32 * len(columns) + 2.5, 0.28 * len(rows) + 2.0))
    shares = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    axes.imshow(shares, cmap="Blues", vmin=0, vmax=1, aspect="auto")
    for i, j in np.argwhere(counts > 0):
        axes.text(j, i, str(counts[i, j]), ha="center", va="center", fontsize=7, color="white" if shares[i, j] > 0.5 else "black")
    axes.set_xticks(range(len(columns)), columns, rotation=90, fontsize=7)
    axes.set_yticks(range(len(rows)), rows, fontsize=7)
    axes.set_xlabel("named"), axes.set_ylabel("true")
    figure.tight_layout()
    figure.savefig(path)
    plt.close(figure)


def confusion(results: Sequence[Result]) -> tuple[list[str], list[str], np.ndarray]:
    """Count the names given by true name, over all cases but pairs."""
    counts: Counter[tuple[str, str]] = Counter()
    for r in results:
        if r.kind != "pair":
            truth = r.case.answer.names[0] if r.kind == "single" else r.kind.replace("none", "no_gap")
            counts[truth, r.named[0] if r.named and r.verdict in VERDICTS["single"] else r.verdict] += 1
    order = [*EFFECTS, "no_gap", "parameters", "open_set", "unknown", ERROR]
    rows, columns = (sorted({pair[i] for pair in counts}, key=order.index) for i in (0, 1))
    return rows, columns, np.array([[counts[row, column] for column in columns] for row in rows])
