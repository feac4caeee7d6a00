"""What is set for each middleware, and what a user is told about one."""

from __future__ import annotations

import os
import xml.etree.ElementTree as tree

import pytest

from hyst_control.base.config_files import config_path
from hyst_control.processes import environment, middleware
from hyst_control.processes.installation import Verdict, discovery

CYCLONE, ZENOH = "rmw_cyclonedds_cpp", "rmw_zenoh_cpp"
VARIABLES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE", "CYCLONEDDS_URI", "ZENOH_SESSION_CONFIG_URI")


@pytest.fixture
def clean(monkeypatch, tmp_path):
    """No variable of a middleware is set, and no ROS is found in the environment of the tests."""
    for name in (*VARIABLES, "RMW_IMPLEMENTATION", "ROS_LOCALHOST_ONLY", "ROS_AUTOMATIC_DISCOVERY_RANGE"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    monkeypatch.setattr(middleware.sys, "prefix", str(tmp_path))
    return monkeypatch


def set_variables():
    environment.prepare()
    return {name: os.environ[name] for name in VARIABLES if name in os.environ}


@pytest.mark.parametrize("given", ["", "FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE"])
def test_fast_dds_takes_the_shipped_settings_unless_the_user_has_some(clean, given):
    if given:
        clean.setenv(given, "own.xml")
    shipped = {"FASTRTPS_DEFAULT_PROFILES_FILE": str(config_path("fastdds/loop.xml"))}
    assert set_variables() == ({given: "own.xml"} if given else shipped)


def test_version_3_of_fast_dds_is_told_by_its_own_variable_and_in_its_own_tags(clean, tmp_path):
    (tmp_path / "share" / "fastdds").mkdir(parents=True)
    assert set_variables() == {"FASTDDS_DEFAULT_PROFILES_FILE": str(config_path("fastdds/loop_3.xml"))}


@pytest.mark.parametrize("file, tag", [("loop.xml", "heartbeatPeriod"), ("loop_3.xml", "heartbeat_period")])
def test_both_files_say_the_same(file, tag):
    profiles = tree.parse(config_path(f"fastdds/{file}")).getroot()
    [writer] = profiles
    [period] = writer.findall(f".//{{*}}{tag}")
    assert writer.get("is_default_profile") == "true" and [each.text for each in period] == ["0", "100000000"]


@pytest.mark.parametrize("name", [CYCLONE, ZENOH, "rmw_of_nobody"])
def test_other_middlewares_get_no_settings_and_are_called_untried(clean, name):
    clean.setenv("RMW_IMPLEMENTATION", name)
    assert set_variables() == {} and middleware.chosen().name == name and not middleware.chosen().tried


def test_zenoh_is_never_called_private_since_its_router_decides(clean):
    clean.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    clean.setenv("RMW_IMPLEMENTATION", CYCLONE)
    assert environment.exposure() == "" and discovery().verdict is Verdict.GOOD
    clean.setenv("RMW_IMPLEMENTATION", ZENOH)
    assert "router" in environment.exposure() and "\n" not in environment.exposure()
    assert discovery().verdict is Verdict.NOTE and "router" in discovery().found
