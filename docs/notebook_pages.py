# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Pages of the notebooks: each is executed when the site is built, and shown with its output and figures.

Small enough that the site needs no Jupyter: code cells run in one namespace, in an empty folder.
"""

from __future__ import annotations

import ast
import base64
import io
import json
import os
import tempfile
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).resolve().parent / "notebooks"
NAMES = ("first_model", "model_comparison", "feedforward_feedback", "gap_of_your_data")
"""The notebooks, in the order in which one reads them."""


def cells(name: str) -> list[tuple[str, str]]:
    """Kind, "markdown" or "code", and text of each cell."""
    document = json.loads((FOLDER / f"{name}.ipynb").read_text(encoding="utf-8"))
    return [(cell["cell_type"], "".join(cell["source"])) for cell in document["cells"]]


def page(name: str) -> str:
    """Execute a notebook; its page in Markdown. An error names cell and notebook, and ends the build."""
    import matplotlib

    matplotlib.use("agg")
    parts, names, here = [], {"__name__": "__main__"}, os.getcwd()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        try:
            for number, (kind, text) in enumerate(cells(name), start=1):
                if kind == "markdown":
                    parts.append(text)
                else:
                    parts += [f"```python\n{text}\n```", *_executed(text, f"{name}.ipynb, cell {number}", names)]
        finally:
            os.chdir(here)
    parts.insert(1, f"[Download this notebook]({name}.ipynb)")
    return "\n\n".join(parts) + "\n"


def _executed(text: str, title: str, names: dict[str, Any]) -> list[str]:
    """Run a cell; what it prints, the value of its last expression, and its figures, as Markdown."""
    from matplotlib import pyplot

    tree = ast.parse(text)
    last = tree.body.pop() if tree.body and isinstance(tree.body[-1], ast.Expr) else None
    printed = io.StringIO()
    with redirect_stdout(printed):
        exec(compile(tree, title, "exec"), names)
        value = eval(compile(ast.Expression(last.value), title, "eval"), names) if isinstance(last, ast.Expr) else None
    found = [f"```text\n{printed.getvalue().rstrip()}\n```"] if printed.getvalue().strip() else []
    if value is not None:
        found.append(value._repr_html_() if hasattr(value, "_repr_html_") else f"```text\n{value!r}\n```")
    for figure in map(pyplot.figure, pyplot.get_fignums()):
        picture = io.BytesIO()
        figure.savefig(picture, format="png", dpi=80)
        data = base64.b64encode(picture.getvalue()).decode()
        found.append(f'<img src="data:image/png;base64,{data}" alt="figure of this cell" style="max-width:100%">')
    pyplot.close("all")
    return found


if __name__ == "__main__":
    import sys

    os.environ.setdefault("MPLBACKEND", "agg")
    print("\n".join(page(name) for name in sys.argv[1:] or NAMES))
