# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The script that keeps copyright and license in every source file."""

from __future__ import annotations

import ast
import subprocess

import pytest

headers = pytest.importorskip("headers", reason="a tool of `make lint`, in .ci")

HEADER = "# Copyright 2026 The hyst_control authors\n# SPDX-License-Identifier: Apache-2.0\n"


def test_header_is_added_once_behind_the_interpreter_and_nothing_else_changes(tmp_path):
    contents = {
        "module.py": '"""Title."""\n\nfrom __future__ import annotations\n\nX = "é"\n',
        "script.sh": "#!/usr/bin/env bash\nset -e\necho right\n",
        "run": "#!/bin/sh\necho right\n",
        "code.c": "int main(void) { return 0; }\n",
        "table.md": "no source\n",
        "empty.py": "",
        "LICENSE": "no script\n",
    }
    for name, text in contents.items():
        (tmp_path / name).write_text(text)
    (tmp_path / "script.sh").chmod(0o755)
    lacking = headers.lacking(tmp_path, list(contents))
    assert {path.name for path in lacking} == {"module.py", "script.sh", "run", "code.c"}
    for path in lacking:
        headers.add(path)
    assert headers.lacking(tmp_path, list(contents)) == []
    for name, text in contents.items():
        written = (tmp_path / name).read_text()
        assert written.replace(HEADER, "").replace(HEADER.replace("# ", "/* ").replace("\n", " */\n"), "") == text
    assert ast.get_docstring(ast.parse((tmp_path / "module.py").read_text())) == "Title."
    assert (tmp_path / "script.sh").stat().st_mode & 0o111
    assert subprocess.run([tmp_path / "script.sh"], capture_output=True, text=True, check=True).stdout == "right\n"


def test_a_header_elsewhere_or_of_another_license_is_none(tmp_path):
    (tmp_path / "below.py").write_text(f"X = 1\n{HEADER}")
    (tmp_path / "other.py").write_text(HEADER.replace("Apache-2.0", "MIT"))
    assert len(headers.lacking(tmp_path, ["below.py", "other.py"])) == 2
