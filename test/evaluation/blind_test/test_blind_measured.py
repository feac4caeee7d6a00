"""Models that lose an element: what is gone, and that the rest is as it was."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import block_diag

from evaluation.blind_test import measured
from evaluation.blind_test.measured import report_on
from evaluation.blind_test.mirror_models import oscillating, uncoupled, without_states
from evaluation.blind_test.withheld_cases import Withheld, stack_cases
from evaluation.blind_test.withheld_scores import is_solved, named_right
from hyst_control.chain import Chain
from hyst_control.chain.linear.linear_stages import StateSpace
from hyst_control.errors import InputError
from hyst_control.model_file import Model
from hyst_control.records.record import Record, Signal

pytestmark = pytest.mark.long_file

FREQUENCIES = (300.0, 1200.0)


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


def test_a_case_that_has_its_report_is_not_diagnosed_again(tmp_path, monkeypatch):
    calls = []
    monkeypatch.setattr(measured, "diagnosed", lambda records, model, warm_up: calls.append(warm_up) or ({"verdict": "no_gap"},))
    time = 1e-3 * np.arange(4)
    signal = Signal(time, np.ones((4, 3)), ("x", "y", "z"), "V")
    model = Model("whole", ("x", "y", "z"), {"command": "V", "measurement": "um"}, 1e-3, Chain((modal(np.random.default_rng(3)),)))
    case = Withheld(
        "mirror, 100 mV", "mode at 30 Hz", (), model, Record({"command": signal, "measurement": signal}, "here"), 0.5, 0.1
    )
    first = report_on(case, tmp_path)
    assert report_on(case, tmp_path) == first | {"seconds": pytest.approx(0.0, abs=60.0)} and calls == [0.5]
    other = replace(signal, values=2.0 * signal.values)
    for changed in (
        replace(case, warm_up=0.4),
        replace(case, model=replace(model, sample_time=2e-3)),
        replace(case, record=replace(case.record, signals={"command": signal, "measurement": other})),
    ):
        report_on(changed, tmp_path)
    assert len(calls) == 4 and [path.name for path in tmp_path.iterdir()] == ["mirror_100_mv_mode_at_30_hz.json"]


@pytest.mark.parametrize(
    ("element", "verdict", "names", "solved"),
    [
        ("nothing", "no_gap", (), True),
        ("nothing", "unknown", (), False),
        ("input delay", "effect", ("delay", "gain"), True),
        ("input delay", "effect", ("gain", "delay"), False),
        ("input delay", "ambiguous", ("delay", "gain"), False),
        ("input delay", "no_gap", (), False),
    ],
)
def test_a_case_is_solved_by_name_and_verdict(element, verdict, names, solved):
    case = Withheld("mirror", element, ("delay",) if element != "nothing" else (), None, None, 0.0, 0.1)  # type: ignore[arg-type]
    assert is_solved(case, {"verdict": verdict, "effects": [{"name": name} for name in names]}) == solved


@pytest.mark.parametrize(("given", "said"), [({"plants": ["stuck"]}, "--plants stuck"), ({"levels": [250]}, "--levels 250")])
def test_what_was_not_measured_is_refused(tmp_path, given, said):
    with pytest.raises(InputError, match=said):
        measured.run(str(tmp_path), **given)
    assert not list(tmp_path.iterdir())


def test_a_page_of_a_part_says_of_how_many_cases_it_is(tmp_path, monkeypatch):
    """What has no report yet is not diagnosed with `so_far`; a report on another record does not count."""
    monkeypatch.setattr(measured, "map_forked", lambda work, count: map(work, range(count)))
    time = 1e-3 * np.arange(4)
    signal = Signal(time, np.ones((4, 3)), ("x", "y", "z"), "V")
    model = Model("whole", ("x", "y", "z"), {"command": "V", "measurement": "um"}, 1e-3, Chain((modal(np.random.default_rng(3)),)))
    record = Record({"command": signal, "measurement": signal}, "here")
    cases = [Withheld("stack", element, (), model, record, 0.5, 0.1) for element in ("nothing", "hysteresis", "all but 3")]
    monkeypatch.setattr(measured, "stack_cases", lambda: cases)
    report = {
        "verdict": "no_gap",
        "effects": [],
        "unexplained_share": None,
        "gap": {"rms": 0.1, "unit": "um", "nrmse": 0.5, "floor_rms": 0.1},
    }
    monkeypatch.setattr(measured, "diagnosed", lambda records, model, warm_up: (report,))
    monkeypatch.setattr(measured, "sentence", lambda report: "No gap.")
    monkeypatch.setattr("evaluation.blind_test.withheld_page.sentence", lambda report: "No gap.")
    out, page = str(tmp_path / "out"), str(tmp_path / "page.md")
    with pytest.raises(InputError, match="no case has been diagnosed yet"):
        measured.run(out, page, plants=["stack"], so_far=True)
    report_on(cases[0], tmp_path / "out" / "measured")
    report_on(replace(cases[1], warm_up=0.4), tmp_path / "out" / "measured")
    measured.run(out, page, plants=["stack"], so_far=True)
    part = (tmp_path / "page.md").read_text()
    assert (
        "--so-far" in part
        and "Only 1 of its 3 cases were diagnosed" in part
        and "not counted are stack: hysteresis, all but 3." in part
    )
    assert "| stack | hysteresis |" not in part
    measured.run(out, page, plants=["stack"])
    whole = (tmp_path / "page.md").read_text()
    assert "--so-far" not in whole and "Only" not in whole and "| stack | hysteresis |" in whole


def test_the_measured_stack_without_its_elements():
    """The whole model has no gap on loops that it was not fitted to; without hysteresis, or with few operators, that is named first."""
    try:
        cases = list(stack_cases())
    except InputError as error:
        pytest.skip(str(error))
    for case in cases:
        report, *_ = measured.diagnosed([case.record], case.model, warm_up=case.warm_up)
        if case.right:
            assert report["verdict"] in ("effect", "parameters"), case.element
            assert named_right(case, report), case.element
        else:
            assert report["verdict"] == "no_gap"
