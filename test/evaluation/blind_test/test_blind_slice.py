# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A slice of the blind test: cases of tuning seeds, diagnosed from bag and model alone, asserted at the lower end of the intervals.

The simulated records are about a quarter as long as those of a whole run, which saves time and asks more of the diagnosis.
"""

from __future__ import annotations

import pytest

from evaluation.blind_test.run import Batch, diagnose_all, make
from evaluation.blind_test.scores import wilson
from hyst_control.base.errors import InputError

pytestmark = pytest.mark.long_file

SEED, COUNT, INJECTED = 11, 11, 4
DURATION = 0.4
"""Length of a simulated record, s."""


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    options = {
        "plants": ("pea_published",),
        "excitations": ("rich",),
        "kinds": {"single": 0.72, "none": 0.28},
        "duration": DURATION,
    }
    return diagnosed(Batch("simulated", tmp_path_factory.mktemp("blind"), SEED, COUNT, options))


def diagnosed(batch: Batch):
    """Results of a batch, all of it made and diagnosed."""
    make(batch, note=lambda _: None)
    diagnose_all([batch], note=lambda _: None)
    return batch.results()


@pytest.mark.timeout(900)
def test_single_effects_are_named_and_records_without_a_gap_raise_no_alarm(results):
    singles, none = ([one for one in results if one.kind == kind] for kind in ("single", "none"))
    assert len(singles) >= 8 and len(none) >= 2
    assert wilson(sum(one.leads for one in singles), len(singles))[0] > 0.5  # 7 of 8
    assert not any(one.verdict in ("effect", "ambiguous", "unknown") for one in none)


@pytest.mark.timeout(900)
def test_effects_put_into_measured_records_are_named(tmp_path):
    """Each is named, or the diagnosis says that it does not know: a wrong name at three times the model discrepancy is an error."""
    try:
        results = diagnosed(Batch("injected", tmp_path / "run", SEED, INJECTED, {"plants": ["stack"]}))
    except InputError as error:
        pytest.skip(str(error))
    right = [one.first for one in results]
    assert len(results) == INJECTED and sum(right) >= 3, [(one.case.names, one.verdict) for one in results]


def test_a_run_that_was_interrupted_goes_on(tmp_path):
    """Reports that are there are not made again: the second call has nothing to do; other cases are refused."""
    said: list[str] = []
    folder = tmp_path / "blind"
    batch = Batch("simulated", folder, 12, 1, {"plants": ("pea_published",), "excitations": ("rich",), "kinds": {"none": 1.0}})
    make(batch, note=said.append)
    report = folder / "reports" / "case_0000.json"
    report.parent.mkdir()
    report.write_text("{}")
    diagnose_all([batch], note=said.append)
    assert report.read_text() == "{}"
    make(Batch("simulated", folder, 12, 1), note=said.append)
    assert said[0] == said[-1] and "SHA-256" in said[0]
    for other in (Batch("simulated", folder, 13, 1), Batch("simulated", folder, 12, 1, {"kinds": ("pair",)})):
        with pytest.raises(InputError, match="another seed"):
            make(other)
