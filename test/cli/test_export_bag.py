"""`hyst export BAG --to …`: what other tools read back, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

from hyst_control.cli import main
from hyst_control.records.record import Record, Signal
from hyst_control.records.tables.importing import write_bag


@pytest.fixture
def bag(tmp_path):
    time = 1e-3 * np.arange(100)
    values = np.random.default_rng(0).standard_normal((100, 1))
    signals = {"command": Signal(time, values, ("x",), "V"), "measurement": Signal(time, 2 * values, ("x",), "um")}
    write_bag(tmp_path / "bag", Record(signals, "made"))
    return tmp_path / "bag"


def test_a_table(bag, tmp_path):
    assert main(["export", str(bag), "--to", "csv", "--output", str(tmp_path / "bag.csv")]) == 0
    found = np.genfromtxt(tmp_path / "bag.csv", delimiter=",", skip_header=1)
    assert found.shape == (100, 3)
    np.testing.assert_array_equal(found[:, 2], 2 * found[:, 1])


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--to", "csv", "--output", "{bag}/bag_0.mcap"], "lies within"),
        (["--to", "mcap", "--output", "{bag}"], "is read as well"),
        (["--to", "csv", "--output", "missing/bag.csv"], "folder does not exist"),
        (["--to", "csv", "--kind", "hampi", "--output", "out.csv"], "--kind: is of a model"),
    ],
)
def test_what_would_destroy_or_means_nothing_is_refused(bag, tmp_path, monkeypatch, capsys, words, said):
    monkeypatch.chdir(tmp_path)
    before = sorted(path.name for path in bag.iterdir())
    assert main(["export", str(bag), *(word.format(bag=bag) for word in words)]) == 2
    assert said in capsys.readouterr().err
    assert sorted(path.name for path in bag.iterdir()) == before and sorted(path.name for path in tmp_path.iterdir()) == ["bag"]
