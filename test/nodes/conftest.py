"""A bench of nodes for every test here that asks for it."""

from __future__ import annotations

import pytest
from nodes_bench import Bench


@pytest.fixture
def bench(ros_context):
    bench = Bench(ros_context)
    try:
        yield bench
    finally:
        bench.close()
