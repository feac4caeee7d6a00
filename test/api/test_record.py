# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Records of the front door: cut without losing a sample, in and out of arrays, tables and frames, and shown."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib import pyplot

import hyst_control as hc

RAMP = np.arange(200.0)


@settings(deadline=None)
@given(share=st.floats(0.01, 0.99), rate=st.sampled_from([1.0, 977.0, 5e4]))
def test_a_cut_loses_no_sample(share, rate):
    record = hc.from_arrays(RAMP, 2 * RAMP, rate)
    first, rest = record.split(share)
    for name in ("command", "measurement"):
        together = np.concatenate([first.signal(name).values, rest.signal(name).values])
        np.testing.assert_array_equal(together, record.signal(name).values)
    assert isinstance(first, hc.Record) and len(first) == round(share * len(RAMP))


@pytest.mark.parametrize("share", [0.0, 1.0, -1.0, float("nan"), 1e-9])
def test_a_cut_that_leaves_nothing_is_refused(share):
    with pytest.raises(hc.InputError, match="share: must leave samples on both sides"):
        hc.from_arrays(RAMP, RAMP, 1000).split(share)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (((RAMP, RAMP[:-1], 1000), {}), "measurement: has shape"),
        *((((RAMP, RAMP, rate), {}), "rate: must be a (finite )?number > 0 Hz") for rate in (0, np.inf, "1000", None)),
        *((((RAMP, RAMP, 1000), {"unit": unit}), f"unit: {unit!r} is not known") for unit in ("inch", 5)),
        (((RAMP, RAMP, 1000), {"axes": ["x", "y"]}), "axes: 2 names for 1 columns"),
        (((RAMP, RAMP, 1000), {"axes": [""]}), "axes: must be names that differ and are not empty"),
        (((RAMP, RAMP, 1000), {"axes": [1]}), "axes: must be a list of texts"),
        (((np.c_[RAMP, RAMP], np.c_[RAMP, RAMP], 1000), {"axes": ["a", "a"]}), "axes: must be names that differ"),
        (((RAMP, RAMP, 1000), {"hold": "x"}), "hold: must be one of zoh, foh"),
        (((RAMP, RAMP, 1000), {"source": 5}), "source: must be a text"),
        (((RAMP + 1j, RAMP, 1000), {}), "command: must be real numbers"),
        (((list(RAMP + 1j), RAMP, 1000), {}), "command: must be real numbers"),
        ((("text", RAMP, 1000), {}), "command: must be numbers"),
        (((np.zeros((2, 2, 2)), RAMP, 1000), {}), "command: must be samples"),
    ],
)
def test_arrays_that_do_not_fit_are_refused(arguments, words):
    with pytest.raises(hc.InputError, match=words):
        hc.from_arrays(*arguments[0], **arguments[1])


def table(path, header, rows=50):
    columns = np.column_stack([np.arange(rows) / 500, np.arange(rows), 10.0 * np.arange(rows), 20.0 * np.arange(rows)])
    np.savetxt(path, columns, delimiter=",", header=header, comments="")


@pytest.mark.parametrize("header", ["t,u,a,b", "t [s],u [V],a [nm],b [nm]", "t (s),u (V),a (nm),b (nm)"])
def test_columns_are_named_with_their_unit_or_without(tmp_path, header):
    table(tmp_path / "lab.csv", header)
    record = hc.read_csv(tmp_path / "lab.csv", "u [V]", ["a [nm]", "b [nm]"], time="t [s]")
    assert record.signal("measurement").axes == ("x", "y") and record.common_step(("command",)) == pytest.approx(1 / 500)
    np.testing.assert_allclose(record.signal("measurement").values[-1], [0.49, 0.98])
    by_number = hc.read_csv(tmp_path / "lab.csv", "2 [V]", "3 [nm]", rate=500)
    np.testing.assert_array_equal(by_number.signal("measurement").values[:, 0], record.signal("measurement").values[:, 0])


def test_the_unit_tells_columns_of_one_name_apart(tmp_path):
    table(tmp_path / "lab.csv", "t,u,y [um],y [V]")
    record = hc.read_csv(tmp_path / "lab.csv", "u [V]", "y [um]", rate=500)
    assert record.signal("measurement").values[-1, 0] == 490.0
    with pytest.raises(hc.InputError, match="names several columns: choose one by its number: 3, 4"):
        hc.read_csv(tmp_path / "lab.csv", "u [V]", "y [nm]", rate=500)


@pytest.mark.parametrize("given", ["u", "u []", ["u [V]", "y [mV]"], []])
def test_a_column_without_a_unit_is_refused(tmp_path, given):
    table(tmp_path / "lab.csv", "t,u,a,b")
    with pytest.raises(hc.InputError, match="command: must be a column with its unit"):
        hc.read_csv(tmp_path / "lab.csv", given, "a [um]", rate=500)


def test_a_record_is_drawn_and_shown(tmp_path):
    pyplot.switch_backend("Agg")
    wave = 50 + 40 * np.sin(np.arange(2000) * np.arange(2000) / 4000)
    record = hc.from_arrays(np.column_stack([wave, wave[::-1]]), np.column_stack([wave, wave[::-1]]), 1000, unit="mrad")
    assert [len(record.plot(kind=kind)) for kind in ("time", "loops", "spectra")] == [2, 2, 2]
    assert len(record.bode(tmp_path / "bode.png")) == 3 and (tmp_path / "bode.png").stat().st_size > 10_000
    assert "2 s at 1000 Hz" in record._repr_html_() and "x, y in mrad" in str(record)
    with pytest.raises(hc.InputError, match="kind: must be one of time"):
        record.plot(kind="waterfall")
    pyplot.close("all")


def test_a_frame_goes_in_and_comes_out():
    pandas = pytest.importorskip("pandas")
    frame = pandas.DataFrame({"u [mV]": 1e3 * RAMP, "a": RAMP, "b": RAMP}, index=RAMP / 250)
    record = hc.from_pandas(frame, "u [mV]", "a [0.5um/V]")
    np.testing.assert_allclose(record.signal("command").values[:, 0], RAMP)
    np.testing.assert_allclose(record.signal("measurement").values[:, 0], 0.5 * RAMP)
    assert record.to_frame().index[-1] == pytest.approx(199 / 250)
    with pytest.raises(hc.InputError, match="increase"):
        hc.from_pandas(frame.iloc[::-1], "u [mV]", "a [um]")
    with pytest.raises(hc.InputError, match="rate: is missing"):
        hc.from_pandas(frame.reset_index(drop=True), "u [mV]", "a [um]")
    with pytest.raises(hc.InputError, match="frame: must be a pandas DataFrame, got int"):
        hc.from_pandas(5, "u [mV]", "a [um]")
    with pytest.raises(hc.InputError, match="command: must be real numbers"):
        hc.from_pandas(frame + 1j, "u [mV]", "a [um]")


def test_missing_numbers_are_refused_or_filled_by_keyword(tmp_path):
    pandas = pytest.importorskip("pandas")
    frame = pandas.DataFrame({"u": RAMP, "y": 2 * RAMP}, index=pandas.Index(RAMP / 250, name="t")).drop(index=[40 / 250])
    with pytest.raises(
        hc.InputError, match=r"1 row is missing, after .*: resample=0.0 interpolates them, allow_gaps=True leaves them"
    ):
        hc.from_pandas(frame, "u [V]", "y [um]")
    assert not hc.from_pandas(frame, "u [V]", "y [um]", allow_gaps=True).is_gapless
    frame.loc[50 / 250, "y"] = np.nan
    frame.to_csv(tmp_path / "run.csv")
    with pytest.raises(hc.InputError, match="row 49 holds no finite number: resample=0.0 interpolates such rows"):
        hc.read_csv(tmp_path / "run.csv", "u [V]", "y [um]", time="t [s]")
    filled = (
        hc.from_pandas(frame, "u [V]", "y [um]", resample=0.0),
        hc.read_csv(tmp_path / "run.csv", "u [V]", "y [um]", time="t [s]", hold="zoh", resample=0.0),
    )
    for record in filled:
        np.testing.assert_allclose(record.signal("measurement").values[:, 0], 2 * RAMP, atol=1e-9)
        np.testing.assert_allclose(record.signal("command").values[50, 0], RAMP[50], atol=1e-9)
    frame.iloc[60:80, 1] = np.nan
    with pytest.raises(hc.InputError, match="measurement: a gap of 0.084 s is too long to interpolate"):
        hc.from_pandas(frame, "u [V]", "y [um]", resample=0.0)


MICROSECONDS = (5000 * RAMP).astype("timedelta64[us]")  # 200 Hz


def read_at(times, rows=slice(None)):
    """A ramp of some rows at these times, out of a frame and out of a dataset."""
    pandas, _ = pytest.importorskip("pandas"), pytest.importorskip("xarray")
    frame = pandas.DataFrame({"u": RAMP[rows], "y": RAMP[rows]}, index=times)
    dataset = hc.from_arrays(RAMP[rows], RAMP[rows], 1).to_xarray().assign_coords(time=np.asarray(times))
    return (lambda: hc.from_pandas(frame, "u [V]", "y [um]")), (lambda: hc.from_xarray(dataset))


@pytest.mark.parametrize("unit", ["ms", "us", "ns"])
@pytest.mark.parametrize("begin", [np.timedelta64(0, "s"), np.datetime64("2026-01-01T00:00:00")])
def test_dates_and_durations_of_any_unit_are_times(unit, begin):
    kind = "datetime64" if begin.dtype.kind == "M" else "timedelta64"
    for read in read_at((begin + MICROSECONDS).astype(f"{kind}[{unit}]")):
        assert read().sample_time == pytest.approx(1 / 200) and read().is_gapless and not read().notes


def test_dates_of_a_time_zone_are_times(recwarn):
    pandas = pytest.importorskip("pandas")
    index = pandas.DatetimeIndex(np.datetime64("2026-03-29T00:59:59") + MICROSECONDS).tz_localize("UTC").tz_convert("Europe/Berlin")
    record = hc.from_pandas(pandas.DataFrame({"u": RAMP, "y": RAMP}, index=index), "u [V]", "y [um]")
    assert record.sample_time == pytest.approx(1 / 200) and not recwarn


def test_times_of_frames_and_datasets_come_onto_one_clock_as_those_of_files_do(tmp_path):
    jittered = RAMP / 200 + np.random.default_rng(0).uniform(-2e-4, 2e-4, len(RAMP))
    np.savetxt(tmp_path / "jittered.csv", np.c_[jittered, RAMP, RAMP], delimiter=",", header="t,u,y", comments="")
    due = hc.read_csv(tmp_path / "jittered.csv", "u [V]", "y [um]", time="t [s]")
    for read in read_at(jittered):
        found = read()
        assert found.sample_time == due.sample_time == pytest.approx(1 / 200, rel=1e-9)
        assert [note.partition(": ")[2] for note in found.notes] == [note.partition(": ")[2] for note in due.notes] != []
    kept = np.r_[0:50, 70:200]
    for times in (RAMP / 200, MICROSECONDS):
        for read in read_at(times[kept], kept):
            with pytest.raises(hc.InputError, match="time: 20 rows are missing, after 0.245 s"):
                read()
    for times, words in ((["a", *"b" * 199], "time: must be numbers"), (1e9 * RAMP, "no clock goes beyond")):
        with pytest.raises(hc.InputError, match=words):
            read_at(times)[0]()


@pytest.mark.parametrize(
    ("edit", "words"),
    [
        (lambda record: record.shifted(np.nan), "--shift nan: is no time"),
        (
            lambda record: record.with_values(measurement=np.zeros((5, 1))),
            r"measurement: has shape \(5, 1\), the record \(200, 1\)",
        ),
        (lambda record: record.filter(low_pass=10, order=0), "order: must be an integer >= 1, got 0"),
    ],
)
def test_edits_that_make_no_record_are_refused(edit, words):
    with pytest.raises(hc.InputError, match=words):
        edit(hc.from_arrays(RAMP, RAMP, 1000))


def test_an_xarray_goes_in_and_comes_out():
    pytest.importorskip("xarray")
    record = hc.from_arrays(
        np.column_stack([RAMP, -RAMP]), np.column_stack([RAMP, RAMP]), 250, unit="mrad", axes=["tip", "tilt"], hold="foh"
    )
    again = hc.from_xarray(record.to_xarray())
    assert (
        again.signal("measurement").axes == ("tip", "tilt") and again.hold == "foh" and again.signal("measurement").unit == "mrad"
    )
    np.testing.assert_array_equal(again.signal("command").values, record.signal("command").values)
    with pytest.raises(hc.InputError, match="no array of this name"):
        hc.from_xarray(record.to_xarray(), measurement="position")
