# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Models that lose an element: what is gone, and that the rest is as it was."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import block_diag

from evaluation.blind_test.case import Case, Label, as_document
from evaluation.blind_test.mirror_models import oscillating, uncoupled, without_states
from evaluation.blind_test.scores import metrics, score
from evaluation.blind_test.withheld import drawn, made
from hyst_control.base.errors import InputError
from hyst_control.chain.linear.linear_stages import StateSpace
from hyst_control.cli import main
from hyst_control.diagnose.workflow import diagnosed

pytestmark = pytest.mark.long_file

FREQUENCIES = (300.0, 1200.0)
ELEMENTS: dict[str, tuple[str, ...]] = {"nothing": (), "hysteresis": ("backlash",), "all but 3": ("backlash",)}


def modal(random: np.random.Generator) -> StateSpace:
    """Two modes and a real pole of three axes."""
    blocks = [2 * np.pi * f * np.array([[-0.01, -1.0], [1.0, -0.01]]) for f in FREQUENCIES]
    return StateSpace(
        block_diag(*blocks, [[-500.0]]),
        100.0 * random.standard_normal((5, 3)),
        random.standard_normal((3, 5)),
        random.standard_normal((3, 3)),
    )


def response(stage: StateSpace, frequency: float) -> np.ndarray:
    a, b, c, d = (np.array(getattr(stage, part), dtype=float) for part in "ABCD")
    return c @ np.linalg.solve(2j * np.pi * frequency * np.eye(len(a)) - a, b.astype(complex)) + d


@pytest.mark.parametrize("frequency", [0.0, 290.0, 1199.0])
def test_without_coupling_only_the_diagonal_is_left(frequency):
    whole = modal(np.random.default_rng(1))
    np.testing.assert_allclose(
        response(uncoupled(whole), frequency), np.diag(np.diag(response(whole, frequency))), rtol=1e-9, atol=1e-9
    )


def test_a_mode_is_found_and_taken_away_whole():
    whole = modal(np.random.default_rng(2))
    found = list(oscillating(whole))
    np.testing.assert_allclose([frequency for _, frequency in found], np.array(FREQUENCIES) * np.sqrt(1 + 1e-4), rtol=1e-9)
    left = without_states(whole, found[0][0])
    assert len(left.A) == 3
    # What is gone has one residue: its difference is of rank two at most, and largest at the mode.
    gone = response(whole, FREQUENCIES[0]) - response(left, FREQUENCIES[0])
    assert np.linalg.svd(gone, compute_uv=False)[2] < 1e-9 * np.abs(gone).max()
    assert np.abs(gone).max() > 20 * np.abs(response(whole, 3000.0) - response(left, 3000.0)).max()
    other = response(without_states(left, slice(0, 2)), 50.0)
    np.testing.assert_allclose(
        response(whole, 50.0) - response(without_states(whole, found[1][0]), 50.0) + other, response(left, 50.0), atol=1e-9
    )


def test_what_was_not_measured_is_refused(tmp_path, capsys):
    assert main(["blind-test", "--measured", "--plants", "stuck", "--output", str(tmp_path / "out")]) == 2
    assert "--plants stuck" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def withheld(element: str, right: tuple[str, ...] = ("delay",)) -> Case:
    verdicts = ("effect", "parameters") if right else ("no_gap",)
    label = Label("single" if right else "none", (element,) if right else (), 0.2, 0.1, accepted=(right,) if right else ())
    effects = ({"name": element},) if right else ()
    return Case("", "mirror, 100 mV", label.kind, "", 0.0, 0, effects, label=replace(label, verdicts=verdicts), source="withheld")


@pytest.mark.parametrize(
    ("element", "verdict", "names", "solved"),
    [
        ("nothing", "no_gap", (), True),
        ("nothing", "unknown", (), False),
        ("nothing", "parameters", (), False),
        ("input delay", "effect", ("delay", "gain"), True),
        ("input delay", "effect", ("gain", "delay"), False),
        ("input delay", "ambiguous", ("delay", "gain"), False),
        ("input delay", "no_gap", (), False),
    ],
)
def test_a_case_is_solved_by_name_and_verdict(element, verdict, names, solved):
    case = withheld(element, ("delay",) if element != "nothing" else ())
    report = {"verdict": verdict, "effects": [{"name": name, "parameters": {}} for name in names], "unexplained_share": 0.0}
    assert score(case, report).right == solved
    found = {metric.name: (metric.value, metric.n) for metric in metrics([score(case, report)])}
    assert found["withheld: all cases solved"] == (float(solved), 1)
    assert found.get("withheld elements: named first") == (None if element == "nothing" else (float(names[:1] == ("delay",)), 1))


def test_a_page_of_a_part_says_of_how_many_cases_it_is(tmp_path):
    """What has no report yet is neither diagnosed nor shown with `so_far`."""
    folder = tmp_path / "out" / "measured"
    (folder / "reports").mkdir(parents=True)
    cases = [replace(withheld(element, right), name=f"case_{i}") for i, (element, right) in enumerate(ELEMENTS.items())]
    (folder / "labels.json").write_text(json.dumps({"seed": 0, "count": 3, "cases": [as_document(case) for case in cases]}))
    command = ["blind-test", "--measured", "--so-far", "--output", str(tmp_path / "out"), "--page", str(tmp_path / "page.md")]
    assert main(command) == 2
    report = {"verdict": "no_gap", "effects": [], "unexplained_share": None}
    (folder / "reports" / "case_0.json").write_text(json.dumps(report))
    assert main(command) == 0
    part = (tmp_path / "page.md").read_text()
    assert "stopped after 1 of the 3 cases" in part and "| nothing |" in part and "| hysteresis |" not in part
    for name in ("case_1", "case_2"):
        (folder / "reports" / f"{name}.json").write_text(json.dumps(report))
    assert main(command) == 0
    whole = (tmp_path / "page.md").read_text()
    assert "stopped" not in whole and "| hysteresis |" in whole
    assert "| withheld: all cases solved | 0.333 |" in whole and "| withheld elements: named first | 0.000 |" in whole


def test_the_measured_stack_without_its_elements():
    """The whole model has no gap on loops that it was not fitted to; without hysteresis, or with few operators, that is named first."""
    try:
        cases = drawn(plants=["stack"])
    except InputError as error:
        pytest.skip(str(error))
    assert [case.names for case in cases] == [(), ("hysteresis",), ("all but 3 of 12 operators",)]
    for case in cases:
        files = made(case)
        report, *_ = diagnosed([files.record], files.model, warm_up=files.warm_up)
        assert score(files.of(case), report).right, case.names
        assert report["gap"]["rms"] == pytest.approx(files.label.gap_rms, rel=0.02)
