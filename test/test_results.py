# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The page of results: its tables are those of the result files, and so are the figures in its sentences."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from docs.make_results import DATA, is_met, rows_of, tables
from hyst_control.base.files import read_json
from hyst_control.reporting.tables import SCHEMA

PAGE = Path(__file__).resolve().parents[1] / "docs" / "results.md"


@pytest.mark.parametrize(("name", "table"), tables().items(), ids=list(tables()))
def test_a_table_of_the_page_is_of_the_data(name, table):
    assert table in PAGE.read_text(encoding="utf-8"), f"{name}: run: python docs/make_results.py"


def test_the_page_has_no_other_table():
    cells = re.findall(r"^\|.*\|$", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    assert cells == [line for table in tables().values() for line in table.splitlines()]


def test_figures_in_sentences_are_of_the_data():
    text = PAGE.read_text(encoding="utf-8")
    [stack] = [
        row.value
        for row in rows_of("pea_p885")
        if (row.table, row.case, row.subject, row.quantity)
        == ("P-885.91, fitted on one cycle, nested loops held out", "rows 7950-14150", "Madelung, quintic", "nrmse")
    ]
    published = {row.published for row in rows_of("bouc_wen") if row.quantity == "rms_error" and row.case == "multisine"}
    [softening] = [row.value for row in rows_of("fsm_cubespec") if (row.case, row.subject) == ("all", "softening: frequencies")]
    assert f"{stack:.2f} % NRMSE" in text and [f"{value:.1e} m" for value in published] == re.findall(r"reach (\S+ m) on", text)
    assert f"`hyst {read_json(DATA / 'blind_test.json')['source']}`" in text
    rows = [row for row in rows_of("blind_test") if row.published is not None]
    observers = [row for row in rows_of("blind_test") if row.case.startswith("ideal observer")]
    named = [f"{row.value:.2f}" for row in observers if "injected" not in row.case or row.case.endswith(" 3 x")]
    assert len(named) == 5 and all(share in text for share in named)
    assert f"Of all {len(rows)} rows with a target" in text and f"{sum(not is_met(row) for row in rows)} miss them" in text
    assert f"explains {softening:.0f} % of the gap" in text


@pytest.mark.parametrize("path", sorted(DATA.glob("*.json")), ids=lambda path: path.name)
def test_a_result_file_is_a_table_as_a_command_writes_it(path):
    document = read_json(path)
    assert document["schema"] == SCHEMA and document["source"] and document["rows"]
