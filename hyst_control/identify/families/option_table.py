"""The families and their options as Markdown tables: the tables of `docs/identification.md`, from the estimators themselves.

`python -m hyst_control.identify.families.option_table docs/identification.md` updates them in the document.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

from hyst_control.base.errors import InputError
from hyst_control.base.files import write_text
from hyst_control.identify.families.estimator import estimators, every_option
from hyst_control.identify.families.options import TRUTH, Option

BEGIN, END = "<!-- made by hyst_control.identify.families.option_table -->", "<!-- end -->"


def tables() -> str:
    """Return both tables: a row a family, then a row an option and default."""
    rows = ["| family | model and fit | methods |", "|---|---|---|"]
    rows += [f"| `{name}` | {_escaped(each.sentence)} | {', '.join(each.methods)} |" for name, each in estimators().items()]
    rows += ["", "| option | meaning | value | unit | families and their default |", "|---|---|---|---|---|"]
    for name, families in every_option().items():
        first = max(families.values(), key=lambda each: len(each.choices))
        flag = f"`--{name.replace('_', '-')}`"
        if first.kind is TRUTH:
            flag += f", `--no-{name.replace('_', '-')}`"
        having: dict[str, list[str]] = {}
        for family, each in families.items():
            having.setdefault(_default(each), []).append(f"`{family}`")
        defaults = "; ".join(f"{', '.join(each)}: {default}" for default, each in having.items())
        value = first.requirement().replace(f" in {first.unit}", "") if first.unit else first.requirement()
        rows.append(f"| {flag} | {_escaped(first.meaning)} | {_escaped(value)} | {first.unit} | {defaults} |")
    return "\n".join(rows)


def _default(option: Option) -> str:
    if option.default is None:
        return "chosen"
    return str(option.default).lower() if isinstance(option.default, bool) else str(option.default)


def _escaped(text: str) -> str:
    return text.replace("|", "\\|")


def with_present_tables(document: str) -> str:
    """Replace the tables between a document's two marks with present ones."""
    updated, count = re.subn(f"{BEGIN}.*?{END}", lambda _: f"{BEGIN}\n{tables()}\n{END}", document, flags=re.DOTALL)
    if count != 1:
        raise InputError(f"document: must have one pair of the marks {BEGIN} and {END}, has {count}")
    return updated


if __name__ == "__main__":
    page = Path(sys.argv[1])
    write_text(page, with_present_tables(page.read_text(encoding="utf-8")))
