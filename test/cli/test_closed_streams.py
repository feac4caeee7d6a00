"""A command whose standard streams were closed by what started it ends as it does with them."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

from hyst_control.base.config_files import config_path

TUNE = ["tune", str(config_path("models/fsm_mhl.yaml"))]
START = "import sys; from hyst_control.cli import main; sys.exit(main())"


def run(words, closed, folder):
    """Status, and what came out of the streams that are open, of a command started by a shell that closes some."""
    script = 'exec "$@" ' + " ".join({"in": "<&-", "out": ">&-", "err": "2>&-"}[name] for name in closed)
    done = subprocess.run(
        ["sh", "-c", script, "sh", sys.executable, "-c", START, *words], cwd=folder, capture_output=True, timeout=120
    )
    return done.returncode, done.stdout.decode(), done.stderr.decode()


@pytest.mark.parametrize("closed", [("err",), ("in", "out", "err")], ids="-".join)
def test_the_result_is_written_whole(closed, tmp_path):
    status, out, told = run([*TUNE, "--json", "tuning.json"], closed, tmp_path)
    assert status == 0 and not told
    assert ("out" in closed) != ("settling_time" in out)
    assert json.loads((tmp_path / "tuning.json").read_text())["rows"]


def test_a_refusal_has_its_status(tmp_path):
    assert run(["tune", "missing.yaml"], ("err",), tmp_path) == (2, "", "")
    assert run(["tune", "missing.yaml"], ("in", "out"), tmp_path)[2].count("\n") == 1
