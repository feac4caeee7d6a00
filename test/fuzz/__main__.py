"""`make fuzz`: many random inputs to everything that reads files or messages. An argument says how many (default 100000)."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Any

from hypothesis import HealthCheck, Phase, given, settings
from targets import TARGETS

HANG = 20_000  # ms that one input may take


def main() -> None:
    """Run all targets, each with its share of the inputs; the first failure ends it with the input that failed."""
    total = int(sys.argv[1]) if len(sys.argv) > 1 else 100_000
    for name, (inputs, reader, share) in TARGETS.items():
        begin = time.monotonic()
        seen = run(inputs, reader, round(total * share))
        print(f"{name}: {seen} inputs, {time.monotonic() - begin:.0f} s, none failed", flush=True)


def run(inputs: Any, reader: Callable[[Any], None], count: int) -> int:
    """How many inputs were read; the first failure is raised with the smallest input that shows it."""
    seen = [0]

    @settings(
        max_examples=count,
        deadline=HANG,
        database=None,
        suppress_health_check=list(HealthCheck),
        phases=(Phase.generate, Phase.shrink),
    )
    @given(inputs)
    def read(value):
        seen[0] += 1
        reader(value)

    read()
    return seen[0]


if __name__ == "__main__":
    main()
