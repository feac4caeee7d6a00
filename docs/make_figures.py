# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Draw the figures of README and documents: `make figures`.

Without a folder the chain and, where Chromium is, the live page of a loop that runs meanwhile, into docs/figures. With FOLDER=the tour's
folder the loops and the tracking of its bags, and of any folder pictures of the pages `gap.html` and `report.html` in it, light and dark,
taken by Chromium; `make demo` leaves both in demo_out. They are written into that folder, or with TO=docs/figures to where documents look.
"""

from __future__ import annotations

import io
import shutil
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.collections import LineCollection
from PIL import Image

from hyst_control.records.bags.bag_reader import read_bag
from hyst_control.records.motion_frequency import motion_frequency

FIGURES = Path(__file__).parent / "figures"
NODES = (("reference_generator", 0.0), ("feedforward", 3.1), ("pi_feedback", 6.2), ("plant", 9.3))
WIDTH, HEIGHT = 2.1, 0.9
plt.rcParams |= {"svg.hashsalt": "hyst_control", "svg.fonttype": "path", "font.size": 9}


def save(figure: plt.Figure, path: Path) -> None:
    """Write a figure, the same file every time."""
    stamp = {"Date": None} if path.suffix == ".svg" else {"Software": None}
    figure.savefig(path, metadata=stamp, bbox_inches="tight", facecolor="white", dpi=110)
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
    save(figure, FIGURES / "signal_chain.svg")


def tour(folder: Path, to: Path) -> None:
    """Loops of the excitation, and the last two periods of the tracking before its way out."""
    [excited] = read_bag(folder / "excitation").aligned()
    figure, (loops, tracking) = plt.subplots(1, 2, figsize=(9.5, 3.4), layout="constrained")
    command, position = (excited.signal(topic).values[:, 0] for topic in ("command", "measurement"))
    points = np.column_stack([command, position])[:, None]
    frequency = motion_frequency(command, excited.sample_time)
    curve = LineCollection(np.concatenate([points[:-1], points[1:]], axis=1), array=frequency, norm="log", cmap="viridis", lw=0.5)
    loops.add_collection(curve)
    loops.autoscale_view()
    figure.colorbar(curve, ax=loops, label="frequency [Hz]")
    loops.set(xlabel="voltage [V]", ylabel="position [um]", title="excitation")
    [tracked] = read_bag(folder / "tracking").aligned(["reference", "measurement"])
    reference, measurement = (tracked.signal(topic).values[7200:8000, 0] for topic in ("reference", "measurement"))
    time = np.arange(800) * tracked.sample_time * 1e3
    print(f"tracking: NRMSE {100 * np.sqrt(np.mean((measurement - reference) ** 2)) / np.ptp(reference):.2f} % over two periods")
    tracking.plot(time, reference, lw=2, label="reference")
    tracking.plot(time, measurement, "--", lw=1, label="measurement")
    tracking.plot(time, 10 * (reference - measurement), lw=0.8, label="10 × error")
    tracking.set(xlabel="time [ms]", ylabel="position [um]", title="tracking, 50 Hz")
    tracking.legend(loc="center right", fontsize=7)
    save(figure, to / "tour.png")


PICTURES = {
    "gap_verdict.png": ("gap.html", "h1", "ul"),
    "gap_signals.png": ("gap.html", "h2:has-text('Measured, simulated')", "figure.chart >> nth=0"),
    "gap_loops.png": ("gap.html", "h2:has-text('Slow hysteresis')", "details:has-text('Slow hysteresis loops') figure.chart"),
    "gap_rivals.png": ("gap.html", "h2:has-text('Rejected candidates')", "details:has-text('Rejected candidates') .wide"),
    "report_tracking.png": ("report.html", "h1", "figure.chart >> nth=1"),
    "report_loops.png": ("report.html", "h2:has-text('Hysteresis at each')", "figure.chart >> nth=2"),
}
"""By file: the page, and the first and last element in the picture. A file X_dark.png beside each is of the page in dark colors."""
DRAWN = "[...document.querySelectorAll('figure.chart')].every(chart => chart.querySelector('.main-svg'))"
SCHEMES = {"light": "", "dark": "_dark"}
LIVE = {
    "reference_generator": {"signal": "sine", "frequency": 2.0, "amplitude": 2.0, "offset": 3.0, "duration": 1.0, "repeat": True},
    "hampi_feedforward": {"kind": "proportional", "gain": [8.0]},
    "pi_feedback": {"kp": 0.2, "ki": 20.0, "upper": 150.0, "slew_limit": 2e4, "safe_rate": 500.0, "recovery": "manual"},
    "plant": {"plant": "pea_published", "safe_rate": 500.0},
    "diagnosis": {"model": "pea_hampi", "window": 0.1, "calibrate": 0.5},
    "live_view": {"turn": 0.5},
}
"""Nodes of the loop that the picture of the live page shows, with their parameters."""
LIVE_RATE = 200.0  # Hz


def screenshots(folder: Path, to: Path) -> None:
    """Pictures of the pages in a folder, as a reader sees them."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox", "--disable-gpu"])
        for name, (page, first, last) in PICTURES.items():
            if (folder / page).is_file():
                for scheme, ending in SCHEMES.items():
                    view = browser.new_page(viewport={"width": 1000, "height": 800}, color_scheme=scheme)
                    view.goto((folder / page).resolve().as_uri())
                    view.wait_for_selector("body[data-drawn]", timeout=240_000)
                    view.evaluate("document.querySelectorAll('details').forEach(each => { each.open = true; })")
                    view.wait_for_function(DRAWN, timeout=240_000)
                    boxes = [view.locator(selector).first.bounding_box() for selector in (first, last)]
                    top, bottom = boxes[0]["y"] - 8, boxes[1]["y"] + boxes[1]["height"] + 8
                    clip = {"x": 0, "y": top, "width": 1000, "height": bottom - top}
                    _shoot(view, to / name.replace(".png", f"{ending}.png"), clip=clip)
                    view.close()
        browser.close()


def dashboard() -> None:
    """Pictures of the live page beside a loop that runs for that."""
    from playwright.sync_api import sync_playwright

    from hyst_control.base.config_files import config_path
    from hyst_control.processes.node_processes import Processes
    from hyst_control.processes.ros_domain import own_domain

    common = {"schedule": "timer", "rate_hz": LIVE_RATE, "timeout": 5.0, "axes": ["x"], "unit": "um"}
    models = {name: str(config_path(f"models/{own['model']}.yaml")) for name, own in LIVE.items() if "model" in own}
    each = {name: {**common, **own, **({"model": models[name]} if name in models else {})} for name, own in LIVE.items()}
    with tempfile.TemporaryDirectory() as folder, own_domain() as domain, Processes(Path(folder), domain) as processes:
        each["diagnosis"]["output"] = f"{folder}/diagnosis"
        processes.compose(each)
        program = "import sys; from hyst_control.cli import main; sys.exit(main())"
        processes.execute("dashboard", [sys.executable, "-c", program, "dashboard", "--rate", str(LIVE_RATE), "--folder", folder])
        said = processes.log("dashboard")
        while "http://" not in said.read_text(encoding="utf-8"):
            processes.check()
            time.sleep(0.2)
        url = next(word for word in said.read_text(encoding="utf-8").split() if word.startswith("http://"))
        with sync_playwright() as play:
            browser = play.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox", "--disable-gpu"])
            for scheme, ending in SCHEMES.items():
                view = browser.new_page(viewport={"width": 1000, "height": 900}, color_scheme=scheme)
                view.goto(url)
                view.wait_for_function(SHOWS_ALL, timeout=240_000)
                _shoot(view, FIGURES / f"dashboard{ending}.png")
                view.close()
            browser.close()


SHOWS_ALL = """() => {
  const page = window.Bokeh && Bokeh.documents[0], named = name => page && page.get_model_by_name(name);
  const gap = named("gap"), error = named("error");
  if (!gap || !error) return false;
  const time = error.renderers[0].data_source.data.t;
  return gap.renderers[0].data_source.data.t.length > 50 && time[time.length - 1] - time[0] > 9;
}"""
"""Condition under which the live page shows curves over its whole window, and a gap."""


def _shoot(view: Any, path: Path, **how: Any) -> None:
    """Write a picture of a page with 256 colors, a third of the size."""
    with Image.open(io.BytesIO(view.screenshot(full_page=True, **how))) as picture:
        picture.convert("RGB").quantize(256, dither=Image.Dither.NONE).save(path, optimize=True)
    print(f"written: {path}")


if __name__ == "__main__":
    if len(sys.argv) > 1:
        given = Path(sys.argv[1])
        target = Path(sys.argv[2]) if len(sys.argv) > 2 else given
        if (given / "tracking").exists():
            tour(given, target)
        if shutil.which("chromium") and any((given / page).is_file() for page in ("gap.html", "report.html")):
            screenshots(given, target)
    else:
        signal_chain()
        if shutil.which("chromium"):
            dashboard()
