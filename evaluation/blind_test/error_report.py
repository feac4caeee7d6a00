"""Report of a case whose diagnosis ended in an error: no name, no shrink; every score counts it as wrong."""

from __future__ import annotations

from typing import Any

VERDICT = "error"


def error_report(error: Exception) -> dict[str, Any]:
    """Make the report."""
    return {
        "verdict": VERDICT,
        "error": f"{type(error).__name__}: {error}",
        "effects": [],
        "candidates": [],
        "unexplained_share": None,
    }
