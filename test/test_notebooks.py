# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Notebooks: the site's build executes each, they are stored without output, and an error in a cell is not passed over."""

from __future__ import annotations

import json

import pytest

from docs import notebook_pages


def write(folder, *code):
    cells = [{"cell_type": "markdown", "source": ["# Title"]}, *({"cell_type": "code", "source": [text]} for text in code)]
    (folder / "made.ipynb").write_text(json.dumps({"cells": cells}))


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setattr(notebook_pages, "FOLDER", tmp_path)
    return tmp_path


def test_every_notebook_is_executed_and_stored_without_output():
    assert sorted(notebook_pages.NAMES) == sorted(path.stem for path in notebook_pages.FOLDER.glob("*.ipynb"))
    for name in notebook_pages.NAMES:
        document = json.loads((notebook_pages.FOLDER / f"{name}.ipynb").read_text(encoding="utf-8"))
        assert document["nbformat"] == 4 and not [cell for cell in document["cells"] if cell.get("outputs")]
        for kind, text in notebook_pages.cells(name):
            if kind == "code":
                compile(text, name, "exec")


def test_a_page_has_what_the_cells_print_show_and_draw(folder):
    drawing = "from matplotlib import pyplot\naxes = pyplot.figure().add_subplot().plot([1, 2])"
    write(folder, "a = 6\nprint('printed')", "a * 7", drawing, "class Seen:\n    _repr_html_ = lambda self: '<b>seen</b>'\nSeen()")
    page = notebook_pages.page("made")
    assert "printed" in page and "```text\n42\n```" in page and page.count("<img ") == 1 and "<b>seen</b>" in page


def test_an_error_in_a_cell_ends_the_build(folder):
    write(folder, "a = 1", "assert a == 2")
    with pytest.raises(AssertionError) as raised:
        notebook_pages.page("made")
    assert "made.ipynb, cell 3" in str(raised.traceback[-1].path)
