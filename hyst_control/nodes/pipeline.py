"""The pipeline: the nodes of the loop composed in one process on one executor, which hand their messages to each other."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable

from hyst_control.errors import InputError
from hyst_control.nodes.base import SignalNode
from hyst_control.nodes.diagnosis import DiagnosisNode
from hyst_control.nodes.hampi_feedforward import HampiFeedforward
from hyst_control.nodes.mhl_feedforward import MhlFeedforward
from hyst_control.nodes.pi_feedback import PiFeedback
from hyst_control.nodes.recorder import Recorder
from hyst_control.nodes.reference_generator import ReferenceGenerator
from hyst_control.nodes.run import main as run_main
from hyst_plant_sim.node import PlantNode

NODES: dict[str, Callable[[], SignalNode]] = {
    "reference_generator": ReferenceGenerator,
    "hampi_feedforward": HampiFeedforward,
    "mhl_feedforward": MhlFeedforward,
    "pi_feedback": PiFeedback,
    "plant": PlantNode,
    "recorder": Recorder,
    "diagnosis": DiagnosisNode,
}
DEFAULT = ("reference_generator", "hampi_feedforward", "pi_feedback", "plant", "recorder")


def main() -> int:
    """The executable: names of nodes, then ROS arguments; parameters come per node from one `--params-file`."""
    arguments = sys.argv[1:]
    split = arguments.index("--ros-args") if "--ros-args" in arguments else len(arguments)
    parser = argparse.ArgumentParser(prog="pipeline", description=__doc__, epilog="Behind them: --ros-args --params-file FILE.yaml")
    parser.add_argument("nodes", nargs="*", metavar="NODE", help=f"of {', '.join(NODES)}; default: {' '.join(DEFAULT)}")
    chosen = parser.parse_args(arguments[:split]).nodes or DEFAULT
    try:
        for name in chosen:
            if name not in NODES:
                raise InputError(f"pipeline: {name!r} is not a node: {', '.join(NODES)}")
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    return run_main(*(NODES[name] for name in chosen), args=[sys.argv[0], *arguments[split:]])


if __name__ == "__main__":
    raise SystemExit(main())
