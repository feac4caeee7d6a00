# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The form of a text table: separator, decimal mark, and where the header of an instrument ends and the rows of numbers begin."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timezone

from hyst_control.base.errors import InputError
from hyst_control.records.tables.columns import TIME_UNITS
from hyst_control.records.tables.units import scaled_unit

SAMPLE_LINES = 1000  # Lines from which the form is judged
TAIL = 4  # The last quarter of these lines tells the columns: an instrument's header is shorter than that

MISSING = frozenset(
    "overload overrange over ovld ovl ol overflow nan inf infinity \u221e n/a na null none 1.#inf 1.#qnan 1.#ind".split()
)
"""Words in small letters that stand for a number which is missing, as does a cell of signs alone ("--", "***")."""

SETTINGS = 0.05
"""Rows of numbers above a line of words, per row below it, up to which they are settings with names of their own."""

SETTINGS_BESIDE = 40  # Rows of numbers beside which an instrument may write its settings

HEADER_ROWS = 3
COMMON_UNITS = ("V", "s", "um", "nm", "mm", "ms", "us", "mV", "kV", "mA", "kN", "mN", "Hz", "µm", "\u03bcm")
"""Short texts that are a unit rather than a name where they stand alone."""

_WORDS = re.compile(r'"[^"]*"|\S+')
_GAPS = re.compile(r"\s{2,}|\t")
_LITERAL_START = re.compile(r"^\s*(\w[\w.]*\s*=\s*)?\[\s*(?=[-+.\d])")
_LITERAL_END = re.compile(r"(?<=[\d.])[ ]*(\][ ]*;?|;)?[ ]*(\.\.\.)?[ ]*$")
_COMMA_NUMBER = re.compile(r"[-+]?(\d+(,\d*)?|,\d+)([eE][-+]?\d+)?|[-+]?[1-9]\d{0,2}(\.\d{3})+,\d*")
_UNIT_BEHIND = re.compile(r"\s*(?:\[(?P<square>[^\]]*)\]|\((?P<round>[^)]*)\)|,\s*(?P<comma>[^\s,]+)|\bin\s+(?P<word>[^\s,]+))$")
_UNIT_AT_END = re.compile(
    r"(?<=[^\W_])[_.](?P<clear>[nuµ\u03bcmk]?V|[nuµ\u03bcmc]m|[nuµ\u03bcm][sA]|[mk]?N|k?Hz|[uµ\u03bcm]?rad|deg|arcsec|counts|volts?|microns?|dB)$"
    r"|(?<=[^\W_]{3})_(?P<short>[mAs])$"  # not of y_m, ch_A
    r"|(?:(?<=\b[Tt])|(?<=[Tt]ime))_(?P<time>s|min|h)$"
)
_UNIT_CELL = re.compile(r"\[([^\[\]]*)\]|\(([^()]*)\)")
_MOMENT = re.compile(
    r"(?:(?P<day>\d{4}[-/]\d\d[-/]\d\d)|(?P<first>\d{1,2})(?P<mark>[./])(?P<second>\d{1,2})[./](?P<year>\d{4}))?[T ]?"
    r"(?P<time>\d{1,2}:\d\d.*?)(?: ?(?P<half>[AaPp])\.?[Mm]\.?)?"
)
_MONTHS = "jan feb mar apr may jun jul aug sep oct nov dec".split()
_NAMED_MONTH = re.compile(rf"(\d{{1,2}})[- ]({'|'.join(_MONTHS)})[a-z]*[- ](\d{{4}})", re.IGNORECASE)
_DURATION = re.compile(r"([-+]?[\d.]+(?:[eE][-+]?\d+)?) (sec|min|hr)")
_DURATION_UNITS = {"sec": 1.0, "min": 60.0, "hr": 3600.0}
_FORTRAN = re.compile(r"([-+]?[\d.]+)[dD]([-+]?\d+)")
_GROUPED = re.compile(r"[-+]?\d{1,3}([,'’]\d{3})+(\.\d*)?")
_SAMPLING = re.compile(
    r"(?:sampl\w*?|scan|acquisition|abtast)[ _]*(?P<what>interval|period|time|rate|freq|zeit)|(?P<step>delta_x|increment)"
)
_DIGITS = re.compile(r"\d+")
_SETTING = re.compile(r"[\s,;:=\[\]()\"#%]+")
_STEP_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9, "khz": 1e3, "mhz": 1e6, "ks/s": 1e3}
_GCS = re.compile(r"#\s*(?P<key>[A-Z_]+?)(?P<number>\d*)\s*=\s*(?P<value>.*)")


@dataclass(frozen=True)
class Form:
    """Rule by which a line is cut into cells: separator (None: white space) and decimal mark ("either" where the lines do not tell it)."""

    separator: str | None
    decimal: str

    def cells(self, line: str) -> list[str]:
        """Cells of a line, without quotes and spaces around them."""
        if self.separator is None:
            return [cell.strip('"') for cell in _WORDS.findall(line)]
        if '"' not in line:
            return [cell.strip() for cell in line.split(self.separator)]
        return [
            cell.strip().strip('"').strip() for cell in next(csv.reader([line], delimiter=self.separator, skipinitialspace=True))
        ]

    def is_number(self, cell: str) -> bool:
        """Check that a cell is a number, or a moment."""
        return self.number(cell) is not None

    def number(self, cell: str) -> float | None:
        """The number of a cell, seconds of a date or a time of day; None where it is none."""
        if self.decimal == "," or (self.decimal == "either" and "," in cell):
            return float(cell.replace(".", "").replace(",", ".")) if _COMMA_NUMBER.fullmatch(cell) else _moment(cell)
        try:
            return float(cell)
        except ValueError:
            if _GROUPED.fullmatch(cell):
                return float(re.sub("[,'’]", "", cell))
            fortran = _FORTRAN.fullmatch(cell)
            return _moment(cell) if fortran is None else float(f"{fortran[1]}e{fortran[2]}")


def is_missing(cell: str) -> bool:
    """Check that a cell says that its number is missing: that it is empty or of signs alone, or a word such as OVERLOAD."""
    word = cell.strip("+-*#!?. ").lower()
    return not word or word in MISSING


def _moment(cell: str) -> float | None:
    """Seconds since 1970 of a date with a time, since midnight of a time of day, of a duration; None where a cell is none of these."""
    # Of days as 3/4/2024 the month stands first, if it can, of days as 3.4.2024 it stands second.
    if (duration := _DURATION.fullmatch(cell)) is not None:
        return float(duration[1]) * _DURATION_UNITS[duration[2]]
    match = _MOMENT.fullmatch(_NAMED_MONTH.sub(lambda day: f"{day[1]}.{_MONTHS.index(day[2].lower()) + 1}.{day[3]}", cell))
    if match is None:
        return None
    day = (match["day"] or "1970-01-01").replace("/", "-")
    if match["year"]:
        first, second = int(match["first"]), int(match["second"])
        month, number = (first, second) if match["mark"] == "/" and first <= 12 else (second, first)
        day = f"{match['year']}-{month:02d}-{number:02d}"
    time = match["time"].replace(",", ".").replace("Z", "+00:00")
    time = re.sub(r"\.(\d+)", lambda fraction: f".{fraction[1][:6]:0<6}", time)  # Python 3.10 reads three or six digits only
    if match["half"]:
        hour, _, rest = time.partition(":")
        time = f"{int(hour) % 12 + 12 * (match['half'] in 'Pp'):02d}:{rest}"
    try:
        moment = datetime.fromisoformat(f"{day} {'0' * (time[1] == ':')}{time}")
    except ValueError:
        return None
    return (moment if moment.tzinfo else moment.replace(tzinfo=timezone.utc)).timestamp()


@dataclass(frozen=True)
class Layout:
    """A text's form and header."""

    form: Form
    width: int  # Number of cells of its rows
    numeric: tuple[int, ...]  # Columns of numbers
    first: int  # Line of its first row, of those that were looked at
    names: tuple[tuple[str, ...], ...]  # Of every column its header's cells, from the nearest up
    sample_time: float | None = None  # s, where the header states it
    notes: tuple[str, ...] = ()

    def column(self, name: str) -> int | None:
        """Number from 0 of the column of this name, with or without the unit behind it. Raises `InputError` where several have it."""
        exact = [index for index, cells in enumerate(self.names) if name in cells]
        alike = [
            [index for index, cells in enumerate(self.names) if bare in map(without_unit, cells)]
            for bare in (name, without_unit(name))
        ]
        found = next(filter(None, (exact, *alike)), [])
        if len(found) > 1 and not name.isdecimal():
            numbers = ", ".join(str(index + 1) for index in found)
            raise InputError(f"columns: {name!r} names several columns: choose one by its number: {numbers}")
        return found[0] if len(found) == 1 else None

    def title(self, index: int) -> str:
        """Name of a column; "" where it has none."""
        named = [cell for cell in self.names[index] if cell and unit_alone(cell) is None]
        return named[0] if named else ""

    def unit(self, index: int) -> str | None:
        """Unit of a column, of its name or of a line of units; None where it is not said."""
        said = (unit_alone(cell) or unit_behind(cell) for cell in self.names[index])
        return next((unit for unit in said if unit and _is_unit(unit)), None)


def without_unit(cell: str) -> str:
    """A name without the unit behind it: "Position" of "Position [um]"."""
    return _UNIT_BEHIND.sub("", cell).strip()


def unit_behind(cell: str) -> str | None:
    """The unit behind a name or at its end: "um" of "Position [um]" and of "pos_um"; None where there is none."""
    behind = _UNIT_BEHIND.search(cell) or _UNIT_AT_END.search(cell)
    unit = next(filter(None, behind.groups()), "").strip() if behind else ""
    return unit if _is_unit(unit) else None


def _is_unit(text: str) -> bool:
    return text in TIME_UNITS or scaled_unit(text) is not None


def unit_alone(cell: str) -> str | None:
    """The unit that a cell of a line of units holds."""
    bracketed = _UNIT_CELL.fullmatch(cell)
    if bracketed:
        return (bracketed[1] or bracketed[2] or "").strip()
    return cell if (len(cell) > 2 or cell in COMMON_UNITS) and scaled_unit(cell) is not None else None


def plain(line: str) -> str:
    """A line without the brackets and semicolons of a MATLAB literal, and with the minus sign of a keyboard."""
    line = line.replace("\u2212", "-")
    if "[" not in line and not line.rstrip(" ").endswith((";", "]", "...")):
        return line
    return _LITERAL_END.sub("", _LITERAL_START.sub("", line))


def header_form(line: str) -> str:
    """The words of a line of a header, which it has in common with that of the next run; "" where it has none."""
    return _DIGITS.sub("", line) if any(map(str.isalpha, line)) else ""


def is_comment(line: str) -> bool:
    """Check that a line is a comment."""
    return line.lstrip().startswith(("#", "%"))


def find_layout(lines: Sequence[str]) -> Layout | None:
    """The layout of a text that begins with these lines; None where they hold no row of numbers."""
    rows = [(index, line) for index, line in enumerate(lines) if not is_comment(line)]
    texts = [line for _, line in rows]
    form = _form(texts[-max(len(texts) // TAIL, 8) :])
    cells = [form.cells(line) for line in texts]
    flags = [[form.is_number(cell) for cell in row] for row in cells]
    width, numeric = _columns(flags[-max(len(flags) // TAIL, 8) :])
    moments = {index for index in numeric if len(cells[-1]) > index and ":" in cells[-1][index]}
    fits = [
        [flag and (":" in cell) == (index in moments) for index, (cell, flag) in enumerate(zip(row, is_number, strict=True))]
        for row, is_number in zip(cells, flags, strict=True)
    ]
    data = [
        len(row) == width
        and any(fit[index] for index in numeric)
        and all(fit[index] or (row[index] and is_missing(row[index])) for index in numeric)
        for row, fit in zip(cells, fits, strict=True)
    ]
    if not numeric or True not in data:
        return None

    def wordy(at: int) -> bool:
        known = [index for index in numeric if index < len(cells[at])]
        return any(cells[at][index] for index in known) and not any(fits[at][index] for index in known)

    first, notes = data.index(True), []
    for at in range(first + 1, len(data)):
        if at <= first or not wordy(at) or header_form(texts[at]) in map(header_form, texts[:first]):
            continue  # a header that is there again begins a further run
        if True in data[at:] and sum(data[first:at]) <= SETTINGS * sum(data[at:]):
            notes.append(f"{sum(data[first:at])} rows of numbers above the names were taken as settings")
            first = at + data[at:].index(True)
    above = first - 1
    if above >= 0 and len(cells[above]) == width and not wordy(above) and any(cells[above]):
        first = above  # a damaged row, which the reader names
    header: list[list[str]] = []
    for at in range(first - 1, max(first - 1 - HEADER_ROWS, -1), -1):
        found = _header_cells(texts[at], form, width)
        if found is None or not (wordy(at) or (header and not data[at])):
            break
        header.append(["" if index in numeric and form.is_number(cell) else cell for index, cell in enumerate(found)])
    start = rows[first][0]
    comments = [line for line in lines[:start] if is_comment(line)]
    sample_time, named = _gcs(comments)
    if named:
        header.insert(0, named)
    elif not header:
        for line in reversed(comments[-HEADER_ROWS:]):
            found = _header_cells(line.lstrip("#% \t"), form, width)
            if not found or any(map(form.is_number, found)):
                break
            header.append(found)
    names = tuple(tuple(row[index] for row in header if index < len(row)) for index in range(width))
    labels, units = _labeled([form.cells(line) for line in lines[:start]], numeric)
    names = tuple(tuple(filter(None, (labels.get(index), *each, units.get(index)))) for index, each in enumerate(names))
    if sample_time is None:
        beside = lines[start : start + SETTINGS_BESIDE] if len(numeric) < width else []
        settings = [*lines[:start], *(" ".join(reversed(cells)) for cells in names), *beside]
        sample_time = next((said for line in settings if (said := stated_sample_time(line)) is not None), None)
    return Layout(form, width, numeric, start, names, sample_time, tuple(notes))


def _labeled(rows: Sequence[Sequence[str]], numeric: Sequence[int]) -> tuple[dict[int, str], dict[int, str]]:
    """Names and units of columns, by their number, in rows of settings that begin with what they are: "TraceName", "Vertical Units"."""
    found: dict[str, dict[int, str]] = {"name": {}, "unit": {}}
    for row in rows:
        label = row[0].lower() if row else ""
        kind = "unit" if "unit" in label else "name" if re.search(r"name|label", label) else None
        said = {index: row[index] for index in numeric if 0 < index < len(row) and row[index]}
        if kind == "unit":
            said = {index: f"[{unit}]" for index, unit in said.items() if scaled_unit(unit) is not None}
        if kind is not None and len(said) > 1:
            found[kind] = {**said, **found[kind]}
    return found["name"], found["unit"]


def stated_sample_time(line: str) -> float | None:
    """Seconds between samples that a line of settings states, as "Sample Interval,1e-4" or "Sampling rate: 10 kHz" do."""
    said = _SAMPLING.search(line.lower())
    words = _SETTING.split(line[said.end() :].lower()) if said else []
    numbers = [index for index, word in enumerate(words) if re.fullmatch(r"\d*\.?\d+(e[-+]?\d+)?", word) and float(word) > 0]
    if said is None or not numbers or re.search(r"\d:\d\d", line):
        return None
    at = numbers[0]
    scale = next((_STEP_UNITS[word] for word in words[: at + 2] if word in _STEP_UNITS), 1.0)
    value = float(words[at]) * scale
    return 1.0 / value if said["what"] in ("rate", "freq") else value


def _form(lines: Sequence[str]) -> Form:
    """The form in which most cells are numbers, in the most columns."""
    best, best_score = Form(",", "."), (-1.0, -1)
    for separator in ("\t", ";", ",", None):
        if separator and not any(separator in line for line in lines):
            continue
        scores = {}
        for decimal in (".",) if separator == "," else (".", ","):
            form = Form(separator, decimal)
            cells = [cell for line in lines for cell in form.cells(line) if cell]
            numbers = sum(map(form.is_number, cells))
            scores[decimal] = (numbers / max(len(cells), 1), numbers)
        decimal = max(scores, key=lambda mark: scores[mark])
        if scores[decimal] > best_score:
            same = len(scores) == 2 and scores["."] == scores[","]
            best, best_score = Form(separator, "either" if same else decimal), scores[decimal]
    return best


def _columns(flags: Sequence[Sequence[bool]]) -> tuple[int, tuple[int, ...]]:
    """Width of most rows that hold numbers, and the columns in which at least half of them have one."""
    holding = [row for row in flags if any(row)]
    if not holding:
        return 0, ()
    width = Counter(map(len, holding)).most_common(1)[0][0]
    same = [row for row in holding if len(row) == width]
    return width, tuple(index for index in range(width) if 2 * sum(row[index] for row in same) >= len(same))


def _header_cells(line: str, form: Form, width: int) -> list[str] | None:
    """Cells of a line of names above rows of `width` cells; None where it is something else."""
    cells = form.cells(line)
    if form.separator is None:
        cells = [cell.strip(",;") for cell in cells]
        apart = [cell.strip() for cell in _GAPS.split(line.strip())]
        return cells if len(cells) == width else apart if len(apart) == width else None
    return cells if abs(len(cells) - width) <= 1 else None


def _gcs(comments: Sequence[str]) -> tuple[float | None, list[str]]:
    """Sample time and names of the columns in the header of a GCS array, as Physik Instrumente writes it."""
    said = [match for line in comments if (match := _GCS.match(line.strip()))]
    names = [match["value"].strip() for match in said if match["key"] == "NAME" and match["number"]]
    times = [match["value"] for match in said if match["key"] == "SAMPLE_TIME"]
    try:
        return (float(times[0]) or None) if times and names else None, names
    except ValueError:
        return None, names
