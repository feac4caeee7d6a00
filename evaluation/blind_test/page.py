"""Page of a blind test: the targets' table as measured, the confusion matrix, and the worst cases."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from evaluation.blind_test.error_report import VERDICT
from evaluation.blind_test.injected_scores import Row, named_exactly, named_right, quiet
from evaluation.blind_test.metric import Metric
from evaluation.blind_test.scores import Pair, confusion, worst
from hyst_control.diagnose.report.document import sentence
from hyst_control.files import write_text
from hyst_control.reporting.templates import render

KINDS = ("single", "pair", "none", "parameters", "open_set")


def write_page(
    path: Path,
    found: Sequence[Metric],
    pairs: Sequence[Pair],
    rows: Sequence[Row],
    without_gap: Sequence[Pair],
    command: str,
    counts: tuple[int, int, int],
    digests: Mapping[str, str],
    left_out: int,
) -> None:
    """Write the page, and blind_confusion.svg in `figures` beside it."""
    figure = path.parent / "figures" / "blind_confusion.svg"
    figure.parent.mkdir(parents=True, exist_ok=True)
    _draw(figure, pairs)
    done = (len(pairs), len(rows), len(without_gap))
    what = ("simulated cases", "injected ones", "further ones without a gap")
    parts = [f"{n} of the {asked} {name}" for n, asked, name in zip(done, counts, what, strict=True) if asked]
    text = render(
        "blind_test/templates/blind_test.md",
        command=command,
        interrupted="" if done == counts else f" and stopped: {', '.join(parts)}, in their order",
        digests=digests,
        diagnosed=len(pairs),
        kinds={kind: sum(pair[0]["label"]["kind"] == kind for pair in pairs) for kind in KINDS},
        hidden=sum(bool(pair[0]["label"].get("hidden")) for pair in pairs),
        left_out=left_out,
        metrics=found,
        without_gap=len(without_gap),
        worst=[_row(*pair) for pair in worst([*pairs, *without_gap])],
        injected=len(rows),
        machines=by_machine(rows),
        cases=[_injected_row(*row) for row in rows],
    )
    write_text(path, text)


def write_injected_page(path: Path, found: Sequence[Metric], rows: Sequence[Row], command: str, digest: str) -> None:
    """Write the page of injected cases alone."""
    text = render(
        "blind_test/templates/injected.md",
        command=command,
        digest=digest,
        metrics=found,
        machines=by_machine(rows),
        cases=[_injected_row(*row) for row in rows],
    )
    write_text(path, text)


def by_machine(rows: Sequence[Row]) -> list[dict[str, object]]:
    """Count the right first names by machine, baseline records and size."""
    groups: dict[tuple[str, str, float], list[bool]] = {}
    for label, report in rows:
        if label["kind"] == "single":
            key = (label["plant"].split(",")[0], label["mode"].replace("_", " "), label["multiple"])
            groups.setdefault(key, []).append(named_right(label, report))
    return [
        {"machine": machine, "mode": mode, "size": size, "right": sum(hits), "n": len(hits)}
        for (machine, mode, size), hits in sorted(groups.items())
    ]


def _injected_row(label: Mapping[str, Any], report: Mapping[str, Any]) -> dict[str, object]:
    """Values of a row of the injected cases."""
    put_in = [f"{name} ({how})" if how else name for name, how in zip(label["names"], label["realizations"], strict=True)]
    judge = {"single": named_right, "pair": named_exactly}.get(label["kind"])
    if judge is not None:
        right = judge(label, report)
    else:
        right = quiet(report) if label["kind"] == "none" else report["verdict"] == "unknown"
    return {
        "name": label["name"],
        "record": label["record"] if label["plant"] in label["record"] else f"{label['plant']}: {label['record']}",
        "mode": label["mode"].replace("_", " "),
        "injected": ", ".join(put_in) or "nothing",
        "size": label["multiple"],
        "verdict": report["verdict"],
        "named": ", ".join(effect["name"] for effect in report["effects"]),
        "right": "yes" if right else "no",
    }


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
        "sentence": report["error"] if report["verdict"] == VERDICT else sentence(report),
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
