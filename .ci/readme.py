# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Run what the README shows, in order, in one empty folder, and compare what it prints with what the README says.

Of `console` blocks the lines `$ hyst …`, `$ pipeline …` and `$ python …` run; the lines behind each are its output. A `python` block
runs as a program, and the `text` block behind it is its output. `…` stands for anything. Numbers may differ by `TOLERANCE`. Behind
`hyst demo` the README's table of errors is compared too. `../config` and `../docs` lead from the folder to the tree's.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from sources import ROOT

TOLERANCE = 0.02
"""Relative; besides, one unit of the last digit that is shown."""
RUN = ("hyst ", "pipeline ", "python ")
BLOCK = re.compile(r"^```(console|python|text)\n(.*?)^```", re.DOTALL | re.MULTILINE)
NUMBER = re.compile(r"(?<![\w.])[+-]?\d+(?:\.\d+)?(?:e[+-]?\d+)?")


@dataclass
class Shown:
    """A command line, or a program of Python, and the lines that it prints."""

    words: list[str]
    title: str
    lines: list[str]


def shown(text: str) -> list[Shown]:
    """Commands and code of a document, in its order."""
    found: list[Shown] = []
    for kind, block in BLOCK.findall(text):
        if kind == "python":
            found.append(Shown([sys.executable, "-c", block], "the lines of Python", []))
        elif kind == "text":
            found[-1].lines += block.splitlines()
        else:
            for line in block.splitlines():
                if line.startswith("$ "):
                    command = line[2:].partition(" #")[0].strip()
                    found.append(Shown(["bash", "-c", command], command, []))
                else:
                    found[-1].lines.append(line)
    return [each for each in found if each.words[0] == sys.executable or each.title.startswith(RUN)]


def same(expected: str, found: str) -> bool:
    """Whether a printed line is what the document says, its numbers within the tolerance; `…` ends what is compared."""
    said, cut, _ = expected.partition("…") if expected.rstrip().endswith("…") else (expected, "", "")
    numbers, theirs = NUMBER.findall(said), NUMBER.findall(found)
    words, printed = ["".join(NUMBER.sub("#", line).split()) for line in (said, found)]
    if not (printed.startswith(words) if cut else printed == words) or len(theirs) < len(numbers):
        return False
    return all(abs(float(a) - float(b)) <= _allowed(a) for a, b in zip(numbers, theirs))


def _allowed(number: str) -> float:
    mantissa, _, power = number.partition("e")
    digit = 10.0 ** (int(power or 0) - len(mantissa.partition(".")[2]))
    return TOLERANCE * abs(float(number)) + 1.001 * digit if "." in mantissa or power else TOLERANCE * abs(float(number))


def missing(expected: list[str], printed: str) -> list[str]:
    """Lines of the document that are not printed, in their order."""
    rest, absent = iter(printed.splitlines()), []
    for line in expected:
        if line.strip() in ("", "…"):
            continue
        if not any(same(line, each) for each in rest):
            absent.append(line)
            rest = iter(printed.splitlines())
    return absent


def table_of(text: str) -> set[tuple[str, str, float]]:
    """The README's table of the demo: frequency, controller, error in % of the range."""
    lines = text.splitlines()
    begin = next(number for number, line in enumerate(lines) if line.startswith("| | 10 Hz"))
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[begin : begin + 6]]
    return {
        (frequency, row[0].removesuffix(" (published)"), float(cell.partition(" ")[0]))
        for row in rows[2:]
        for frequency, cell in zip(rows[0][1:], row[1:], strict=True)
    }


def untrue_errors(readme: str, printed: str) -> list[str]:
    """Errors of the README's table that the demo did not print."""
    found = re.findall(r"^ +(\d+ Hz) +(\S.*?) +nrmse +([\d.]+)", printed, re.MULTILINE)
    errors = {(frequency, subject): value for frequency, subject, value in found}
    return [
        f"{subject} at {frequency}: {value} %, printed {errors.get((frequency, subject))}"
        for frequency, subject, value in sorted(table_of(readme))
        if abs(float(errors.get((frequency, subject), "nan")) - value) > _allowed(f"{value:.2f}")
        or (frequency, subject) not in errors
    ]


def main() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    environment = {**os.environ, "PATH": f"{ROOT / '.venv/bin'}:{os.environ['PATH']}", "MPLBACKEND": "agg"}
    with tempfile.TemporaryDirectory() as name:
        for linked in ("config", "docs"):
            (Path(name) / linked).symlink_to(ROOT / linked)
        folder = Path(name) / "tour"
        folder.mkdir()
        for each in shown(text):
            begin = time.monotonic()
            ended = subprocess.run(
                each.words, cwd=folder, env=environment, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False
            )
            if ended.returncode:
                sys.exit(f"README.md: {each.title}: exit status {ended.returncode}\n{ended.stdout}{ended.stderr}")
            faults = missing(each.lines, ended.stdout) + (untrue_errors(text, ended.stdout) if each.title == "hyst demo" else [])
            if faults:
                sys.exit("\n".join([f"README.md: {each.title} does not print:", *faults, "but:", ended.stdout]))
            print(f"{time.monotonic() - begin:6.1f} s  {each.title}", flush=True)


if __name__ == "__main__":
    main()
