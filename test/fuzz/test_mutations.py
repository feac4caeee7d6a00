# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The mutation tester itself: which checks it finds, and that a mutant is what runs."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
from mutations import BEGIN, END, MODULES, PAGE, ROOT, mutants, mutated, put_in, written

SOURCE = '''
def whole(text, more=None):
    """A number."""
    if text == "":
        raise ValueError("empty")
    if more is None:
        more = []
    try:
        return int(text)
    except ValueError:
        return None


def inner(node, block):
    def take(row):
        if row < 0:
            node.drop(row)
            return
        block.append(row)

    return take
'''


def test_the_checks_of_a_module_are_found():
    def kinds(checks):
        return [mutant.what for mutant in sorted(mutants(SOURCE, checks), key=lambda mutant: mutant.line)]

    first = ["line 4: if text == ''", "line 10: except ValueError"]
    assert kinds("raise") == first
    assert kinds("drop") == [*first, "line 16: if row < 0"]
    assert kinds("every") == [first[0], "line 6: if more is None", first[1], "line 16: if row < 0"]


def test_a_mutant_takes_the_place_of_the_function_wherever_it_is_used(tmp_path, monkeypatch):
    path = tmp_path / "a_module_to_mutate.py"
    path.write_text(SOURCE)
    monkeypatch.syspath_prepend(str(tmp_path))
    import a_module_to_mutate as module  # type: ignore[import-not-found]

    try:
        whole, inner = module.whole, module.inner  # as another module would have imported them
        by_line = {mutant.line: mutant for mutant in mutants(SOURCE, "every")}

        def outcome(text):
            try:
                return whole(text)
            except ValueError as error:
                return str(error)

        assert (outcome(""), outcome("x"), outcome("3")) == ("empty", None, 3)
        put_in(path, path.stem, mutated(SOURCE, by_line[4]))
        assert (outcome(""), outcome("x"), outcome("3")) == (None, None, 3)
        put_in(path, path.stem, mutated(SOURCE, by_line[10]))
        assert outcome("") == "empty" and outcome("x").startswith("invalid literal") and outcome("3") == 3
        put_in(path, path.stem, mutated(SOURCE, by_line[16]))
        block: list[int] = []
        inner(None, block)(-1)
        assert block == [-1]
    finally:
        del sys.modules[path.stem]


def test_a_table_is_written_row_by_row():
    first, second = list(MODULES)[:2]
    page = f"before\n{BEGIN}{END}after\n"
    page = written(page, {second: (6, 5)})
    page = written(page, {first: (4, 4)})
    page = written(page, {second: (6, 6)})
    assert page.startswith("before\n") and page.endswith("after\n")
    rows = [line for line in page.splitlines() if line.startswith("| ")][1:]
    assert rows == [f"| `{first}` | 4 | 4 |", f"| `{second}` | 6 | 6 |", "| all | 10 | 10 (100.0 %) |"]


def test_modules_and_tests_are_there():
    for path, module in MODULES.items():
        assert (ROOT / path).exists() and all((ROOT / test).exists() for test in module.tests), path
    assert written(PAGE.read_text(encoding="utf-8"), {}) == PAGE.read_text(encoding="utf-8")
