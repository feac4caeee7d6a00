# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Manifests: lists of a fleet's records, one row a record, from a CSV or Parquet file or from the names of bags.

Columns are those of `Entry`; paths are relative to the manifest's folder. All but `bag` may be left out; any other column is kept.
"""

from __future__ import annotations

import csv
import glob
import itertools
import os
import re
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path

import numpy as np

from hyst_control.base.errors import InputError
from hyst_control.records.bags.bag_files import bags_in

TABLES = (".csv", ".parquet")
OWN = ("bag", "unit", "time", "model", "baseline")


@dataclass(frozen=True)
class Entry:
    """One record of a fleet."""

    bag: str  # Path of the bag
    unit: str  # Actuator that it is of
    time: str = ""  # When it was taken, as in the manifest
    model: str = ""  # Path of its model file; "" for none
    baseline: tuple[str, ...] = ()  # Paths of baseline records
    columns: Mapping[str, str] = field(default_factory=dict)  # Further columns of the manifest, as texts

    @property
    def moment(self) -> float:
        """The time as a number: as in the manifest, or seconds since 1970 of a date; NaN where there is none."""
        return moment(self.time)


def moment(text: str) -> float:
    """Convert a time as manifests have it."""
    if not is_date(text):
        return float(text or "nan")
    try:
        return datetime.fromisoformat(text).timestamp()
    except ValueError:
        raise InputError(f"time: must be a number or a date such as 2026-03-01T22:15, got {text!r}") from None


def is_date(text: str) -> bool:
    """Tell a time that is no finite number."""
    try:
        return bool(text) and not np.isfinite(float(text))
    except ValueError:
        return True


def read_manifest(
    sources: Sequence[str], names: str | None = None, model: str | None = None, baseline: Sequence[str] = ()
) -> list[Entry]:
    """Read manifests, or make one from the names of bags."""
    # names: regular expression with the groups `unit` and, if wanted, `time` that is searched in a bag's path; without it the unit
    # is the folder that a bag lies in; without any time it is the bag's place among those of its unit
    entries: list[Entry] = []
    bags: list[str] = []
    for source in sources:
        if source.endswith(TABLES):
            entries += _of_table(Path(source))
            continue
        pattern = glob.has_magic(source) and not os.path.exists(source)
        found = sorted(glob.glob(source, recursive=True)) if pattern else [source]
        if not found:
            raise InputError(f"{source}: no file or folder has such a name")
        bags += map(str, bags_in(found))
    entries += _of_names(bags, names)
    if not entries:
        raise InputError(f"{', '.join(sources) or 'manifest'}: lists no records")
    entries = [replace(each, model=each.model or model or "", baseline=each.baseline or tuple(baseline)) for each in entries]
    entries = _with_times(entries)
    seen: set[str] = set()
    runs: dict[tuple[str, float], str] = {}
    for entry in entries:
        if entry.bag in seen:
            raise InputError(f"{entry.bag}: is listed twice")
        seen.add(entry.bag)
        other = runs.setdefault((entry.unit, entry.moment), entry.bag)
        if other != entry.bag:
            raise InputError(
                f"{entry.bag}: time: {other} of the same unit has {entry.time} too: "
                "give every record of a unit its own time, or leave the times out"
            )
    return sorted(entries, key=lambda entry: (entry.unit, entry.moment, entry.bag))


def _with_times(entries: Sequence[Entry]) -> list[Entry]:
    """Entries whose times are of one kind; without any time the records of a unit are counted in the order given."""
    kinds = {"a date" if is_date(entry.time) else "a number" if entry.time else "none": entry.bag for entry in entries}
    if len(kinds) > 1:
        found = ", ".join(f"{kind} at {bag}" for kind, bag in kinds.items())
        raise InputError(f"time: {found}: give all records numbers, give all dates, or leave the times out")
    places: defaultdict[str, Iterator[int]] = defaultdict(itertools.count)
    return [entry if entry.time else replace(entry, time=str(next(places[entry.unit]))) for entry in entries]


def _of_table(path: Path) -> Iterator[Entry]:
    if not path.exists():
        raise InputError(f"{path}: does not exist: give the path of a manifest")
    rows = _parquet_rows(path) if path.suffix == ".parquet" else _csv_rows(path)
    for number, row in enumerate(rows, start=1):
        if not row.get("bag"):
            raise InputError(f"{path}: row {number}: bag: is missing; columns {', '.join(OWN)} and any others are read")

        def located(text: str) -> str:
            return str(path.parent / text) if text else ""

        try:
            moment(row.get("time", ""))
        except InputError as error:
            raise InputError(f"{path}: row {number}: {error}") from None
        yield Entry(
            located(row["bag"]),
            row.get("unit") or Path(row["bag"]).parent.name or Path(row["bag"]).stem,
            row.get("time", ""),
            located(row.get("model", "")),
            tuple(located(each.strip()) for each in row.get("baseline", "").split(";") if each.strip()),
            {name: value for name, value in row.items() if name not in OWN},
        )


def _csv_rows(path: Path) -> Iterator[dict[str, str]]:
    try:
        with open(path, newline="", encoding="utf-8-sig") as file:
            for row in csv.DictReader(file):
                if None in row:
                    raise InputError(f"{path}: a row has more cells than the header: {row[None]}")
                yield {name.strip(): (value or "").strip() for name, value in row.items()}
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path}: cannot be read ({error}): give a CSV file in UTF-8") from None


def _parquet_rows(path: Path) -> Iterator[dict[str, str]]:
    from hyst_control.fleet.results import arrow

    pa = arrow()
    try:
        table = pa.parquet.read_table(path)
    except (OSError, pa.ArrowException) as error:
        raise InputError(f"{path}: cannot be read ({error}): give a Parquet file") from None
    for row in table.to_pylist():
        yield {name: "" if value is None else str(value) for name, value in row.items()}


def _of_names(bags: Sequence[str], names: str | None) -> Iterator[Entry]:
    try:
        pattern = re.compile(names) if names else None
    except re.error as error:
        raise InputError(f"--names {names}: is no regular expression ({error})") from None
    if pattern is not None and "unit" not in pattern.groupindex:
        raise InputError(f"--names {names}: needs a group (?P<unit>...)")
    for bag in bags:
        if pattern is None:
            yield Entry(bag, Path(os.path.realpath(bag)).parent.name)
            continue
        found = pattern.search(bag)
        if found is None:
            raise InputError(f"{bag}: --names {names} does not fit it")
        yield Entry(bag, found["unit"], found.groupdict().get("time") or "")
