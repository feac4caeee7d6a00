# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The check of prose: what it finds, and what it leaves alone."""

from __future__ import annotations

import pytest

prose = pytest.importorskip("prose", reason="a tool of `make lint`, in .ci")


def words(count: int) -> str:
    return "A " + " ".join(["word"] * (count - 1)) + "."


@pytest.mark.parametrize(
    ("text", "found"),
    [
        (words(30), 0),
        (words(31), 1),
        (f"{words(20)} {words(20)}", 0),
        (f"**{words(20)}** {words(20)}", 0),
        ("The model's own error on clean records.", 2),
        ("The clock slows down, and the tolerance is unfolded.", 0),
    ],
)
def test_long_sentences_and_foreign_words_are_found(text, found):
    assert len(list(prose.faults_of(text))) == found


def test_code_links_and_cells_are_no_long_sentence(tmp_path):
    path = tmp_path / "page.md"
    path.write_text(
        f"```\n{words(40)}\n```\n\n`shrink` is a key, see [this](shrink.md).\n\n| a | b |\n|---|---|\n"
        f"| {words(20)[:-1]} | {words(20)} |\n\n- {words(20)[:-1]}\n- {words(20)}\n"
    )
    assert prose.of_document(path) == []
    path.write_text(f"| {words(40)} |\n\nAnalys" + "ed twice.\n")
    assert len(prose.of_document(path)) == 2


def test_titles_are_those_of_what_is_not_private(tmp_path):
    path = tmp_path / "code.py"
    path.write_text(
        '"""Of a module."""\n\n\ndef _own():\n    """Private."""\n\n\nclass Some:\n    """A `shrink` class.\n\n    More.\n    """\n'
    )
    assert list(prose.titles(path)) == [("code", "Of a module."), ("Some", "A Code class.")]


def test_the_budget_names_what_there_is():
    assert set(prose.BUDGET) <= {str(path.relative_to(prose.ROOT)) for path in prose.documents()} | {
        "hyst_control",
        "hyst_plant_sim",
        "evaluation",
    }
