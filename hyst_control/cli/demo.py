"""Excite, record, identify and track on a truth actuator, through five ROS 2 nodes; then the HAMPI paper's Table 5.

Writes a folder with the bags, the identified models, the figures, summary.json and report.html.
"""

from __future__ import annotations

import argparse

NAME = "demo"
HELP = "the whole workflow on a simulated actuator, with a report"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--output", metavar="FOLDER", default="demo_out", help="folder to write (default demo_out)")


def run(arguments: argparse.Namespace) -> int:
    from tqdm import tqdm

    from hyst_control.experiments import demo

    steps = 1 + 2 + len(demo.CONTROLLERS) + 1
    with tqdm(total=steps, bar_format="{desc:32} |{bar:24}| {n_fmt}/{total_fmt} [{elapsed}]") as bar:
        def progress(step: str) -> None:
            bar.update(1 if bar.desc else 0)
            bar.set_description_str(step)

        table = demo.run(arguments.output, progress)
        bar.update(1)
    print(table.text())
    print(f"\nwritten: {arguments.output}/report.html, summary.json, bags/, models/, figures/")
    return 0
