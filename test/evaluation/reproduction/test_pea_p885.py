# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The measured piezo stack: what is fitted on one cycle predicts nested loops of another record."""

from __future__ import annotations

import numpy as np
import pytest
from measured_here import needs

from evaluation.reproduction import pea_p885
from hyst_control.base.errors import InputError

measured = needs("pea_p885")


@pytest.fixture(scope="module")
def outcome(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pea")
    return pea_p885.run(str(folder)), folder


@measured
@pytest.mark.parametrize("rows", pea_p885.SCORED)
def test_madelung_predicts_the_nested_loops(outcome, rows):
    """Within 0.9 % of the range, held out, and better than play operators."""
    table, _ = outcome
    errors = {
        row.subject: row.value for row in table.rows if row.table.startswith("P-885.91, fitted on one cycle") and row.case == rows
    }
    best = min(errors["Madelung, quintic"], errors["Madelung, piecewise cubic"])
    assert errors["Madelung, quintic"] <= 0.9
    static = [value for name, value in errors.items() if "operators" in name]
    assert len(static) == 2 and best < min(static)


@measured
@pytest.mark.parametrize("rows", pea_p885.SCORED)
def test_signs_offsets_and_beginnings_do_not_matter(outcome, rows):
    """Bipolar, negative, offset and inverted drives whose record begins amid a motion: within 1 % of the range, held out."""
    changed = [row for row in outcome[0].rows if row.table.endswith("first third cut off") and row.case == rows]
    assert len(changed) == len(pea_p885.CHANGES) and max(row.value for row in changed) <= 1.0


@measured
def test_any_cycle_will_do(outcome):
    table, _ = outcome
    assert table.value("rows 7950-14150", "Madelung, quintic", "nrmse_greatest") <= 1.0
    assert table.value("rows 7950-14150", "Madelung, quintic", "nrmse_mean") <= 0.9


@measured
def test_the_page_has_every_table(outcome):
    table, folder = outcome
    page = (folder / "pea-p885.html").read_text()
    assert all(f"<h2>{name}</h2>" in page for name in {row.table for row in table.rows})


@measured
def test_the_cycles_are_full_loops():
    full, nested = pea_p885.load()
    found = pea_p885.cycles(full)
    assert len(found) == 39
    for cycle in found:
        assert len(cycle.command) == 201
        assert np.ptp(cycle.command) == np.ptp(full.command) and np.isclose(cycle.command[0, 0], cycle.command[-1, 0], atol=0.01)


def test_absent_measurements_are_one_clear_line(monkeypatch, tmp_path):
    monkeypatch.setenv("HYST_DATA", str(tmp_path))
    with pytest.raises(InputError, match="pea_p885: the measurements are not in"):
        pea_p885.run()
    (tmp_path / "pea_p885").mkdir()
    (tmp_path / "pea_p885" / "Model_Vi_Do.dat").write_text("1 2 3\n")
    with pytest.raises(InputError, match="Model_Vi_Do.dat: shape"):
        pea_p885.run()
