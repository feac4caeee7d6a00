# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Foreign text in exported folders: names of models, axes, units and files, of which nothing may become code of C, make or a shell."""

from __future__ import annotations

import re
import subprocess
import tempfile
from pathlib import Path

import numpy as np
import pytest
import yaml
from exported_folder import compared
from hypothesis import given, settings
from hypothesis import strategies as st

from hyst_control.base.config_files import config_path
from hyst_control.chain.c_code.c_code import each_axis
from hyst_control.cli import main
from hyst_control.export.c_source import Program, Slot, header, source
from hyst_control.export.c_text import c_comment, c_identifier, c_identifiers
from hyst_control.export.compiled import c_compiler

SIGNS = [
    "*",
    "/",
    "\\",
    "\n",
    "\r",
    "?",
    "??/",
    "*/",
    "/*",
    "//",
    '"',
    "'",
    "#",
    "\u2028",
    "\u202e",
    "\udcff",
    "\0",
    "µ",
    " ",
    "x",
    "_Pragma(",
    "1",
]
TEXTS = st.one_of(st.text(), st.lists(st.sampled_from(SIGNS), max_size=12).map("".join))
WARNINGS = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wtrigraphs", "-Wcomment", "-Werror")


def tokens(name: str, axes: list[str], text: str) -> str:
    """What a compiler finds beside the comments of a program that has the texts; it compiles without a warning."""
    slots = tuple(Slot(axis, text) for axis in axes)
    code = each_axis("u * p->gain[i]", "gain", {"gain": (np.ones(len(axes)), text)})
    program = Program(name, code, len(axes), slots, slots, 1e-3, (text, f"{text}: x", f"y{text}"))
    with tempfile.TemporaryDirectory() as folder:
        for kind, content in (("h", header(program)), ("c", source(program))):
            (Path(folder) / f"{program.name}.{kind}").write_text(content, encoding="utf-8")

        def compiler(*flags: str) -> str:
            command = [c_compiler(), *WARNINGS, *flags, f"{program.name}.c"]
            done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
            assert done.returncode == 0 and not done.stderr, done.stderr
            return done.stdout

        compiler("-fsyntax-only")
        return compiler("-E", "-P")


@pytest.fixture(scope="module")
def plain():
    return tokens("plain", ["x", "y"], "plain")


@settings(max_examples=40, deadline=None, derandomize=True)
@given(TEXTS)
def test_no_token_of_a_text_leaves_its_comment(plain, text):
    assert tokens("plain", ["x", "y"], text) == plain


@settings(max_examples=30, deadline=None, derandomize=True)
@given(TEXTS, st.lists(TEXTS, min_size=1, max_size=4))
def test_any_name_becomes_a_name_of_c(name, axes):
    tokens(name, axes, "plain")


@settings(max_examples=500, deadline=None)
@given(TEXTS, st.lists(TEXTS, max_size=5))
def test_names_are_identifiers_and_differ_and_a_comment_is_one_line(text, more):
    assert re.fullmatch("[a-z][a-z0-9_]{0,40}", c_identifier(text))
    names = c_identifiers(more)
    assert len(set(names)) == len(more) and all(re.fullmatch("[a-z][a-z0-9_]*", name) for name in names)
    safe = c_comment(text)
    assert len(f"x{safe}x".splitlines()) == 1 and not re.search(r"[*?]|//|\\$", safe)
    assert safe.encode() or not text
    assert c_comment("Größe in µm/V, 10 % of x") == "Größe in µm/V, 10 % of x"


HOSTILE = '*/ int touched = system("touch pwned"); /* $(touch pwned) `touch pwned`; touch pwned #'


@pytest.mark.parametrize("options", [(), ("--twin",), ("--kind", "hapi", "--causal")])
def test_a_hostile_model_exports_and_runs_nothing_of_it(options, tmp_path):
    document = yaml.safe_load(config_path("models/pea_hapi.yaml").read_text())
    document |= {"name": HOSTILE, "axes": ["x-1 */"]}
    document["units"]["measurement"] = "um"
    model = tmp_path / "$(touch pwned) ??" / "*\\\n.yaml"
    model.parent.mkdir()
    model.write_text(yaml.safe_dump(document))
    assert main(["export", str(model), *options, "--output", str(tmp_path / "out")]) == 0
    compared(tmp_path / "out")
    assert not list(tmp_path.rglob("pwned"))
    assert all(re.fullmatch(r"\w+\.[ch]|Makefile|build", path.name) for path in (tmp_path / "out").iterdir())


def test_hostile_parameters_of_nodes_too(tmp_path):
    given = {"rate_hz": 1000.0, "axes": ["a b", "a-b", "", "int"], "unit": "*/ #error", "kp": 1.0, "ki": 2.0}
    path = tmp_path / "1 $(touch pwned) ??" / "loop; touch pwned.yaml"
    path.parent.mkdir()
    path.write_text(yaml.safe_dump({"pi_feedback": {"ros__parameters": given}}))
    assert main(["export", str(path), "--name", "a; touch pwned\n*/", "--output", str(tmp_path / "out")]) == 0
    compared(tmp_path / "out")
    assert not list(tmp_path.rglob("pwned"))
    assert "A_TOUCH_PWNED_IN_REFERENCE_A_B_0 = 0," in (tmp_path / "out" / "a_touch_pwned.h").read_text()


def changed(tmp_path: Path, change) -> str:
    document = yaml.safe_load(config_path("models/pea_hapi.yaml").read_text())
    change(document)
    (tmp_path / "model.yaml").write_text(yaml.safe_dump(document))
    return str(tmp_path / "model.yaml")


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("weight", "real", "line"),
    [
        (1e308, "double", "cannot hold"),
        (1e39, "float", "is beyond float: export with --real double"),
        (1e-40, "float", "cannot hold"),
    ],
)
def test_numbers_that_no_c_holds_are_refused_in_one_line(weight, real, line, tmp_path, capsys):
    def weights(document):
        stage = next(row for row in document["chain"] if row["stage"] == "prandtl_ishlinskii")
        stage["weights"] = (np.ones_like(np.array(stage["weights"], dtype=float)) * weight).tolist()

    model = changed(tmp_path, weights)
    assert main(["export", model, "--real", real, "--output", str(tmp_path / "out")]) == 2
    told = capsys.readouterr().err
    assert line in told and told.count("\n") == 1
    assert not (tmp_path / "out").exists()
    if real == "float" and weight > 1:  # in double it is right
        assert main(["export", model, "--output", str(tmp_path / "out")]) == 0
        compared(tmp_path / "out")
