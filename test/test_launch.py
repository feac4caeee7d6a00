"""Launch files: their nodes exist, their arguments reach the nodes, and the parameters they set are declared. Without `launch`.

Stand-ins for the few classes of `launch` and `launch_ros` that the files use record what they are given.
"""

from __future__ import annotations

import runpy
import sys
from collections.abc import Mapping
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest

from hyst_control.nodes.pipeline import node_class
from hyst_control.nodes.signal_node.common_parameters import COMMON

ROOT = Path(__file__).resolve().parents[1]
FILES = sorted((ROOT / "launch").glob("*.launch.py"))


class Recorded(SimpleNamespace):
    """Whatever it is given, as attributes; `given` are the positional arguments."""

    def __init__(self, *given: object, **named: object) -> None:
        super().__init__(given=given, **named)


class LaunchConfiguration(Recorded):
    def perform(self, context: Mapping[str, str]) -> str:
        return context[str(self.given[0])]


@pytest.fixture
def described(monkeypatch):
    """Description of a launch file by its name."""
    names = {
        "launch": {"LaunchDescription": Recorded},
        "launch.actions": {
            name: type(name, (Recorded,), {}) for name in ("DeclareLaunchArgument", "OpaqueFunction", "IncludeLaunchDescription")
        },
        "launch.substitutions": {"LaunchConfiguration": LaunchConfiguration},
        "launch.launch_description_sources": {"PythonLaunchDescriptionSource": Recorded},
        "launch_ros": {},
        "launch_ros.actions": {"Node": Recorded},
        "ament_index_python": {},
        "ament_index_python.packages": {"get_package_share_directory": lambda name: str(ROOT)},
    }
    for name, content in names.items():
        module = ModuleType(name)
        vars(module).update(content)
        monkeypatch.setitem(sys.modules, name, module)

    def describe(file: Path) -> Recorded:
        return runpy.run_path(str(file))["generate_launch_description"]()

    return describe


def started(description: Recorded, **changes: str) -> list[Recorded]:
    """Nodes that a description starts with its arguments' defaults and these changes."""
    [parts] = description.given
    context = {each.given[0]: each.default_value for each in parts if type(each).__name__ == "DeclareLaunchArgument"}
    assert set(changes) <= set(context)
    return [node for each in parts if type(each).__name__ == "OpaqueFunction" for node in each.function({**context, **changes})]


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.name)
def test_every_argument_has_a_default_and_a_description(described, file):
    [parts] = described(file).given
    declared = [each for each in parts if type(each).__name__ == "DeclareLaunchArgument"]
    assert {"params", "model", "namespace"} <= {each.given[0].removeprefix("left_") for each in declared}
    for each in declared:
        assert each.description and isinstance(each.default_value, str)
        assert not each.given[0].endswith("params") or Path(each.default_value).is_file()


@pytest.mark.parametrize("name, stage", [("simulation", "plant"), ("hardware", "simulated_stage")])
def test_loop_has_its_nodes_in_the_namespace_with_parameters_that_they_declare(described, name, stage):
    description = described(ROOT / "launch" / f"{name}.launch.py")
    nodes = started(description, namespace="left", model="m.yaml", bag="run")
    assert {node.executable for node in nodes} == {"reference_generator", "hampi_feedforward", "pi_feedback", stage, "recorder"}
    for node in nodes:
        assert node.namespace == "left" and node.package == "hyst_control" and node.name == node.executable
        file, changed = node.parameters
        assert Path(file).is_file()
        known = {setting.name for setting in (*COMMON, *getattr(node_class(node.executable), "SETTINGS", ()))}
        assert set(changed) <= known | {"model"}
    assert next(node for node in nodes if node.executable == stage).parameters[1]["model"] == "m.yaml"
    assert "recorder" not in {node.executable for node in started(description)}


def test_two_stages_pass_each_its_own_arguments(described):
    [parts] = described(ROOT / "launch" / "two_stages.launch.py").given
    own = described(ROOT / "launch" / "hardware.launch.py")
    known = {each.given[0] for each in own.given[0] if type(each).__name__ == "DeclareLaunchArgument"}
    declared = {each.given[0]: each.default_value for each in parts if type(each).__name__ == "DeclareLaunchArgument"}
    included = [dict(each.launch_arguments) for each in parts if type(each).__name__ == "IncludeLaunchDescription"]
    assert len(included) == 2 and all(set(each) <= known for each in included)
    assert {value.given[0] for each in included for value in each.values()} == set(declared)
    assert declared["left_namespace"] == "left" and declared["right_namespace"] == "right"
