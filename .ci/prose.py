# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Prose of documents and docstring titles: sentence length, words of another vocabulary, American spelling. `make lint` runs it.

`BUDGET` bounds the faults of what is not rewritten yet. Lower a number when a page has fewer; everything else has none.
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "test"))
from american import american, faults  # noqa: E402

PACKAGES = ("hyst_control", "hyst_plant_sim", "evaluation")
LONGEST = 30
"""Words of a sentence."""
BUDGET = {
    "docs/identification.md": 3,
    "evaluation": 5,
}
"""Faults that a document, or a package's docstring titles, may have."""
TERMS = {
    r"clean records?|clean (one|session)s?": "baseline record",
    r"own errors?": "model discrepancy",
    r"companions?": "session effects",
    r"contenders?": "candidate",
    r"shrinks?|shrank|shrunk|takes off": "reduction, removes",
    r"foreseen|foresees?": "predicted",
    r"run to run": "between runs",
    r"nobody knows": "unmodeled, outside the catalogue",
    r"beyond chance": "above the null threshold",
    r"turned round|driven backwards": "inverse model",
    r"goes over into": "blends into, bumpless",
    r"takes up|taken up": "anti-windup, compensates, continues",
    r"lattices?": "quantization",
    r"virgin curves?": "initial loading curve",
    r"truth plants?|truth mirrors?|truth actuators?": "reference simulation",
    r"in receptions?|times? of receptions?": "receive time",
    r"nights?": "run, date",
    r"told|freed|shaken": "a term of the field",
    r"per cent": "percent",
}
"""Word that is not of the vocabulary (a regular expression), and what to write."""
BANNED = {re.compile(rf"\b(?:{pattern})\b", re.IGNORECASE): remedy for pattern, remedy in TERMS.items()}
NO_PROSE = re.compile(r"```.*?```|^ {4,}\S.*?$|<[^>\n]+>|<!--.*?-->|https?://\S+", re.DOTALL | re.MULTILINE)
CODE = re.compile(r"`(?:[^`\n]|\n(?!\s*\n))+`")
LINK = re.compile(r"!?\[([^\]]*)\]\([^)]*\)")
SENTENCE_END = re.compile(r"(?<=[.!?;:])(?:\*\*)?\s+(?=[A-Z*(\[]|$)")
LIST_ITEM = re.compile(r"^\s*(?:[-*]|\d+\.)\s+", re.MULTILINE)


def paragraphs(text: str) -> Iterator[str]:
    """Paragraphs, list items, headings and cells of a document, without code blocks; code within a sentence counts as one word."""
    text = LINK.sub(r"\1", CODE.sub("Code", NO_PROSE.sub("", text)))
    for block in re.split(r"\n\s*\n", text):
        if block.lstrip().startswith("|"):
            for line in block.splitlines():
                yield from (cell.strip() for cell in line.strip("| ").split("|"))
        else:
            yield from (" ".join(item.lstrip("# ").split()) for item in LIST_ITEM.split(block))


def faults_of(text: str) -> Iterator[str]:
    """Long sentences and foreign words of one paragraph."""
    for sentence in SENTENCE_END.split(text):
        count = len(re.findall(r"\w[\w'’-]*", sentence))
        if count > LONGEST:
            yield f"{count} words, at most {LONGEST}: {sentence[:90]} …"
    for pattern, remedy in BANNED.items():
        yield from (f"{found[0]!r}: write {remedy}" for found in pattern.finditer(text))


def of_document(path: Path) -> list[str]:
    """Faults of a document."""
    found = [fault for text in paragraphs(path.read_text(encoding="utf-8")) for fault in faults_of(text)]
    return found + [f"{word!r}: write {american(word)}" for _, word in faults(path)]


def titles(path: Path) -> Iterator[tuple[str, str]]:
    """Name and first line of every docstring of a source file that is not private."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)):
            name, text = getattr(node, "name", path.stem), ast.get_docstring(node)
            if text and (not name.startswith("_") or name == "__init__"):
                yield name, CODE.sub("Code", text.split("\n\n")[0].replace("\n", " "))


def of_package(package: str) -> list[str]:
    """Faults of a package's docstring titles."""
    return [
        f"{path.relative_to(ROOT)}: {name}: {fault}"
        for path in sorted((ROOT / package).rglob("*.py"))
        for name, title in titles(path)
        for fault in faults_of(title)
    ]


def documents() -> list[Path]:
    """Documents that a user reads."""
    return [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").rglob("*.md"))]


def main() -> None:
    """Print the faults beyond the budget, and end with status 1 if there are any."""
    found = {str(path.relative_to(ROOT)): of_document(path) for path in documents()} | {name: of_package(name) for name in PACKAGES}
    over = {name: each for name, each in found.items() if len(each) > BUDGET.get(name, 0) or "--all" in sys.argv}
    for name, each in over.items():
        print(f"{name}: {len(each)} faults, at most {BUDGET.get(name, 0)}")
        print("\n".join(f"  {fault}" for fault in each))
    if over:
        sys.exit("prose: see CONTRIBUTING.md, Style")
    print(f"prose: {len(found)} documents and packages, {sum(map(len, found.values()))} faults within the budget")


if __name__ == "__main__":
    main()
