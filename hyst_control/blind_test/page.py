"""Page of a blind test, docs/blind-test.md: the targets' table as measured, the confusion matrix, and the worst cases."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hyst_control.blind_test.scores import Metric, Pair, confusion, worst
from hyst_control.diagnose.gap_report import sentence
from hyst_control.files import write_text
from hyst_control.reporting.templates import render

KINDS = ("single", "pair", "none", "parameters", "open_set")


def write_page(
    path: Path, found: Sequence[Metric], pairs: Sequence[Pair], seed: int, count: int, digest: str, left_out: int
) -> None:
    """Write the page, and blind_confusion.svg in `figures` beside it.

    Parameters
    ----------
    path
        Markdown file to write.
    found
        Metrics of the test.
    pairs
        Every case that was diagnosed, with its report.
    seed, count
        Of the test, as they were asked for.
    digest
        SHA-256 of the labels.
    left_out
        Number of cases that were diagnosed once more with their effect out of the catalogue.
    """
    figure = path.parent / "figures" / "blind_confusion.svg"
    figure.parent.mkdir(parents=True, exist_ok=True)
    _draw(figure, pairs)
    interrupted = f" and interrupted: {len(pairs)} of the {count} cases, in the order in which they were drawn"
    text = render(
        "blind_test/templates/blind_test.md",
        seed=seed,
        count=count,
        interrupted="" if len(pairs) == count else interrupted,
        digest=digest,
        diagnosed=len(pairs),
        kinds={kind: sum(pair[0]["label"]["kind"] == kind for pair in pairs) for kind in KINDS},
        hidden=sum(bool(pair[0]["label"].get("hidden")) for pair in pairs),
        left_out=left_out,
        metrics=found,
        worst=[_row(*pair) for pair in worst(pairs)],
    )
    write_text(path, text)


def _row(case: Mapping[str, Any], report: dict[str, Any]) -> dict[str, object]:
    """Values of a row of the worst cases."""
    label = case["label"]
    return {
        "name": case["name"],
        "plant": label["plant"],
        "excitation": label["excitation"].replace("_", " "),
        "noise_percent": 100 * label["noise"],
        "effects": "; ".join(map(_effect, label["effects"])) or label["kind"],
        "gap_over_noise": label["gap_rms"] / label["noise_rms"],
        "sentence": sentence(report),
    }


def _effect(effect: Mapping[str, object]) -> str:
    values = ", ".join(
        f"{name} {value:.3g}" if isinstance(value, float) else f"{name} {value}" for name, value in effect.items() if name != "name"
    )
    return f"{effect['name']} ({values})"


def _draw(path: Path, pairs: Sequence[Pair]) -> None:
    import matplotlib

    matplotlib.use("svg")
    import matplotlib.pyplot as plt

    rows, columns, counts = confusion(pairs)
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
