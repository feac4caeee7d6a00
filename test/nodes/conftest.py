"""A bench of nodes for every test here that asks for it."""

from __future__ import annotations

import signal

import pytest
from nodes_bench import Bench

from hyst_control.nodes.execution import interrupts
from hyst_control.nodes.signal_node import node_diagnostics

DIAGNOSTICS_INTERVAL = 0.2
"""s, instead of 1: what a test waits for most is the next diagnostics of its nodes."""


@pytest.fixture
def bench(ros_context, monkeypatch):
    monkeypatch.setattr(node_diagnostics, "DIAGNOSTICS_INTERVAL", DIAGNOSTICS_INTERVAL)
    bench = Bench(ros_context)
    try:
        yield bench
    finally:
        bench.close()


@pytest.fixture
def listening():
    """Interrupts are heard as in a process of nodes."""
    before = signal.getsignal(signal.SIGINT)
    interrupts.listen()
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
