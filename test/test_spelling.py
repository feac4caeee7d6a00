# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""One spelling: American, in documents, comments, docstrings and messages."""

from __future__ import annotations

from pathlib import Path

import pytest
from american import american, faults, mend

ROOT = Path(__file__).resolve().parents[1]
FOLDERS = ("hyst_control", "hyst_plant_sim", "docs", "config", ".ci", "test")
KINDS = (".py", ".md", ".html", ".css", ".yaml")
ITSELF = ("american.py", "test_spelling.py")
FILES = sorted(
    path
    for folder in FOLDERS
    for path in (ROOT / folder).rglob("*")
    if path.suffix in KINDS and path.name not in ITSELF and not set(path.parts) & {"build", "__pycache__"}
)


def test_the_spelling_is_american():
    found = [
        f"{path.relative_to(ROOT)}: {word}: write {american(word)}"
        for path in (*FILES, ROOT / "README.md", ROOT / "CONTRIBUTING.md")
        for _, word in faults(path)
    ]
    assert len(FILES) > 400 and not found, "\n".join(found)


@pytest.mark.parametrize(
    ("text", "mended"),
    [
        ("# The colour of a normalised curve\ncolor = 1\n", "# The color of a normalized curve\ncolor = 1\n"),
        ('colour = 1\n"""The colour."""\n', 'colour = 1\n"""The colour."""\n'),  # a name stays as it is
        ("text = 'otherwise precise noise'\n", "text = 'otherwise precise noise'\n"),
        ("label = f'{1} Analysed in grey'\n", "label = f'{1} Analyzed in gray'\n"),
    ],
)
def test_what_is_british_is_found_and_mended(text, mended, tmp_path):
    path = tmp_path / "some.py"
    path.write_text(text)
    mend(path)
    assert path.read_text() == mended and not faults(path)


def test_code_in_documents_stays(tmp_path):
    path = tmp_path / "some.md"
    path.write_text("`colour` and colours\n```\ngrey\n```\n")
    mend(path)
    assert path.read_text() == "`colour` and colors\n```\ngrey\n```\n"
