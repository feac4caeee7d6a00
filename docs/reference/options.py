# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The families and their options as Markdown tables: the tables of `docs/identification.md`, from the estimators themselves.

`python -m docs.reference.options docs/identification.md` updates them in the document.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Mapping
from dataclasses import replace
from itertools import starmap
from pathlib import Path

from docs.reference.tables import table
from hyst_control.base.errors import InputError
from hyst_control.base.files import write_text
from hyst_control.base.quantity import TRUTH, shown
from hyst_control.identify.families.estimator import estimators, every_option
from hyst_control.identify.families.options import Option

BEGIN, END = "<!-- made by docs.reference.options -->", "<!-- end -->"


def tables() -> str:
    """Return both tables: a row a family, then a row an option and default."""
    families = table(
        "family | model and fit | methods", ((f"`{n}`", e.sentence, ", ".join(e.methods)) for n, e in estimators().items())
    )
    options = table("option | meaning | value | unit | families and their default", starmap(_row, every_option().items()))
    return f"{families}\n{options}".rstrip()


def _row(name: str, families: Mapping[str, Option]) -> tuple[str, ...]:
    first = max(families.values(), key=lambda each: len(each.choices))
    flag = name.replace("_", "-")
    flags = f"`--{flag}`, `--no-{flag}`" if first.kind is TRUTH else f"`--{flag}`"
    having: dict[str, list[str]] = {}
    for family, each in families.items():
        having.setdefault("chosen" if each.default is None else shown(each.default), []).append(f"`{family}`")
    defaults = "; ".join(f"{', '.join(each)}: {default}" for default, each in having.items())
    return flags, first.meaning, replace(first, unit="").requirement, first.unit, defaults


def with_present_tables(document: str) -> str:
    """Replace the tables between a document's two marks with present ones."""
    updated, count = re.subn(f"{BEGIN}.*?{END}", lambda _: f"{BEGIN}\n{tables()}\n{END}", document, flags=re.DOTALL)
    if count != 1:
        raise InputError(f"document: must have one pair of the marks {BEGIN} and {END}, has {count}")
    return updated


if __name__ == "__main__":
    page = Path(sys.argv[1])
    write_text(page, with_present_tables(page.read_text(encoding="utf-8")))
