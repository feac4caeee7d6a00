"""Parts of the diagnosis against closed forms: shrink, scattered coefficients, replay."""

from __future__ import annotations

import numpy as np
import pytest

from hyst_control.base.config_files import config_path
from hyst_control.diagnose.problem.coefficient_prior import scatter_of
from hyst_control.diagnose.report.block_replay import replay
from hyst_control.diagnose.validate.cross_validation import shrink
from hyst_control.model_file import load_model
from hyst_control.records.record import Record, Signal


@pytest.mark.parametrize("before, after, due", [(5.0, 2.0, 0.75), (5.0, 1.0, 1.0), (5.0, 5.0, 0.0), (3.0, 4.0, -0.5)])
def test_shrink_counts_toward_the_floor(before, after, due):
    """Squared errors in units of the floor's variance: 1 - (after - 1) / (before - 1)."""
    value, (low, high) = shrink(np.full(400, before), np.full(400, after), seed=0)
    assert value == pytest.approx(due, abs=1e-12)
    assert low == pytest.approx(due, abs=1e-9) and high == pytest.approx(due, abs=1e-9)


def test_shrinks_interval_covers_the_truth_nine_times_in_ten():
    """Independent squared errors of known means, so that the true shrink is known."""
    random = np.random.default_rng(4)
    covered = 0
    for _ in range(150):
        noise = random.standard_normal((2, 2000))
        _, (low, high) = shrink(9.0 * noise[0] ** 2, 3.0 * noise[1] ** 2, seed=1)
        covered += low <= 0.75 <= high
    assert 0.80 <= covered / 150 <= 0.97


def test_scatter_multiplies_every_coefficient_by_its_tolerance():
    model = load_model(config_path("models/pea_hampi.yaml"))
    scatter = scatter_of(model)
    assert scatter.at(np.zeros(len(scatter.coefficients))) == scatter.model.chain.stages
    for k, coefficient in enumerate(scatter.coefficients):
        z = np.zeros(len(scatter.coefficients))
        z[k] = 2.0
        (index,) = coefficient.path
        before = np.array(getattr(model.chain.stages[index], coefficient.field), dtype=float)
        after = np.array(getattr(scatter.at(z)[index], coefficient.field), dtype=float)
        assert after[coefficient.index] == pytest.approx(before[coefficient.index] * (1 + 2.0 * coefficient.tolerance), rel=1e-12)
        assert np.count_nonzero(after != before) == 1


def test_scattered_madelung_branches_still_meet_at_their_end():
    scatter = scatter_of(load_model(config_path("models/fsm_mhl.yaml")))
    stages = scatter.at(np.random.default_rng(2).standard_normal(len(scatter.coefficients)))
    found = [
        member for stage in stages for branch in getattr(stage, "branches", ()) for member in branch if member.name == "madelung"
    ]
    assert found
    for madelung in found:
        up, down = np.array(madelung.ascending), np.array(madelung.descending)
        np.testing.assert_allclose(up.sum(axis=-1), down.sum(axis=-1), rtol=1e-12)


def looped(fault: float, law_fault: float = 0.0) -> Record:
    """A PI loop written out sample by sample; fault is added to the sum, law_fault to the feedback, on every tenth sample."""
    step, count = 1e-3, 400
    reference = 1.0 + np.sin(2 * np.pi * 5.0 * np.arange(count) * step)
    output = integral = 0.0
    rows = []
    for k, wanted in enumerate(reference):
        error = wanted - output
        integral += 40.0 * step * error
        feedback = 0.5 * error + integral + (law_fault * np.sin(0.3 * k) if k % 10 else 0.0)
        command = 2.0 * wanted + feedback + fault * np.cos(0.7 * k)
        rows.append((2.0 * wanted, feedback, command, output))
        output += 0.05 * (0.3 * command - output)
    columns = np.array(rows).T
    time = np.arange(count) * step
    signals = dict(zip(("feedforward", "feedback", "command", "measurement"), columns, strict=True)) | {"reference": reference}
    return Record(
        {
            name: Signal(time, values[:, None], ("x",), "um" if name in ("reference", "measurement") else "V")
            for name, values in signals.items()
        },
        "loop",
    )


def test_replay_finds_a_sound_loop_faithful():
    assert all(block.faithful for block in replay(looped(0.0)))


def test_replay_finds_the_block_at_fault():
    faults = {block.name for block in replay(looped(0.2)) if not block.faithful}
    assert faults == {"command sum"}
    faults = {block.name for block in replay(looped(0.0, 0.2)) if not block.faithful}
    assert faults == {"feedback"}
