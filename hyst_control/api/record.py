# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Records for scripts and notebooks: read from files or arrays, cut, drawn, and handed to pandas and xarray."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from hyst_control.api.shown import Shown, drawn, needed, promoted, rows_of, step_of
from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.base.quantity import LISTS, TEXT, Quantity
from hyst_control.records import record as records
from hyst_control.records.bags.bag_reader import read_bag as read_signals
from hyst_control.records.editing import EditableRecord
from hyst_control.records.excitation.excitation import build
from hyst_control.records.tables.columns import Column, unit_and_scale
from hyst_control.records.tables.importing import described_columns, import_table, record_of_run, write_bag
from hyst_control.records.tables.selection import column_indices
from hyst_control.records.tables.units import unit_of
from hyst_control.reporting.frequency_figures import bode_of_record
from hyst_control.reporting.signal_figures import columns_of, over_each_other, over_time, spectra

if TYPE_CHECKING:
    from matplotlib.axes import Axes

AXES = Quantity("axes", None, "", "names of the axes", kind=LISTS[str])
HOLD = Quantity("hold", "zoh", "", "the command between samples", choices=("zoh", "foh"))
SOURCE = Quantity("source", None, "", "name of the record", kind=TEXT)
_OPTION = re.compile(r"(?<![\w.-])--([a-z]\w*(?:-[a-z]+)*)")
_KEYWORDS = {"resample": "resample=0.0", "allow-gaps": "allow_gaps=True"}
_WITH_UNIT = re.compile(r"(?P<name>.+?)\s*\[(?P<unit>[^\[\]]+)\]\s*")


@dataclass(frozen=True)
class Record(EditableRecord, Shown):
    r"""Signals of one run with their units: `command`, `measurement`, and whatever else was recorded.

    Parameters
    ----------
    signals
        Signals by name.
    source
        Where they come from.
    notes
        Sentences on what was met while reading.
    hold
        The command between samples: "zoh" (a DAC holds it) or "foh" (a smooth source was sampled).
    history
        Steps of its preparation, in their order.
    start
        State at the first row: "settled" (at rest at the first command), "unknown", or "auto" (found from the record).

    Examples
    --------
    >>> import numpy as np, hyst_control as hc
    >>> u = 50 + 40 * np.sin(2 * np.pi * 5 * np.arange(1000) / 1000)
    >>> record = hc.from_arrays(u, 0.1 * u, rate=1000)
    >>> print(record)
    arrays: 1 s at 1000 Hz
      command: 1000 samples of x in V, 10 to 90
      measurement: 1000 samples of x in um, 1 to 9
    >>> record.measurement.shape, record.axes, record.unit, record.sample_time
    ((1000, 1), ('x',), 'um', 0.001)
    >>> first, rest = record.split(0.7)
    >>> len(first), len(rest)
    (700, 300)
    >>> prepared = record.cut(0.1, 0.9).remove_outliers().detrend("constant").filter(low_pass=100).resample(500)
    >>> print(*prepared.history, sep="\n")
    cut to 0.1 s … 0.9 s
    0 outliers removed from measurement (beyond 8 standard deviations)
    constant trend removed from measurement
    filtered: low-pass 100 Hz, order 4 without phase
    resampled from 1000 to 500 Hz
    >>> [len(part) for part in record.merge(rest).aligned(allow_gaps=True)]     # gapless records
    [1000, 300]
    """

    def summary(self) -> str:
        """Length, rate and every signal's axes, unit and range."""
        rate = 1.0 / self.sample_time if set(records.TOPICS) <= set(self.signals) else np.nan
        lines = [f"{self.source}: {len(self) / rate:.6g} s at {rate:g} Hz" if rate == rate else self.source]
        lines += [
            f"  {name}: {len(signal.time)} samples of {', '.join(signal.axes)} in {signal.unit}, "
            f"{signal.values.min():.4g} to {signal.values.max():.4g}"
            for name, signal in self.signals.items()
        ]
        return "\n".join([*lines, *(f"  {step}" for step in self.history), *(f"  note: {note}" for note in self.notes)])

    def split(self, share: float) -> tuple[Record, Record]:
        """Cut the record in two, such as one to identify from and one to test on.

        Parameters
        ----------
        share
            Share of the samples that the first part gets, 0 to 1.

        Returns
        -------
        tuple of Record
            The two parts, with their own times.

        Raises
        ------
        InputError
            A part would be empty.
        """
        time = self.signal("measurement").time
        count = round(share * len(time)) if 0.0 < share < 1.0 else 0
        if not 0 < count < len(time):
            raise InputError(f"share: must leave samples on both sides, got {share!r} of {len(time)} samples")
        middle = 0.5 * float(time[count - 1] + time[count])
        return self.between(None, middle), self.between(middle, None)

    def plot(
        self, path: str | Path | None = None, *, kind: str = "time", others: Sequence[Record] = (), color: str | None = None
    ) -> list[Axes]:
        """Draw the record, alone or over others.

        Parameters
        ----------
        path
            File to write as well: .png, .svg, .pdf or .html.
        kind
            "time", "loops" (measurement over command) or "spectra".
        others
            Further records in the same drawing.
        color
            Of loops: by "record", "time" or "frequency"; None: by frequency, or of several records by record.

        Returns
        -------
        list of Axes
            The axes of matplotlib.
        """
        kinds = {
            "time": lambda: over_time(self, *others),
            "loops": lambda: over_each_other(self, *records.TOPICS, *others, color=color),
            "spectra": lambda: spectra(self, *others),
        }
        if kind not in kinds:
            raise InputError(f"kind: must be one of {', '.join(kinds)}, got {kind!r}")
        return drawn(kinds[kind](), self.source, path)

    def bode(self, path: str | Path | None = None) -> list[Axes]:
        """Draw the frequency response from command to measurement, with the coherence, and write it to a file where `path` is given."""
        return drawn(bode_of_record(self), self.source, path)

    def to_frame(self) -> Any:
        """The signals as a pandas DataFrame over time in s, a column an axis: "command [V]", or "command.x [V]" of several axes."""
        columns = [
            needed("pandas").Series(values, index=signal.time, name=f"{name} [{signal.unit}]")
            for topic, signal in self.signals.items()
            for name, values in columns_of(topic, signal)
        ]
        return needed("pandas").concat(columns, axis=1).rename_axis("time [s]")

    def to_xarray(self) -> Any:
        """The signals as an xarray Dataset over time and axis, with their units as attributes."""
        of = needed("xarray")
        arrays = {}
        for topic, signal in self.signals.items():
            places = {"time": signal.time, "axis": list(signal.axes)}
            arrays[topic] = of.DataArray(signal.values, places, tuple(places), attrs={"units": signal.unit})
        return of.Dataset(arrays, attrs={"source": self.source, **({"hold": self.hold} if self.states_hold else {})})

    def save(self, path: str | Path) -> None:
        """Write the record as a bag at `path`, which `read_bag` and the commands read."""
        write_bag(path, self)


def read_csv(
    path: str | Path,
    command: str | Sequence[str] | None = None,
    measurement: str | Sequence[str] | None = None,
    rate: float | None = None,
    *,
    time: str | None = None,
    rows: tuple[int, int | None] = (0, None),
    hold: str | None = None,
    resample: float | None = None,
    allow_gaps: bool = False,
) -> Record:
    r"""Read a record from a text table: CSV or white space, .gz too.

    Parameters
    ----------
    path
        The file.
    command, measurement
        Column and unit, such as "u [V]" or "pos [5um/V]" (a sensor of 5 um/V); several for several axes. A column is named as in the
        file's header, with its unit there or without, or numbered from 1. Without both, and without `time`, names and units in the
        file say what each column is ("time [s],command [V],position [um]").
    rate
        Sample rate, Hz; None where `time` is given.
    time
        Column of sample times with its unit, such as "t [s]".
    rows
        First row and one past the last.
    hold
        The command between samples: "zoh" (held by a DAC), "foh" (a smooth source was sampled), or None: found from the record.
    resample
        Rate, Hz, to interpolate irregular times and missing values at, 0.0 for their own; None: they are refused.
    allow_gaps
        Whether times may pass over rows.

    Returns
    -------
    Record
        Command in V, measurement in um or mrad.

    Raises
    ------
    InputError
        A column or unit is not known, or the file cannot be read.

    Examples
    --------
    >>> import hyst_control as hc
    >>> with open("ramp.csv", "w") as file:
    ...     _ = file.write("u [V],y [nm]\n" + "".join(f"{k % 9},{100 * (k % 9)}\n" for k in range(90)))
    >>> record = hc.read_csv("ramp.csv", command="u [V]", measurement="y [nm]", rate=5000)
    >>> print(record)
    ramp.csv: 0.018 s at 5000 Hz
      command: 90 samples of x in V, 0 to 8
      measurement: 90 samples of x in um, 0 to 0.8
    """
    given = {"command": command, "measurement": measurement, "time": time}
    return _imported(path, _column, given, rate, rows, hold, resample=resample, allow_gaps=allow_gaps)


def read_mat(
    path: str | Path,
    command: str | Sequence[str],
    measurement: str | Sequence[str],
    rate: float | None = None,
    *,
    time: str | None = None,
    rows: tuple[int, int | None] = (0, None),
    hold: str | None = None,
    variable: str | None = None,
    resample: float | None = None,
    allow_gaps: bool = False,
) -> Record:
    """Read a record from a MATLAB file, or from .npy and .npz.

    Parameters
    ----------
    path
        The file.
    command, measurement, rate, time, rows, hold, resample, allow_gaps
        As `read_csv` has them; a column is an array of the file, or one column of a matrix as "y(:,2) [um]".
    variable
        Array in which columns are numbered, where there are several.

    Returns
    -------
    Record
        Command in V, measurement in um or mrad.

    Raises
    ------
    InputError
        An array or unit is not known, or the file cannot be read.

    Examples
    --------
    >>> import numpy as np, scipy.io, hyst_control as hc
    >>> scipy.io.savemat("ramp.mat", {"u": np.arange(90.0), "y": 1e-7 * np.arange(90.0)})
    >>> record = hc.read_mat("ramp.mat", command="u [V]", measurement="y [m]", rate=5000)
    >>> record.signal("measurement").unit, round(float(record.signal("measurement").values[-1, 0]), 6)
    ('um', 8.9)
    """
    given = {"command": command, "measurement": measurement, "time": time}
    return _imported(path, _array, given, rate, rows, hold, variable, resample=resample, allow_gaps=allow_gaps)


def read_bag(path: str | Path, *, namespace: str | None = None, unit: str = "unknown") -> Record:
    """Read a record from a ROS 2 bag.

    Parameters
    ----------
    path
        rosbag2 directory, or a single .mcap or .db3 file.
    namespace
        Namespace of the topics, where the bag holds several plants.
    unit
        Unit of the measurement, um or mrad, in a bag whose messages have no layout.

    Returns
    -------
    Record
        Its signals.

    Raises
    ------
    InputError
        The bag cannot be read.

    Examples
    --------
    >>> import numpy as np, hyst_control as hc
    >>> hc.from_arrays(np.arange(90.0), np.arange(90.0), rate=1000).save("ramp_bag")
    >>> len(hc.read_bag("ramp_bag"))
    90
    """
    return promoted(Record, read_signals(path, namespace, unit))


def from_arrays(
    command: ArrayLike,
    measurement: ArrayLike,
    rate: float,
    *,
    command_unit: str = "V",
    unit: str = "um",
    axes: Sequence[str] | None = None,
    hold: str | None = None,
    source: str = "arrays",
) -> Record:
    """Make a record of arrays.

    Parameters
    ----------
    command, measurement
        Samples (N,) of one axis, or (N, A).
    rate
        Sample rate, Hz.
    command_unit, unit
        Units of command and measurement, such as "mV" and "nm".
    axes
        Names of the axes; x, y, … by default.
    hold
        The command between samples: "zoh" (held by a DAC), "foh" (a smooth source was sampled), or None: found from the record.
    source
        Name of the record.

    Returns
    -------
    Record
        Command in V, measurement in um or mrad.

    Raises
    ------
    InputError
        The arrays differ in shape, or a unit is not known.

    Examples
    --------
    >>> import numpy as np, hyst_control as hc
    >>> record = hc.from_arrays(np.arange(90.0), 1e3 * np.arange(90.0), rate=1000, unit="nm")
    >>> float(record.signal("measurement").values[-1, 0])
    89.0
    """
    step = step_of(rate)
    SOURCE.checked(source)
    HOLD.checked("zoh" if hold is None else hold)
    rows = [rows_of(name, values) for name, values in zip(records.TOPICS, (command, measurement), strict=True)]
    if rows[0].shape != rows[1].shape:
        raise InputError(f"measurement: has shape {rows[1].shape}, command {rows[0].shape}: give both of the same samples and axes")
    names = records.axis_names(rows[0].shape[1]) if axes is None else AXES.checked(axes)
    if len(names) != rows[0].shape[1]:
        raise InputError(f"axes: {len(names)} names for {rows[0].shape[1]} columns: give one for each")
    if not all(names) or len(set(names)) < len(names):
        raise InputError(f"axes: must be names that differ and are not empty, got {', '.join(map(repr, names))}: name each axis")
    units = []
    for index, given in enumerate((command_unit, unit)):
        found = unit_of(given) if isinstance(given, str) else None
        if found is None:
            raise InputError(f"unit: {given!r} is not known, must be one such as V, um, mrad, deg, A or counts")
        units.append(found[0])
        rows[index] = found[1] * rows[index]
    made = records.sampled_record(source, rows[0], rows[1], step, names, units[1], hold, command_unit=units[0])
    return promoted(Record, made)


def from_pandas(
    frame: Any,
    command: str | Sequence[str],
    measurement: str | Sequence[str],
    rate: float | None = None,
    *,
    resample: float | None = None,
    allow_gaps: bool = False,
) -> Record:
    """Make a record of a pandas DataFrame.

    Parameters
    ----------
    frame
        The frame, a row a sample.
    command, measurement
        Column and unit, such as "u [V]"; several for several axes.
    rate
        Sample rate, Hz; None: the index holds sample times, numbers in s or dates.
    resample
        Rate, Hz, to interpolate irregular times and missing values at, 0.0 for their own; None: they are refused.
    allow_gaps
        Whether times may pass over rows.

    Returns
    -------
    Record
        Command in V, measurement in um or mrad.

    Raises
    ------
    InputError
        A column or unit is not known, or the index tells no rate, as where rows are missing.

    Examples
    --------
    >>> import numpy as np, pandas as pd, hyst_control as hc
    >>> frame = pd.DataFrame({"u": np.arange(90.0), "y": np.arange(90.0)}, index=np.arange(90) / 1000)
    >>> record = hc.from_pandas(frame, command="u [V]", measurement="y [um]")
    >>> record.to_frame().columns.tolist()
    ['command [V]', 'measurement [um]']
    """
    if not isinstance(frame, needed("pandas").DataFrame):
        raise InputError(f"frame: must be a pandas DataFrame, got {type(frame).__name__}: take from_arrays for arrays")
    if rate is None and isinstance(frame.index, needed("pandas").RangeIndex):
        raise InputError("rate: is missing, and the frame's index counts its rows: give it in Hz, or make sample times the index")
    chosen = [_column(topic, given) for topic, given in zip(records.TOPICS, (command, measurement), strict=True)]
    columns = [str(name) for name in frame.columns]
    values = []
    for column in chosen:
        picked = [index for name in column.columns for index in column_indices("frame", name, columns)]
        values.append(column.scales[0] * rows_of(column.topic, frame.iloc[:, picked]))
    given = 1.0 if rate is None else rate  # till the times are known
    made = from_arrays(values[0], values[1], given, command_unit=chosen[0].unit, unit=chosen[1].unit, source="frame")
    return made if rate is not None else _at_times(made, frame.index, resample, allow_gaps)


def from_xarray(
    dataset: Any,
    *,
    command: str = "command",
    measurement: str = "measurement",
    resample: float | None = None,
    allow_gaps: bool = False,
) -> Record:
    """Make a record of an xarray Dataset with the coordinate `time`, in s or dates, and the attribute `units` of its arrays.

    Parameters
    ----------
    dataset
        Arrays over time, or over time and axis, as `Record.to_xarray` makes them.
    command, measurement
        Names of the arrays.
    resample
        Rate, Hz, to interpolate irregular times and missing values at, 0.0 for their own; None: they are refused.
    allow_gaps
        Whether times may pass over rows.

    Returns
    -------
    Record
        Command in V, measurement in um or mrad.

    Raises
    ------
    InputError
        An array, its unit or the time is missing, or rows are.

    Examples
    --------
    >>> import numpy as np, xarray, hyst_control as hc
    >>> record = hc.from_arrays(np.arange(90.0), np.arange(90.0), rate=1000)
    >>> again = hc.from_xarray(record.to_xarray())
    >>> bool((again.signal("command").values == record.signal("command").values).all())
    True
    """
    for name in (command, measurement):
        if name not in dataset or "units" not in dataset[name].attrs:
            raise InputError(
                f"{name}: has no array of this name with the attribute units: name one of {', '.join(map(str, dataset))}"
            )
    if "time" not in dataset.coords:
        raise InputError("time: is no coordinate of the dataset: add the sample times, in s or as dates")
    driven, measured = (dataset[name].transpose("time", ...) for name in (command, measurement))
    made = from_arrays(
        driven.values,
        measured.values,
        1.0,
        command_unit=str(driven.attrs["units"]),
        unit=str(measured.attrs["units"]),
        axes=[str(name) for name in driven["axis"].values] if "axis" in driven.coords else None,
        hold=dataset.attrs.get("hold"),
        source="dataset",
    )
    return _at_times(made, dataset["time"], resample, allow_gaps)


def excitation(signal: str, rate: float, *, axes: int = 1, **parameters: Any) -> Array:
    """Make a command to excite a stage with, as `hyst excite` does.

    Parameters
    ----------
    signal
        Kind, such as "diagnostic", "triangle", "multisine" or "sweep" (`hyst excite --help` lists them).
    rate
        Sample rate, Hz.
    axes
        Number of axes A.
    **parameters
        The kind's parameters.

    Returns
    -------
    ndarray
        Command (N, A), V.

    Raises
    ------
    InputError
        The kind or a parameter is not known.

    Examples
    --------
    >>> import hyst_control as hc
    >>> hc.excitation("sine", rate=1000, frequency=10, amplitude=40, offset=50, duration=1).shape
    (1000, 1)
    """
    return build({"signal": signal, **parameters}, step_of(rate), axes)


def _at_times(made: Record, times: Any, resample: float | None, allow_gaps: bool) -> Record:
    """A record whose rows are at these sample times, which come onto the ticks of one clock as those of a file do."""
    given = (times if getattr(times, "tz", None) is None else times.tz_convert(None)).values
    if given.dtype.kind in "mM":
        given = (given - given[:1]) / np.timedelta64(1, "s")
    time = np.ascontiguousarray(rows_of(f"{made.source}: time", given)[:, 0])
    records.check_times(f"{made.source}: time", time)
    if len(time) < 2 or not records.increasing(time, equal=True):
        raise InputError(f"{made.source}: time: must be sample times that increase, in s or dates: sort the rows, or give the rate")
    units = {topic: signal.unit for topic, signal in made.signals.items()}
    hold = made.hold if made.states_hold else None
    with keywords():
        found = record_of_run(made.source, time, made.values, units, hold, resample=resample, allow_gaps=allow_gaps)
    signals = {topic: replace(signal, axes=made.axes) for topic, signal in found.signals.items()}
    return replace(made, signals=signals, notes=found.notes)


def _imported(
    path: str | Path,
    column: Callable[[str, str | Sequence[str]], Column],
    named: Mapping[str, str | Sequence[str] | None],
    *how: Any,
    **more: Any,
) -> Record:
    """The record of a file; a column of times that is not named is left out, and where none is named the file's names are taken."""
    columns = [column(topic, given) for topic, given in named.items() if given is not None]
    with keywords():
        columns = columns or described_columns(Path(path), how[0], 'name them, as in command="2 [V]", measurement="3 [um]"')
        return promoted(Record, import_table(path, columns, *how, **more))


@contextmanager
def keywords() -> Iterator[None]:
    """Refusals within that name keywords in place of the options of commands."""
    try:
        yield
    except InputError as error:
        words = _OPTION.sub(lambda option: _KEYWORDS.get(option[1], f"{option[1].replace('-', '_')}="), str(error))
        raise type(error)(words) from None


def _column(topic: str, given: str | Sequence[str]) -> Column:
    """Columns of a topic from texts such as "u [V]"; a number is passed on without its unit."""
    texts = [given] if isinstance(given, str) else list(given)
    found = [_WITH_UNIT.fullmatch(text) for text in texts]
    units = {match["unit"] for match in found if match}
    if None in found or len(units) != 1:
        raise InputError(f'{topic}: must be a column with its unit, such as "u [V]", several in one unit, got {given!r}')
    names = [match["name"] if match["name"].isdecimal() else text for match, text in zip(found, texts, strict=True) if match]
    unit, scale = unit_and_scale(topic, units.pop())
    return Column(topic, tuple(names), unit, (scale,) * len(names))


def _array(topic: str, given: str | Sequence[str]) -> Column:
    """The same of the arrays of a file, whose names have no units."""
    column = _column(topic, given)
    return replace(
        column, columns=tuple(match["name"] if (match := _WITH_UNIT.fullmatch(name)) else name for name in column.columns)
    )


def records_of(name: str, given: Record | Sequence[Record]) -> list[Record]:
    """Records that are given as one or as several."""
    several: list[Any] = list(given) if isinstance(given, (list, tuple, Iterator)) else [given]
    for each in several:
        if not isinstance(each, records.Record):
            raise InputError(
                f"{name}: {type(each).__name__} is no Record: make one by hc.read_csv, hc.read_bag, hc.from_arrays or hc.from_pandas"
            )
    return several


def record_of(name: str, given: Record) -> Record:
    """The record that is given; refuses several, and anything else."""
    record, *others = records_of(name, given)
    if others:
        raise InputError(f"{name}: {1 + len(others)} records: take them one by one")
    return record
