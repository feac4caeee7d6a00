"""A slice of the blind test: cases of a tuning seed, diagnosed from bag and model alone, asserted at the lower end of the intervals."""

from __future__ import annotations

import pytest

from hyst_control.blind_test.run import diagnose_all, load, make
from hyst_control.blind_test.scores import wilson

pytestmark = pytest.mark.long_file

SEED, DRAWN, DIAGNOSED = 11, 14, 11
"""The first of the cases that are drawn: 8 single effects and 3 records without a gap."""


@pytest.fixture(scope="module")
def pairs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("blind")
    make(
        folder,
        SEED,
        DRAWN,
        note=lambda _: None,
        plants=("pea_published",),
        excitations=("rich",),
        kinds={"single": 0.72, "none": 0.28},
    )
    diagnose_all(folder, {f"case_{index:04d}": () for index in range(DIAGNOSED)}, note=lambda _: None)
    return list(load(folder))


@pytest.mark.timeout(900)
def test_single_effects_are_named_and_records_without_a_gap_raise_no_alarm(pairs):
    singles = [(case, report) for case, report in pairs if case["label"]["kind"] == "single"]
    none = [report for case, report in pairs if case["label"]["kind"] == "none"]
    right = sum(bool(report["effects"]) and report["effects"][0]["name"] in case["label"]["names"] for case, report in singles)
    alarms = sum(report["verdict"] in ("effect", "ambiguous", "unknown") for report in none)
    assert len(singles) >= 8 and len(none) >= 2
    assert wilson(right, len(singles))[0] > 0.5  # at least 7 of 8
    assert alarms == 0


def test_a_run_that_was_interrupted_goes_on(pairs, tmp_path):
    """Reports that are there are not made again: the second call has nothing to do."""
    said: list[str] = []
    folder = tmp_path / "blind"
    make(folder, 12, 1, note=said.append, plants=("pea_published",), excitations=("rich",), kinds={"none": 1.0})
    report = folder / "reports" / "case_0000.json"
    report.parent.mkdir()
    report.write_text("{}")
    diagnose_all(folder, note=said.append)
    assert report.read_text() == "{}"
    make(folder, 12, 1, note=said.append)
    assert said[0] == said[-1] and "SHA-256" in said[0]
