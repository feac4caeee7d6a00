# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The HAMPI paper's experiments at a reduced size, through the nodes; the full size is `hyst reproduce hampi`."""

import json

import left_over_nodes
import pytest

from evaluation.reproduction import hampi
from evaluation.reproduction.papers import HAMPI
from hyst_control.demo import node_runs
from hyst_control.processes.node_processes import Processes

pytestmark = pytest.mark.long_file

SMALL = hampi.Extent(
    frequencies=(100.0, 300.0),
    peaks=(50.0,),
    lags=(50.0, 500.0),
    tracked=(50.0, 150.0),
    excitation=(("quasi_static", 4.0), ("time", 0.03)),
    methods=("joint",),
    margins=False,
    second_truth=False,
)


class ThisProcess(Processes):
    """Composes the nodes of a run in this process: the record is the same to the last bit (test_lockstep), and nothing is to be started."""

    def __init__(self, folder, domain):
        super().__init__(folder, domain)
        self.given = {}

    def start(self, name, parameters):
        self.given[name] = parameters

    def wait(self, *names, timeout):
        import rclpy
        from rclpy.parameter import Parameter

        from hyst_control.nodes.execution.run import run
        from hyst_control.nodes.pipeline import node_class

        context = rclpy.Context()
        with left_over_nodes.destroyed():
            rclpy.init(context=context, domain_id=int(self._environment["ROS_DOMAIN_ID"]))
            try:
                nodes = [
                    node_class(name)(
                        context=context, parameter_overrides=[Parameter(key, value=value) for key, value in own.items()]
                    )
                    for name, own in self.given.items()
                ]
                assert run(nodes, context, timeout=timeout) == 0
            finally:
                rclpy.try_shutdown(context=context)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("hampi")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(node_runs, "Processes", ThisProcess)
        table = hampi.run(str(folder), extent=SMALL)
    table.write(folder / "hampi.json")
    return folder


@pytest.fixture(scope="module")
def rows(folder):
    return json.loads((folder / "hampi.json").read_text())["rows"]


def value(rows, case, subject, quantity="nrmse"):
    found = [
        row["value"]
        for row in rows
        if (row["case"], row["subject"], row["quantity"]) == (case, subject, quantity)
        and row["table"] in ("HAMPI Table 1", "HAMPI Fig. 11", "HAMPI Table 5", "HAMPI Fig. 8")
    ]
    assert len(found) == 1
    return found[0]


@pytest.mark.parametrize("frequency", [50.0, 150.0])
def test_hampi_tracks_within_the_published_error_and_hapi_does_worse(rows, frequency):
    ours = value(rows, f"{frequency:g} Hz", "HAMPI, joint")
    assert ours <= HAMPI.published["table_5"]["HAMPI"][frequency][1]
    assert ours < value(rows, f"{frequency:g} Hz", "HAPI, joint")


@pytest.mark.parametrize("frequency", [100.0, 300.0])
def test_hampi_predicts_held_out_loops_best(rows, frequency):
    case = f"50 V, {frequency:g} Hz"
    ours = value(rows, case, "HAMPI")
    assert ours <= 3.0 and ours < min(value(rows, case, "HAPI"), value(rows, case, "RDPI"))


def test_the_model_of_a_small_step_misses_lag_as_in_the_paper(rows):
    assert value(rows, "500 Hz", "LTI model", "phase lag") < value(rows, "500 Hz", "actuator", "phase lag")


def test_inverses_are_exact_where_their_names_say(rows):
    assert value(rows, "10 to 500 Hz", "zpetc", "largest phase error") < 1e-6
    assert value(rows, "10 to 500 Hz", "zmetc", "largest gain error") < 1e-6
    assert value(rows, "10 to 500 Hz", "npz_ignore", "largest phase error") > 0.1


def test_figures_are_one_page(folder):
    page = (folder / "hampi.html").read_text()
    assert all(f"HAMPI Fig. {number}" in page for number in (1, 2, 3, 6, 8, 11, 15))
