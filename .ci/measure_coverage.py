# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Run pytest with the given arguments, measure lines and branches in every process, and hold them against `.ci/coverage.yaml`.

`hyst demo` runs as well, which `make check-readme` tests. With the one word `safety` the tests of the safety path alone run, and the limit
of the package does not count.

Functions that numba compiles are left out: they run as machine code, and the tests compare them with exported C.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import yaml

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "build" / "coverage"
SETTINGS = ROOT / ".ci" / "coverage.ini"
TESTS_FAILED = 1  # exit status of pytest where tests ran and some failed


def measured(arguments: list[str], *, demo: bool) -> tuple[int, dict[str, Any]]:
    """Exit status of pytest and of the demo, and the report of all of their processes."""
    shutil.rmtree(FOLDER, ignore_errors=True)
    FOLDER.mkdir(parents=True)
    environment = {**os.environ, "COVERAGE_RCFILE": str(SETTINGS), "COVERAGE_FILE": str(FOLDER / "data")}

    def coverage(*words: str) -> int:
        return subprocess.run([sys.executable, "-m", "coverage", *words], cwd=ROOT, env=environment).returncode

    status = coverage("run", "-m", "pytest", *arguments)
    if status == TESTS_FAILED:  # as in `.ci/run`: once more, alone, as the nodes' tests meet a machine that is busy with others
        status = coverage("run", "-m", "pytest", "--quiet", "--last-failed", "--last-failed-no-failures", "none")
    if demo:
        status |= coverage("run", str(Path(sys.executable).with_name("hyst")), "demo", "--output", str(FOLDER / "demo"))
    report = FOLDER / "coverage.json"
    coverage("combine", "--quiet")
    if coverage("json", "--quiet", "--ignore-errors", "-o", str(report)):
        sys.exit("coverage: no process has written anything")
    return status, json.loads(report.read_text(encoding="utf-8"))


def shortfalls(report: dict[str, Any], limits: dict[str, Any]) -> list[str]:
    """Lines for the package, and for each file of the safety path, whose coverage is below its limit."""
    found = []
    share = report["totals"]["percent_covered"]
    if share < limits["package"]:
        found.append(f"package: {share:.1f} %, at least {limits['package']} %")
    for name in limits["safety_files"]:
        file = report["files"].get(name)
        share = file["summary"]["percent_covered"] if file else 0.0
        if share < limits["safety_path"]:
            missing = [*file["missing_lines"], *(f"{begin}->{end}" for begin, end in file["missing_branches"])] if file else ["all"]
            found.append(f"{name}: {share:.1f} %, at least {limits['safety_path']} %, missing {', '.join(map(str, missing))}")
    return found


def main() -> None:
    limits = yaml.safe_load((ROOT / ".ci" / "coverage.yaml").read_text(encoding="utf-8"))
    if safety := sys.argv[1:] == ["safety"]:
        limits["package"] = 0
    status, report = measured(["--quiet", *limits["safety_tests"]] if safety else sys.argv[1:], demo=not safety)
    totals = report["totals"]
    branches = 100.0 * totals["covered_branches"] / max(totals["num_branches"], 1)
    print(f"coverage: {totals['percent_covered']:.1f} %, of branches alone {branches:.1f} %")
    faults = shortfalls(report, limits)
    print(*faults, sep="\n")
    sys.exit(status or bool(faults))


if __name__ == "__main__":
    main()
