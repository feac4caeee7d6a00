# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Documents: no broken link, every command explained, every page in the site's navigation."""

from __future__ import annotations

import re
import shlex
from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from docs.reference.effects import RECORD
from docs.reference.pages import pages as reference_pages
from hyst_control.cli import parser
from hyst_control.effects import EFFECTS as CATALOGUE
from hyst_control.records.validity.findings import NAMES

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
REFERENCE = reference_pages()
"""Pages that are written when the site is built."""


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere_in_a_clone(page):
    for target in re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", page.read_text(encoding="utf-8")):
        assert target.startswith("http") or (page.parent / target).exists(), f"{page.name} links to {target}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_paths_that_are_named_exist(page):
    text = page.read_text(encoding="utf-8")
    for path in re.findall(r"`((?:hyst_control|hyst_plant_sim|config|docs|test)/[\w./-]+)`", text):
        assert (ROOT / path).exists(), f"{page.name} names {path}"


def test_every_page_is_in_the_navigation():
    def pages(entries):
        for entry in entries:
            for value in entry.values():
                yield from pages(value) if isinstance(value, list) else [value]

    site = yaml.safe_load((ROOT / "mkdocs.yml").read_text())
    listed = list(pages(site["nav"]))
    tracked = [page.relative_to(ROOT / "docs").as_posix() for page in (ROOT / "docs").rglob("*.md")]
    executed = [f"notebooks/{path.stem}.md" for path in (ROOT / "docs" / "notebooks").glob("*.ipynb")]
    assert sorted(listed) == sorted([*tracked, *executed, *{f"{path.rpartition('/')[0]}/" for path in REFERENCE}])


def test_the_readme_is_short():
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= 120


def test_the_reference_of_commands_has_every_option():
    """Read from the parsers, not from what made the page."""
    commands = next(action for action in parser()._actions if hasattr(action, "choices") and action.choices).choices
    for name, command in commands.items():
        text = REFERENCE[f"reference/commands/{name}.md"]
        options = {word for action in command._actions for word in action.option_strings} - {"-h", "--help", "--json", "--quiet"}
        assert all(f"`{option}`" in text for option in options), name


def test_the_reference_of_effects_has_the_range_that_the_diagnosis_searches():
    for name, effect in CATALOGUE.items():
        record = replace(RECORD, axes=2) if effect.couples else RECORD
        due = {each.name: (each.lower, each.upper) for each in effect.parameters(record) if each.told}
        table = re.findall(r"^\| `(\w+)` \| (\S+) \| (\S+) \| (\S+) \|$", REFERENCE[f"reference/effects/{name}.md"], re.MULTILINE)
        assert {row[0] for row in table} == set(due), name
        for parameter, unit, lower, upper in table:
            assert unit and (float(lower), float(upper)) == pytest.approx(due[parameter], rel=5e-3), f"{name}: {parameter}"


def test_the_readme_shows_every_subcommand():
    text = (ROOT / "README.md").read_text()
    commands = next(action for action in parser()._actions if hasattr(action, "choices") and action.choices).choices
    missing = [name for name in commands if f"hyst {name}" not in text]
    assert not missing


def shown_commands() -> list[str]:
    """Every line of a code block of the README that calls `hyst`, with a prompt or without, and without its comment."""
    blocks = re.findall(r"^```\w*\n(.*?)^```", (ROOT / "README.md").read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)
    lines = [line.removeprefix("$ ") for block in blocks for line in block.splitlines()]
    return [re.split(r" [#|]", line)[0].strip() for line in lines if line.startswith("hyst ")]


def test_the_readme_shows_commands():
    assert len(shown_commands()) > 10


@pytest.mark.parametrize("line", shown_commands())
def test_a_command_of_the_readme_parses(line, capsys):
    try:
        parser().parse_args(shlex.split(line)[1:])
    except SystemExit as ended:
        assert ended.code == 0, capsys.readouterr().err


def test_every_test_that_the_safety_page_names_exists():
    """And every row of its table of faults names one."""
    text = (ROOT / "docs" / "safety.md").read_text(encoding="utf-8")
    table = text[text.index("## Faults") : text.index("## Records and files")]
    rows = [line.split("|")[1:-1] for line in table.splitlines() if line.startswith("| ")][1:]
    assert len(rows) > 15 and all(len(row) == 4 and re.search(r"`test_\w+`", row[3]) and row[2].strip() for row in rows)
    table = text[text.index("## Records and files") : text.index("## A node for your hardware")]
    rows = [line.split("|")[1:-1] for line in table.splitlines() if line.startswith("| ")][1:]
    said = set(re.findall(r"`(\w+)`", "".join(row[1] for row in rows)))
    assert all("`test_" in row[2] or "as above" in row[2] for row in rows) and set(NAMES) <= said
    defined = {
        name
        for file in (ROOT / "test").rglob("test_*.py")
        for name in re.findall(r"^def (test_\w+)", file.read_text(), re.MULTILINE)
    }
    named = set(re.findall(r"`(test_\w+)`", text))
    assert named and not named - defined


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_pictures_of_two_schemes_are_shown_one_at_a_time(page):
    """Also by readers that know nothing of the site's style sheet, such as the repository's pages."""
    text = page.read_text(encoding="utf-8")
    assert "#only-" not in text
    for picture in re.findall(r"<picture>(.*?)</picture>", text, re.DOTALL):
        dark, light = re.findall(r'src(?:set)?="([^"]+)"', picture)
        assert 'media="(prefers-color-scheme: dark)" srcset=' in picture and "alt=" in picture
        assert dark != light and (page.parent / dark).exists() and (page.parent / light).exists()
