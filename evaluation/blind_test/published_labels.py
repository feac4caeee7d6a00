"""Labels as they are published: rounded, so that their hash is the same on every machine.

The last digits of a simulated gap come from the processor's mathematics library; six digits of a label are all that anybody compares.
"""

from __future__ import annotations

from typing import Any

DIGITS = 6


def rounded(value: Any) -> Any:
    """The nested `value` with all its real numbers rounded to `DIGITS` significant digits."""
    if isinstance(value, dict):
        return {key: rounded(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [rounded(item) for item in value]
    return float(f"{value:.{DIGITS}g}") if isinstance(value, float) else value
