"""Result tables: the JSON form that others read, and the text beside it."""

import json

import numpy as np
import pytest

from hyst_control.base.errors import InputError
from hyst_control.reporting.tables import Table


def filled() -> Table:
    table = Table("reproduce something")
    table.add("Table 5", "100 Hz", "HAMPI", "nrmse", "%", np.float64(1.25), published=1.61, n=np.int64(3), ci95=(1.0, 1.5))
    table.add("Table 6", "10 Hz", "MHL", "fit_time", "s", 12345.0)
    return table


def test_the_file_holds_numbers_and_null_only(tmp_path):
    path = tmp_path / "table.json"
    filled().write(path)
    document = json.loads(path.read_text(encoding="utf-8"))
    assert (document["schema"], document["version"], document["source"]) == (
        "hyst_control/table",
        1,
        "reproduce something",
    )
    assert document["rows"][0] == {
        "table": "Table 5",
        "case": "100 Hz",
        "subject": "HAMPI",
        "quantity": "nrmse",
        "unit": "%",
        "value": 1.25,
        "published": 1.61,
        "n": 3,
        "ci95": [1.0, 1.5],
    }
    assert document["rows"][1]["published"] is None and document["rows"][1]["ci95"] is None
    assert list(tmp_path.iterdir()) == [path]


def test_a_value_that_is_no_number_becomes_null():
    table = Table("bench")
    table.add("bench", "", "hyst", "rate", "1/s", float("nan"))
    assert table.document()["rows"][0]["value"] is None
    assert "nan" in table.text()


def test_the_text_shows_every_table_and_aligns_its_columns():
    lines = filled().text().splitlines()
    assert lines[0] == "Table 5" and "1.25" in lines[2] and "1.61" in lines[2]
    assert lines[1].index("subject") == lines[2].index("HAMPI")
    assert "Table 6" in lines and "published" not in lines[lines.index("Table 6") + 1]


def test_a_folder_that_is_not_there_is_refused_in_one_line(tmp_path):
    with pytest.raises(InputError, match="choose a folder"):
        filled().write(tmp_path / "absent" / "table.json")


def test_value_finds_one_row():
    assert filled().value("100 Hz", "HAMPI", "nrmse") == 1.25
    with pytest.raises(KeyError):
        filled().value("100 Hz", "HAMPI", "nme")
