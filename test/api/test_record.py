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
        (((RAMP, RAMP, 0), {}), "rate: must be > 0 Hz"),
        (((RAMP, RAMP, 1000), {"unit": "inch"}), "unit: 'inch' is not known"),
        (((RAMP, RAMP, 1000), {"axes": ["x", "y"]}), "axes: 2 names for 1 columns"),
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
    with pytest.raises(hc.InputError, match="has no column"):
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
