# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Units: a model is in those of its records, whatever they are, and tells its parameters in them."""

import json

import numpy as np
import pytest

from hyst_control.base.errors import InputError
from hyst_control.cli import main
from hyst_control.model_file import load_model
from hyst_control.records.tables.units import scaled_unit, unit_of


@pytest.mark.parametrize(
    "text, due",
    [
        ("nm", ("um", 1e-3)), ("µm", ("um", 1.0)), ("cm", ("um", 1e4)), ("urad", ("mrad", 1e-3)), ("kV", ("V", 1e3)), ("volts", ("V", 1.0)),
        ("microns", ("um", 1.0)), ("deg", ("deg", 1.0)), ("°", ("deg", 1.0)), ("arcsec", ("arcsec", 1.0)), ("mA", ("mA", 1.0)),
        ("m/s^2", ("m/s^2", 1.0)), ("m/s²", ("m/s²", 1.0)), ("N*m", ("N*m", 1.0)), ("counts", ("counts", 1.0)), ("%", ("%", 1.0)),
        ("furlong", None), ("", None), ("vm", None), ("m/x", None),
    ],
)  # fmt: skip
def test_units(text, due):
    assert unit_of(text) == (due if due is None else (due[0], pytest.approx(due[1])))


def test_a_number_before_a_unit_is_a_sensitivity_of_what_a_sensor_gives():
    assert scaled_unit("5um/V") == ("um", 5.0) and scaled_unit("-2.5e3 nm / mV") == ("um", pytest.approx(-2.5))
    assert scaled_unit("9.81 m/s^2") == ("m/s^2", 9.81) and scaled_unit("0.1 %/counts") == ("%", 0.1)


@pytest.fixture
def pairs(tmp_path):
    command = np.concatenate([np.linspace(a, b, 40) for a, b in ((0, 2), (2, 0.2), (0.2, 1.6), (1.6, 0.4))])
    played = np.zeros(len(command))
    state = 0.0
    for k, value in enumerate(command):
        state = np.clip(state, value - 0.2, value + 0.2)
        played[k] = 3.0 * value + 1.0 * state
    np.savetxt(tmp_path / "a.csv", np.column_stack([command, played]), "%.9g", ",", header="u,y", comments="")
    return tmp_path


def test_a_model_keeps_the_units_of_its_record(pairs, capsys):
    columns = ["--columns", "command=u[A],measurement=y[arcsec]", "--rate", "1"]
    assert main(["import", str(pairs / "a.csv"), *columns, "--output", str(pairs / "bag")]) == 0
    model, fit = pairs / "m.yaml", pairs / "fit.json"
    assert main(["identify", str(pairs / "bag"), "--model", "pi", "--output", str(model), "--json", str(fit)]) == 0
    assert load_model(model).units == {"command": "A", "measurement": "arcsec"}
    units = {row["unit"] for row in json.loads(fit.read_text())["parameters"]}
    assert "arcsec/A" in units and not any("V" in unit for unit in units)
    assert main(["validate", str(model), str(pairs / "bag")]) == 0
    volts = ["--columns", "command=u[V],measurement=y[arcsec]", "--rate", "1"]
    assert main(["import", str(pairs / "a.csv"), *volts, "--output", str(pairs / "volts")]) == 0
    assert main(["validate", str(model), str(pairs / "volts")]) == 2
    assert "m: is in arcsec of A, the record volts in arcsec of V" in capsys.readouterr().err


@pytest.mark.parametrize(
    "columns, remedy",
    [
        ("command=u[V],measurement=y+u[um]", "name the command once for each of them"),
        ("command=u+y[V],measurement=y[um]", "import one command at a time, of a record in which the others rest"),
    ],
)
def test_other_axes_of_command_and_measurement_say_what_to_do(pairs, columns, remedy, capsys):
    assert main(["import", str(pairs / "a.csv"), "--columns", columns, "--rate", "1", "--output", str(pairs / "bag")]) == 0
    assert remedy in capsys.readouterr().out
    assert main(["identify", str(pairs / "bag"), "--model", "pi", "--output", str(pairs / "m.yaml")]) == 2
    assert remedy in capsys.readouterr().err


def test_a_model_in_a_unit_that_no_record_has_is_refused(pairs):
    from hyst_control.model_file import model_from_document

    document = {"format": "hyst_control/model", "version": 1, "name": "m", "axes": ["x"], "sample_time": 1.0}
    document |= {"chain": [{"stage": "gain", "gain": 1.0}]}
    for unit in ("nm", "um]", "nonsense", "um,x"):
        with pytest.raises(InputError, match="um or mrad is due, or another unit that hyst import keeps"):
            model_from_document({**document, "units": {"command": "V", "measurement": unit}})
