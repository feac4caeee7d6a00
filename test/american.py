# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""British spellings in prose, of which this project uses the American ones: in documents, comments, docstrings and messages."""

from __future__ import annotations

import io
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path

STEMS = (
    "real discret linear normal penal capital regular optim minim maxim stabil initial synchron parametr quant organ recogn summar "
    "general character visual util polar serial central local vector symmetr random ideal equal factor digit anal"
).split()
WORDS = {
    "colour": "color",
    "behaviour": "behavior",
    "neighbour": "neighbor",
    "favour": "favor",
    "honour": "honor",
    "centre": "center",
    "centred": "centered",
    "metre": "meter",
    "fibre": "fiber",
    "grey": "gray",
    "licence": "license",
    "defence": "defense",
    "artefact": "artifact",
    "programme": "program",
    "modelled": "modeled",
    "modelling": "modeling",
    "labelled": "labeled",
    "labelling": "labeling",
    "travelled": "traveled",
    "cancelled": "canceled",
    "signalled": "signaled",
    "analyse": "analyze",
    "analysed": "analyzed",
    "whilst": "while",
    "judgement": "judgment",
    "ageing": "aging",
}
OPTIONS = ("discretisation",)
"""Names of options, which callers' scripts use."""
ISE = re.compile(rf"(?i)\b({'|'.join(STEMS)})is(e|ed|es|ing|ation|ations|er|ers)\b")
LISTED = re.compile(rf"(?i)\b({'|'.join(WORDS)})(s?)\b")
CODE = re.compile(r"(?s)```.*?```|`[^`\n]*`|\]\([^)]*\)|https?://\S+")


def american(word: str) -> str:
    """The American spelling of one word; the word itself where it has no other."""
    if (found := LISTED.fullmatch(word)) is not None:
        plain = WORDS[found[1].lower()]
        return (plain.capitalize() if word[0].isupper() else plain) + found[2]
    if (found := ISE.fullmatch(word)) is not None:
        return f"{found[1]}{'yz' if found[1].lower() == 'anal' else 'iz'}{found[2]}"
    return word


def british(text: str) -> list[re.Match[str]]:
    """British words of a text, in order."""
    return sorted([*ISE.finditer(text), *LISTED.finditer(text)], key=lambda found: found.start())


def prose(path: Path) -> Iterator[tuple[int, str, frozenset[str]]]:
    """Texts for people in a file: offset, text, and words that are names in it.

    In Python files these are comments and strings; names of the same file that a text speaks of stay as they are. In documents it is all
    but code and links.
    """
    text = path.read_text(encoding="utf-8")
    if path.suffix != ".py":
        begin = 0
        for code in CODE.finditer(text):
            yield begin, text[begin : code.start()], frozenset()
            begin = code.end()
        yield begin, text[begin:], frozenset()
        return
    starts = [0]
    for line in text.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    tokens = list(tokenize.generate_tokens(io.StringIO(text).readline))
    names = frozenset(
        part.lower() for token in tokens if token.type == tokenize.NAME for part in (token.string, *token.string.split("_"))
    )
    kinds = {tokenize.COMMENT, tokenize.STRING, getattr(tokenize, "FSTRING_MIDDLE", tokenize.STRING)}
    for token in tokens:
        if token.type in kinds:
            begin = starts[token.start[0] - 1] + token.start[1]
            end = starts[token.end[0] - 1] + token.end[1]
            yield begin, text[begin:end], names


def faults(path: Path) -> list[tuple[int, str]]:
    """Offset and word of every British spelling in a file's prose."""
    if not british(path.read_text(encoding="utf-8")):
        return []  # most files; those with such a word anywhere are read token by token
    return [
        (begin + found.start(), found[0])
        for begin, text, names in prose(path)
        for found in british(text)
        if found[0].lower() not in {*names, *OPTIONS}
    ]


def mend(path: Path) -> int:
    """Write the American spellings; returns how many words were changed."""
    text, found = path.read_text(encoding="utf-8"), faults(path)
    for offset, word in reversed(found):
        text = text[:offset] + american(word) + text[offset + len(word) :]
    if found:
        path.write_text(text, encoding="utf-8")
    return len(found)
