"""Queue of diagnoses on worker processes and on a Dask cluster, run as a script: workers import it by its path."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = """
import sys, time
from pathlib import Path
from evaluation.blind_test import run
from hyst_control.base.parallel import Workers

def diagnose(job):
    place, report, _ = job
    name = Path(place).name
    if name == "case_0002":
        raise ValueError("no such bag")
    Path(report).write_text("{}")
    return name

run._diagnose_one = diagnose  # also in the workers, which import this script

if __name__ == "__main__":
    folder, where, until = Path(sys.argv[1]), sys.argv[2], float(sys.argv[3])
    workers = {"cores": None, "processes": Workers(2), "cluster": Workers(2, "local")}[where]
    run._jobs = lambda batch, absolute: [
        (f"case_{index:04d}", str(folder / f"case_{index:04d}.json"), ()) for index in range(4) if where != "cores" or index != 2
    ]
    run.diagnose_all([None], until or None, print, workers)
"""


def run(folder: Path, where: str, until: float) -> tuple[list[str], str]:
    """Names of the reports, and what was told."""
    script, reports = folder / "queue_of_stand_ins.py", folder / "reports"
    script.write_text(SCRIPT)
    reports.mkdir()
    ended = subprocess.run(
        [sys.executable, str(script), str(reports), where, str(until)], capture_output=True, text=True, timeout=120
    )
    assert ended.returncode == 0, ended.stderr
    return sorted(path.stem for path in reports.iterdir()), ended.stdout


@pytest.mark.parametrize("where", ["cores", "processes", "cluster"])
def test_every_diagnosis_is_done_and_one_that_fails_costs_itself(tmp_path: Path, where: str) -> None:
    if where == "cluster":
        pytest.importorskip("distributed")
    done, told = run(tmp_path, where, 0.0)
    assert done == ["case_0000", "case_0001", "case_0003"]
    assert told.count("no such bag") == (where != "cores")


def test_none_is_begun_after_the_time(tmp_path: Path) -> None:
    assert run(tmp_path, "processes", 1.0)[0] == []
