# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The thread of a driver: order, deadlines, exceptions, and its end."""

from __future__ import annotations

import threading

import pytest

from hyst_control.hardware.driver_thread import DriverThread


def until(condition):
    end = threading.Event()
    for _ in range(2000):
        if condition():
            return
        end.wait(0.005)
    pytest.fail("condition not met in time")


def test_calls_run_in_order_in_one_thread_and_it_ends_after_the_last():
    thread, seen = DriverThread(), []
    calls = [thread.call(lambda k=k: seen.append((k, threading.get_ident())) or k) for k in range(20)]
    assert not thread.ended()
    thread.end(lambda: seen.append(("end", threading.get_ident())))
    thread.end(lambda: seen.append("again"))
    assert thread.ended(10.0) and [call.result for call in calls] == list(range(20))
    assert [each[0] for each in seen] == [*range(20), "end"]
    assert len({each[1] for each in seen} - {threading.get_ident()}) == 1


def test_without_a_call_there_is_nothing_to_end():
    thread = DriverThread()
    thread.end(lambda: pytest.fail("called"))
    assert thread.ended() and thread.silent_for == 0.0


@pytest.mark.parametrize("error", [OSError("no device"), SystemExit(1), KeyboardInterrupt()])
def test_what_a_driver_raises_is_kept_and_the_next_call_runs(error):
    thread = DriverThread()

    def fail():
        raise error

    failed, following = thread.call(fail), thread.call(lambda: 1)
    assert following.ended(10.0) and following.result == 1 and following.error is None
    assert failed.ended() and failed.error is error and failed.result is None
    thread.end(lambda: None)


def test_call_that_hangs_is_waited_for_no_longer_than_wanted_and_cancels_what_is_behind_it():
    thread, go, seen = DriverThread(), threading.Event(), []
    assert thread.call(lambda: None).ended(10.0)
    until(lambda: thread.silent_for == 0.0)
    hanging, behind, last = (
        thread.call(go.wait),
        thread.call(lambda: seen.append("behind")),
        thread.call(lambda: seen.append("last")),
    )
    assert not hanging.ended(0.05) and not hanging.ended()
    assert 0.04 < thread.silent_for < 10.0
    thread.answers()
    assert thread.silent_for < 0.04
    behind.cancel()
    go.set()
    assert last.ended(10.0) and behind.ended() and seen == ["last"]
    assert hanging.ended() and hanging.ended() and hanging.seconds > 0.04
    thread.end(lambda: None)
    assert thread.ended(10.0)
