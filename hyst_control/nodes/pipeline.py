"""Pipeline: the nodes of the loop composed in one process on one executor, which hand messages directly to each other."""

from __future__ import annotations

import argparse
import importlib
import sys
from collections.abc import Callable

from hyst_control.nodes.execution.command_line import help_text
from hyst_control.nodes.execution.run import main as run_main
from hyst_control.nodes.signal_node.base import SignalNode
from hyst_control.processes.node_list import NODES

COMPOSABLE = tuple(name for name, node in NODES.items() if node.node_class)
DEFAULT = ("reference_generator", "hampi_feedforward", "pi_feedback", "plant", "recorder")


def node_class(name: str) -> Callable[..., SignalNode]:
    """Import the class of a node that can be composed."""
    entry = NODES[name]
    found: Callable[..., SignalNode] = getattr(importlib.import_module(entry.module), entry.node_class)
    return found


def main() -> int:
    """Run the executable, whose arguments are names of nodes, then ROS arguments; its exit status."""
    arguments = sys.argv[1:]
    split = arguments.index("--ros-args") if "--ros-args" in arguments else len(arguments)
    parser = argparse.ArgumentParser(
        prog="pipeline",
        add_help=False,
        description=__doc__,
        epilog="ROS arguments follow the nodes: --ros-args --params-file FILE.yaml",
    )
    parser.add_argument("nodes", nargs="*", metavar="NODE", help=f"any of {', '.join(COMPOSABLE)}; default: {' '.join(DEFAULT)}")
    parser.add_argument("-h", "--help", action="store_true", help="show this, and the parameters of the nodes")
    given = parser.parse_args(arguments[:split])
    chosen = given.nodes or DEFAULT
    for name in chosen:
        if name not in COMPOSABLE:
            print(f"pipeline: {name!r} is not a node that can be composed: use {', '.join(COMPOSABLE)}", file=sys.stderr)
            return 2
    if given.help:
        print(parser.format_help())
        print(help_text("pipeline", [node_class(name) for name in chosen]))
        return 0
    return run_main(*(node_class(name) for name in chosen), args=[sys.argv[0], *arguments[split:]])


if __name__ == "__main__":
    raise SystemExit(main())
