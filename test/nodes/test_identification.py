"""The identification node: what it writes equals what the same function writes without ROS; failures come back as reasons."""

from __future__ import annotations

from loop_case import write_record
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

from hyst_control.identify.families.estimator import every_option
from hyst_control.identify.workflow import identify_bags
from hyst_control.nodes.execution.run import run
from hyst_control.nodes.identification import Identification


def test_once_writes_the_model_that_the_function_writes(tmp_path, ros_context):
    write_record(tmp_path / "bag")
    settings = {"bags": [str(tmp_path / "bag")], "family": "pi", "output": str(tmp_path / "node.yaml"), "once": True}
    node = Identification(context=ros_context, parameter_overrides=[Parameter(key, value=value) for key, value in settings.items()])
    assert run([node], ros_context, timeout=60) == 0
    identify_bags([tmp_path / "bag"], "pi", tmp_path / "function.yaml")
    assert (tmp_path / "node.yaml").read_text() == (tmp_path / "function.yaml").read_text()


def test_once_ends_with_the_status_of_unusable_input(tmp_path, ros_context):
    settings = {"bags": [str(tmp_path / "nowhere")], "output": str(tmp_path / "model.yaml"), "once": True}
    node = Identification(context=ros_context, parameter_overrides=[Parameter(key, value=value) for key, value in settings.items()])
    assert run([node], ros_context, timeout=60) == 2
    assert not (tmp_path / "model.yaml").exists()


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


def test_it_writes_within_its_folder_only(tmp_path, ros_context):
    """Whoever reaches the node may set its parameters and call it: not by another path, nor up and out, nor through a link."""
    write_record(tmp_path / "bag")
    (tmp_path / "inside").mkdir()
    (tmp_path / "inside" / "link").symlink_to(tmp_path)
    (tmp_path / "inside" / "file").symlink_to(tmp_path / "victim")
    before = sorted(tmp_path.rglob("*"))
    node = Identification(context=ros_context, parameter_overrides=[Parameter("folder", value=str(tmp_path / "inside"))])
    try:
        [service] = [each for each in node.services if each.srv_name.endswith("/identify")]
        assert not node.set_parameters([Parameter("folder", value="/")])[0].successful
        common = [Parameter("bags", value=[str(tmp_path / "bag")]), Parameter("family", value="pi")]
        for name, text in [
            ("output", str(tmp_path / "victim")),
            ("output", str(tmp_path / "inside" / ".." / "victim")),
            ("output", str(tmp_path / "inside" / "link" / "victim")),
            ("output", str(tmp_path / "inside" / "file")),
            ("output", str(tmp_path / "inside")),
            ("json", str(tmp_path / "victim")),
            ("output", str(tmp_path / "inside" / "a\0b")),
        ]:
            right = {"output": str(tmp_path / "inside" / "model.yaml"), "json": "", name: text}
            assert all(each.successful for each in node.set_parameters(common + [Parameter(*each) for each in made(right)]))
            answer = service.callback(Trigger.Request(), Trigger.Response())
            assert not answer.success and f"parameter {name}: " in answer.message and "is not within" in answer.message
        assert sorted(tmp_path.rglob("*")) == before
    finally:
        node.destroy_node()


def made(values):
    return [(name, Parameter.Type.STRING, text) for name, text in values.items()]


def test_options_are_those_of_the_families(tmp_path, ros_context):
    """Numbers or their texts, as a parameter file has them; one that the family does not have is refused, and so is what none takes."""
    write_record(tmp_path / "bag")
    node = Identification(context=ros_context, parameter_overrides=[Parameter("folder", value=str(tmp_path))])
    try:
        [service] = [each for each in node.services if each.srv_name.endswith("/identify")]

        def answer(**settings):
            results = node.set_parameters([Parameter(key, value=value) for key, value in settings.items()])
            refused = [result.reason for result in results if not result.successful]
            return refused[0] if refused else service.callback(Trigger.Request(), Trigger.Response())

        found = answer(bags=[str(tmp_path / "bag")], family="pi", output=str(tmp_path / "node.yaml"), operators=4, one_sided=True)
        assert found.success, found.message
        identify_bags([tmp_path / "bag"], "pi", tmp_path / "function.yaml", operators=4, one_sided=True)
        assert (tmp_path / "node.yaml").read_text() == (tmp_path / "function.yaml").read_text()
        found = answer(family="madelung")
        assert not found.success and "madelung has no such option" in found.message
        assert answer(operators="4", family="pi").success
        assert "operators: must be an integer >= 3, got 2" in answer(operators=2)
        assert "method: must be one of joint, paper" in answer(method="newest")
        assert answer(operators="", one_sided="", thresholds=[0.0, 2.0, 5.0]).success
    finally:
        node.destroy_node()


def test_every_option_is_a_parameter(ros_context):
    node = Identification(context=ros_context)
    try:
        for name, families in every_option().items():
            description = node.describe_parameter(name).description
            assert all(each in description for each in families) and next(iter(families.values())).meaning[:30] in description
    finally:
        node.destroy_node()
