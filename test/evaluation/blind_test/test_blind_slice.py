"""A slice of the blind test: cases of tuning seeds, diagnosed from bag and model alone, asserted at the lower end of the intervals.

The simulated records are about a quarter as long as those of a whole run, which saves time and asks more of the diagnosis.
"""

from __future__ import annotations

import pytest

from evaluation.blind_test import injected
from evaluation.blind_test.injected_scores import named_right
from evaluation.blind_test.metric import wilson
from evaluation.blind_test.run import diagnose_all, load, make
from hyst_control.errors import InputError

pytestmark = pytest.mark.long_file

SEED, COUNT, INJECTED = 11, 11, 4
DURATION = 0.4
"""Length of a simulated record, s."""


@pytest.fixture(scope="module")
def pairs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("blind")
    make(
        folder,
        SEED,
        COUNT,
        note=lambda _: None,
        plants=("pea_published",),
        excitations=("rich",),
        kinds={"single": 0.72, "none": 0.28},
        duration=DURATION,
    )
    diagnose_all(folder, note=lambda _: None)
    return list(load(folder))


@pytest.mark.timeout(900)
def test_single_effects_are_named_and_records_without_a_gap_raise_no_alarm(pairs):
    singles = [(case, report) for case, report in pairs if case["label"]["kind"] == "single"]
    none = [report for case, report in pairs if case["label"]["kind"] == "none"]
    right = sum(bool(report["effects"]) and report["effects"][0]["name"] in case["label"]["names"] for case, report in singles)
    alarms = sum(report["verdict"] in ("effect", "ambiguous", "unknown") for report in none)
    assert len(singles) >= 8 and len(none) >= 2
    assert wilson(right, len(singles))[0] > 0.5  # 7 of 8
    assert alarms == 0


@pytest.mark.timeout(900)
def test_effects_put_into_measured_records_are_named(tmp_path):
    """Each is named, or the diagnosis says that it does not know: a wrong name at three times the model's own error is an error."""
    try:
        injected.make(str(tmp_path / "run"), SEED, INJECTED, ["stack"], note=lambda _: None)
    except InputError as error:
        pytest.skip(str(error))
    injected.diagnose_all(tmp_path / "run", note=lambda _: None)
    rows = injected.load(tmp_path / "run")
    right = [named_right(*row) for row in rows]
    assert len(rows) == INJECTED and sum(right) >= 3, [(label["names"], report["verdict"]) for label, report in rows]


def test_a_run_that_was_interrupted_goes_on(tmp_path):
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
