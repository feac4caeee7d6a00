"""The identification node: what it writes equals what the same function writes without ROS; failures come back as reasons."""

from __future__ import annotations

from loop_case import write_record
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

from hyst_control.identify.workflow import identify_bags
from hyst_control.nodes.identification import Identification
from hyst_control.nodes.run import run


def test_once_writes_the_model_that_the_function_writes(tmp_path, ros_context):
    write_record(tmp_path / "bag")
    settings = {"bags": [str(tmp_path / "bag")], "family": "pi", "output": str(tmp_path / "node.yaml"), "once": True}
    node = Identification(context=ros_context, parameter_overrides=[Parameter(key, value=value) for key, value in settings.items()])
    assert run([node], ros_context, timeout=60) == 0
    identify_bags([tmp_path / "bag"], "pi", tmp_path / "function.yaml")
    assert (tmp_path / "node.yaml").read_text() == (tmp_path / "function.yaml").read_text()


def test_service_answers_with_the_reason(ros_context):
    node = Identification(context=ros_context)
    try:
        [service] = [each for each in node.services if each.srv_name.endswith("/identify")]
        answer = service.callback(Trigger.Request(), Trigger.Response())
        assert not answer.success and "bags" in answer.message
        assert node.set_parameters([Parameter("bags", value=["nowhere"]), Parameter("output", value="model.yaml")])[0].successful
        answer = service.callback(Trigger.Request(), Trigger.Response())
        assert not answer.success and "nowhere" in answer.message
    finally:
        node.destroy_node()
