"""Who may hear and command: the line at the start, the SROS 2 policy, and an enclave that the middleware cannot keep."""

from __future__ import annotations

import os
import subprocess
import sys
import xml.etree.ElementTree as tree

import pytest
from loop_case import MODEL

from hyst_control.base.config_files import config_path
from hyst_control.dashboard.live_state import LiveState
from hyst_control.nodes.dashboard import ASKED, DashboardNode
from hyst_control.nodes.identification import Identification
from hyst_control.nodes.pipeline import COMPOSABLE, node_class
from hyst_control.nodes.signal_node.managed import ManagedNode
from hyst_control.processes import environment

SETTINGS = {
    "reference_generator": {"signal": "rest", "duration": 1.0},
    "recorder": {"topics": ["reference", "learned", "feedforward", "feedback", "command", "measurement"], "schedule": "timer"},
    "plant": {"model": MODEL, "wait_for_recorder": True},
    "diagnosis": {"model": MODEL, "schedule": "timer"},
    "simulated_stage": {"autostart": False},
    "pi_stage": {"autostart": False},
    "iio_stage": {"autostart": False},
    "hampi_feedforward": {"kind": "proportional", "learning": "feedback_error"},
    "mhl_feedforward": {"kind": "proportional", "learning": "feedback_error"},
}
STAGES = ["plant", "simulated_stage", "pi_stage", "iio_stage"]
ROS_OWN = ("/rosout", "/parameter_events", "/clock")


def policy():
    """Topics and services by enclave and right: ("pi_feedback", "topics publish"), say."""
    found = {}
    for enclave in tree.parse(config_path("sros2/policy.xml")).iter("enclave"):
        [profile] = enclave.iter("profile")
        name = enclave.get("path").lstrip("/")
        assert profile.get("node") == name and profile.get("ns") == "/"
        for group in profile:
            [right] = [key for key, value in group.items() if value == "ALLOW"]
            entries = {each.text.replace("~", f"/{name}") for each in group}
            found[name, f"{group.tag} {right}"] = {each if each.startswith("/") else f"/{each}" for each in entries}
    return found


@pytest.mark.parametrize("name", [*COMPOSABLE, "identification"])
def test_policy_allows_what_a_node_does_and_no_more(bench, tmp_path, name):
    output = {"output": str(tmp_path / "bag")} if name in ("recorder", "diagnosis", "identification") else {}
    settings = {**output, **SETTINGS.get(name, {})}
    node = bench.add(Identification if name == "identification" else node_class(name), **settings)
    allowed = policy()
    subscribed = {each.topic_name for each in super(type(node), node).subscriptions} | {
        each.topic for each in getattr(node, "polled", ())
    }
    published = {each.topic_name for each in node.publishers}
    if isinstance(node, ManagedNode):
        published.add(f"/{name}/transition_event")  # which rcl publishes
    own = {topic for topic in allowed[name, "topics publish"] if topic not in ROS_OWN}
    assert own == {topic for topic in published if topic not in ROS_OWN}
    heard = {topic for topic in allowed[name, "topics subscribe"] if topic not in ROS_OWN}
    assert heard - {"/command" if name == "pi_feedback" else ""} == {topic for topic in subscribed if topic not in ROS_OWN}
    offered = {"/" + each.srv_name.replace("~", name).lstrip("/") for each in node.services}
    assert allowed[name, "services reply"] == offered
    assert offered <= allowed["operator", "services request"]


def test_policy_allows_the_dashboard_what_its_buttons_do(bench):
    node = bench.add(lambda context, **_: DashboardNode(LiveState(), context=context))
    allowed = policy()
    heard = {each.topic_name for each in super(type(node), node).subscriptions} | {
        each.topic for each in getattr(node, "polled", ())
    }
    assert allowed["dashboard", "topics subscribe"] - set(ROS_OWN) == heard - set(ROS_OWN)
    assert {each.topic_name for each in node.publishers} <= set(ROS_OWN)
    offered = {"/" + each.srv_name.replace("~", "dashboard").lstrip("/") for each in node.services}
    assert allowed["dashboard", "services reply"] == offered
    driving = {name for (name, right), topics in allowed.items() if right == "topics publish" and {"/command", "/applied"} & topics}
    assert allowed["dashboard", "services request"] == {f"/{name}/{what}" for name in driving for what in ASKED}


def test_only_the_feedback_may_command_and_only_a_plant_or_a_stage_measures():
    who = {
        topic: [name for (name, right), topics in policy().items() if right == "topics publish" and topic in topics]
        for topic in ("/command", "/measurement", "/applied")
    }
    assert who == {"/command": ["pi_feedback"], "/measurement": STAGES, "/applied": STAGES}


CASES = [
    ({}, "every program on this machine can hear these nodes and command the actuator, other machines cannot"),
    ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}, ""),
    ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}, "every machine on this network can hear these nodes and command the actuator"),
    ({"ROS_LOCALHOST_ONLY": "1"}, ""),
    ({"ROS_LOCALHOST_ONLY": "0"}, "every machine on this network"),
    ({"ROS_SECURITY_ENABLE": "true", "ROS_SECURITY_STRATEGY": "Enforce"}, ""),
]


@pytest.mark.parametrize("variables, line", CASES)
def test_one_line_says_who_can_command(monkeypatch, variables, line):
    for name in ("ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_LOCALHOST_ONLY", "ROS_SECURITY_ENABLE", "ROS_SECURITY_STRATEGY"):
        monkeypatch.delenv(name, raising=False)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    said = environment.exposure()
    assert said.startswith(line) and "\n" not in said and bool(said) == bool(line)


def test_a_node_says_so_at_its_start(domain):
    """As started by `ros2 run`, without the variable; the bad parameter ends it."""
    variables = {key: value for key, value in os.environ.items() if key != "ROS_AUTOMATIC_DISCOVERY_RANGE"}
    command = [sys.executable, "-m", "hyst_control.nodes.pi_feedback", "--ros-args", "-p", "upper:=-1.0"]
    ended = subprocess.run(command, env=variables, capture_output=True, text=True, timeout=60)
    assert ended.returncode == 2 and ended.stderr.startswith("every program on this machine") and ended.stderr.count("\n") == 2


@pytest.mark.parametrize("complete", [False, True])
def test_an_enclave_that_cannot_be_kept_is_one_line(domain, tmp_path, complete):
    """Without a keystore, and with one while the middleware has no security, as that of the wheels."""
    if complete:
        (tmp_path / "enclaves").mkdir()
        for name in ("identity_ca.cert.pem", "cert.pem", "key.pem", "permissions_ca.cert.pem", "governance.p7s", "permissions.p7s"):
            (tmp_path / "enclaves" / name).write_text("none")
    secured = {"ROS_SECURITY_ENABLE": "true", "ROS_SECURITY_STRATEGY": "Enforce", "ROS_SECURITY_KEYSTORE": str(tmp_path)}
    command = [sys.executable, "-m", "hyst_control.nodes.pi_feedback"]
    ended = subprocess.run(command, env={**os.environ, **secured}, capture_output=True, text=True, timeout=60)
    assert ended.returncode == 2 and "Traceback" not in ended.stderr
    *of_rcl, line = ended.stderr.splitlines()
    assert (
        line.startswith("security: ")
        and "docs/safety.md" in line
        and all("[rcl]" in each or "SECURITY" not in each for each in of_rcl)
    )
