# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""`import hyst_control as hc`: which names there are, and that the example of each runs, as do the lines on the page of the API."""

from __future__ import annotations

import doctest
import inspect
import os
import re
import resource
import subprocess
import sys
import webbrowser
from pathlib import Path

import numpy as np
import pytest
from matplotlib import pyplot

import hyst_control as hc

NAMES = (
    "Gap InputError Inverse Model Record Score Tuning diagnose excitation "
    "from_arrays from_pandas from_xarray identify load_model read_bag read_csv read_mat tune"
).split()
"""The public names. Adding one is a promise: it needs an example and a place in docs/api.md."""
NEEDS = {"from_pandas": ["pandas"], "from_xarray": ["xarray", "pandas"]}
PAGE = Path(__file__).resolve().parents[2] / "docs" / "api.md"


def blocks(text: str) -> list[str]:
    """Code of the page, in its order."""
    return re.findall(r"```python\n(.*?)```", text, re.S)


def run(source: str, names: dict[str, object], name: str) -> None:
    test = doctest.DocTestParser().get_doctest(inspect.cleandoc(source), names, name, None, 0)
    said: list[str] = []
    found = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS).run(test, out=said.append, clear_globs=False)
    names.update(test.globs)
    assert found.attempted and not found.failed, "".join(said)


@pytest.fixture(scope="module")
def stage(tmp_path_factory):
    """The folder with the two tables, and the names that the page's examples begin with."""
    folder, here = tmp_path_factory.mktemp("api"), Path.cwd()
    names: dict[str, object] = {}
    _, tables, begun = blocks(PAGE.read_text(encoding="utf-8"))
    os.chdir(folder)
    try:
        run(tables + begun, names, "tables")
    finally:
        os.chdir(here)
    return folder, names


@pytest.fixture
def within(stage, monkeypatch):
    folder, names = stage
    monkeypatch.chdir(folder)
    monkeypatch.setattr(webbrowser, "open", lambda *_: True)
    pyplot.switch_backend("Agg")
    yield dict(names)
    pyplot.close("all")


def test_the_names_are_those_that_were_promised():
    assert sorted(dir(hc)) == NAMES == sorted(hc.__all__) and len(NAMES) <= 25
    assert not [name for name in NAMES if not callable(getattr(hc, name))]


def test_every_name_is_on_the_page():
    members = re.findall(r"members: \[(.*)\]", PAGE.read_text(encoding="utf-8"))
    assert sorted(", ".join(members).split(", ")) == NAMES


def documentation(name: str) -> str:
    home = hc._HOME[name]
    return inspect.getdoc(getattr(__import__(f"hyst_control.{home}", fromlist=[name]), name)) or ""


@pytest.mark.parametrize("name", [name for name in NAMES if name != "InputError"])
def test_the_example_of_a_name_runs(name, within):
    for package in NEEDS.get(name, ()):
        pytest.importorskip(package)
    run(documentation(name).partition("Examples\n--------\n")[2], within, name)


def test_the_ten_lines_run(within):
    run(blocks(PAGE.read_text(encoding="utf-8"))[0], {"hc": hc, "np": np}, "ten lines")


def test_a_package_of_a_functions_name_is_that_function():
    import hyst_control.diagnose.workflow
    import hyst_control.identify.workflow

    assert hyst_control.identify.workflow.identify_records
    with pytest.raises(hc.InputError, match="no record"):
        hc.identify([])


def test_nothing_is_loaded_before_it_is_used():
    code = "import sys, hyst_control as hc; dir(hc); print([n for n in ('numpy', 'scipy', 'numba', 'yaml', 'rclpy') if n in sys.modules])"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"


def test_a_name_that_is_none_is_refused():
    with pytest.raises(AttributeError, match="no attribute 'identfy'"):
        _ = hc.identfy  # type: ignore[attr-defined]


def test_a_table_is_read_without_what_only_models_need():
    modules = ("scipy.signal", "numba", "matplotlib", "rclpy")
    code = f"import sys, hyst_control as hc; hc.read_csv; print([n for n in {modules} if n in sys.modules])"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"


HYST = "import sys; sys.argv = ['hyst', '--help']\nfrom hyst_control.processes.executables import hyst\n"


def processor_time(code: str) -> float:
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, "-c", code], capture_output=True, check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


@pytest.mark.parametrize(
    ("code", "limit"),
    [("import hyst_control as hc; hc.Record", 1.8), (f"{HYST}hyst()", 0.7)],
    ids=["hc", "hyst --help"],
)
def test_the_door_opens_quickly(code, limit):
    """Processor time, in that of importing numpy and scipy.fft. A slow or busy machine is slow for both, so the least of several counts."""
    spent, plain = [], []
    while len(spent) < 8 and min(spent, default=np.inf) > limit * min(plain, default=0.0):
        spent.append(processor_time(code))
        plain.append(processor_time("import numpy, scipy.fft"))
    assert min(spent) <= limit * min(plain)
