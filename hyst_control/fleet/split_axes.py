# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Records of many axes as records of one axis each, so that a mirror of 5,000 actuators is a fleet of 5,000 units."""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from hyst_control.base.errors import InputError
from hyst_control.fleet.manifest import Entry
from hyst_control.fleet.record_jobs import bag_stamp
from hyst_control.records.actuator_following import APPLIED
from hyst_control.records.bags.bag_reader import read_bag
from hyst_control.records.record import Signal
from hyst_control.records.tables.importing import write_bag

AXIS = "x"  # Name of the axis of a record of one axis, as in models of one axis


class ReadingError(Exception):
    """A bag that cannot be read."""


def split_axes(entries: Sequence[Entry], folder: Path, namespace: str | None = None, unit: str = "unknown") -> list[Entry]:
    """Write a bag for every axis of every record, and of its baseline records, where it is not there yet."""
    done: dict[str, dict[str, str]] = {}
    found: list[Entry] = []

    def parts(bag: str) -> dict[str, str]:
        if bag not in done:
            done[bag] = _split(bag, folder / "axes", namespace, unit)
        return done[bag]

    for entry in entries:
        try:
            own, clean = parts(entry.bag), [parts(bag) for bag in entry.baseline]
        except (OSError, ReadingError):
            own, clean = {}, []  # the study lists the reason
        if len(own) < 2:
            found.append(entry)
            continue
        for bag, its in zip(entry.baseline, clean, strict=True):
            if set(its) != set(own):
                raise InputError(f"{bag}: has other axes than {entry.bag}, whose clean record it is")
        found += [
            replace(entry, bag=path, unit=f"{entry.unit}/{axis}", baseline=tuple(its[axis] for its in clean))
            for axis, path in own.items()
        ]
    return found


def _split(bag: str, folder: Path, namespace: str | None, unit: str) -> dict[str, str]:
    """Paths of a bag's parts by axis; written under another name and renamed as a whole."""
    place = folder / f"{Path(bag).name}_{hashlib.sha256((bag + bag_stamp(bag)).encode()).hexdigest()[:12]}"
    try:
        record = read_bag(bag, namespace, unit)
    except InputError as error:
        raise ReadingError(str(error)) from None
    signals = {topic: signal for topic, signal in record.signals.items() if topic in ("command", "measurement")}
    axes = next(iter(signals.values())).axes if signals else ()
    if not axes or any(signal.axes != axes for signal in signals.values()):
        raise InputError(f"{bag}: command and measurement must have the same axes to be split")
    if any(signal.timing == "receive" for signal in signals.values()):
        raise InputError(f"{bag}: has times of reception: --split-axes needs sample times, see hyst import")
    if APPLIED in record.signals and record.signals[APPLIED].axes == axes:
        signals[APPLIED] = record.signals[APPLIED]
    if len(axes) > 1 and not place.is_dir():
        part = place.with_name(place.name + ".part")
        shutil.rmtree(part, ignore_errors=True)
        for column, axis in enumerate(axes):
            own = {
                topic: Signal(signal.time, signal.values[:, column : column + 1], (AXIS,), signal.unit)
                for topic, signal in signals.items()
            }
            write_bag(part / axis, replace(record, signals=own, source=f"{record.source} {axis}"))
        part.rename(place)
    return {axis: str(place / axis) for axis in axes}
