"""Draw the figures of README and documents: `make figures`.

Without a folder the chain; with FOLDER=the tour's folder the loops and the tracking of its bags, and pictures of the page `gap.html` and
`report.html` in it (the tutorial leaves a `gap.html` in build/tutorial, `make demo` a `report.html` in demo_out), taken by Chromium.
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import matplotlib

matplotlib.use("agg")
import matplotlib.pyplot as plt
import numpy as np

from hyst_control.records.bag_reader import read_bag

FIGURES = Path(__file__).parent / "figures"
NODES = (("reference_generator", 0.0), ("feedforward", 3.1), ("pi_feedback", 6.2), ("plant", 9.3))
WIDTH, HEIGHT = 2.1, 0.9
plt.rcParams |= {"svg.hashsalt": "hyst_control", "svg.fonttype": "path", "font.size": 9}


def save(figure: plt.Figure, name: str) -> None:
    """Write a figure, the same file every time."""
    stamp = {"Date": None} if name.endswith(".svg") else {"Software": None}
    figure.savefig(FIGURES / name, metadata=stamp, bbox_inches="tight", facecolor="white", dpi=110)
    plt.close(figure)


def signal_chain() -> None:
    """The nodes, the topics between them, and what a plant is made of."""
    figure, axes = plt.subplots(figsize=(9.5, 3.6))
    for name, x in NODES:
        axes.add_patch(plt.Rectangle((x, 0), WIDTH, HEIGHT, facecolor="#e8eef7", edgecolor="#1f4e8c"))
        axes.text(x + WIDTH / 2, HEIGHT / 2, name, ha="center", va="center")
    arrow = {"arrowstyle": "-|>", "color": "#333333"}
    for (_, left), (_, right), topic in zip(NODES, NODES[1:], ("reference", "feedforward", "command")):
        axes.annotate("", (right, HEIGHT / 2), (left + WIDTH, HEIGHT / 2), arrowprops=arrow)
        axes.text((left + WIDTH + right) / 2, HEIGHT / 2 + 0.08, topic, ha="center", va="bottom", style="italic", fontsize=7.5)
    for topic, start, end, edge, turn in (("reference", 1.0, 7.0, HEIGHT, 1.5), ("measurement", 10.3, 7.3, 0.0, -0.6)):
        axes.plot([start, start, end], [edge, turn, turn], color="#333333", lw=1)
        axes.annotate("", (end, edge), (end, turn), arrowprops={**arrow, "shrinkA": 0})
        axes.text((start + end) / 2, turn + 0.08, topic, ha="center", va="bottom", style="italic", fontsize=7.5)
    stages = ("DAC", "drive", "hysteresis", "piezo", "mechanics", "motion", "sensor", "ADC", "transport")
    axes.text(5.7, -1.35, "inside the plant, and inside a model:   " + "  →  ".join(stages), ha="center", fontsize=8.5)
    axes.text(
        5.7,
        -1.95,
        "recorder: every topic → bag → identification → model file → feedforward, simulator, diagnosis",
        ha="center",
        fontsize=8.5,
    )
    axes.set(xlim=(-0.2, 11.6), ylim=(-2.2, 2.0))
    axes.axis("off")
    save(figure, "signal_chain.svg")


def tour(folder: Path) -> None:
    """Loops of the excitation, and the last two periods of the tracking."""
    [excited] = read_bag(folder / "excitation").aligned(["command", "measurement"])
    figure, (loops, tracking) = plt.subplots(1, 2, figsize=(9.5, 3.4), layout="constrained")
    loops.plot(excited.values["command"][::3], excited.values["measurement"][::3], lw=0.4)
    loops.set(xlabel="command (V)", ylabel="measurement (um)", title="excitation")
    [tracked] = read_bag(folder / "tracking").aligned(["reference", "measurement"])
    reference, measurement = (tracked.values[topic][-800:, 0] for topic in ("reference", "measurement"))
    time = np.arange(800) * tracked.sample_time * 1e3
    print(
        f"tracking: NRMSE {100 * np.sqrt(np.mean((measurement - reference) ** 2)) / np.ptp(reference):.2f} % over the last two periods"
    )
    tracking.plot(time, reference, lw=2, label="reference")
    tracking.plot(time, measurement, "--", lw=1, label="measurement")
    tracking.plot(time, 10 * (reference - measurement), lw=0.8, label="10 × error")
    tracking.set(xlabel="time (ms)", ylabel="um", title="tracking, 50 Hz")
    tracking.legend(loc="center right", fontsize=7)
    save(figure, "tour.png")


PICTURES = {
    "gap_verdict.png": ("gap.html", "h1", ".wide table >> nth=0"),
    "gap_signals.png": ("gap.html", "h2:has-text('Measured, simulated')", "figure.chart >> nth=0"),
    "gap_loops.png": ("gap.html", "h2:has-text('Slow hysteresis')", "figure.chart >> nth=1"),
    "gap_rivals.png": ("gap.html", "h2:has-text('Rejected rivals')", "h2:has-text('Rejected rivals') ~ .wide"),
    "report_tracking.png": ("report.html", "h1", "figure.chart >> nth=0"),
    "report_loops.png": ("report.html", "h2:has-text('Hysteresis at each')", "figure.chart >> nth=1"),
}
"""By file: the page, and the first and last element in the picture."""


def screenshots(folder: Path) -> None:
    """Pictures of the pages in a folder, as a reader sees them."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox", "--disable-gpu"])
        for name, (page, first, last) in PICTURES.items():
            if (folder / page).is_file():
                view = browser.new_page(viewport={"width": 1000, "height": 800}, color_scheme="light")
                view.goto((folder / page).resolve().as_uri())
                view.wait_for_selector("body[data-drawn]", timeout=240_000)
                boxes = [view.locator(selector).first.bounding_box() for selector in (first, last)]
                top, bottom = boxes[0]["y"] - 8, boxes[1]["y"] + boxes[1]["height"] + 8
                clip = {"x": 0, "y": top, "width": 1000, "height": bottom - top}
                view.screenshot(path=str(FIGURES / name), full_page=True, clip=clip)
                view.close()
                print(f"written: {FIGURES / name}")
        browser.close()


if __name__ == "__main__":
    signal_chain()
    if len(sys.argv) > 1:
        given = Path(sys.argv[1])
        if (given / "tracking").exists():
            tour(given)
        if any((given / page).is_file() for page in ("gap.html", "report.html")):
            screenshots(given)
