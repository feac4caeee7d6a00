"""Warning of a reference that asks for more slope than the command may have."""

from __future__ import annotations

from hyst_control.nodes.signal_node.base import SignalNode


def warn_of_slope(node: SignalNode, found: tuple[int, float] | None) -> None:
    """Warn of what `SlopeDemand` has found, if anything: a tick, and a slope in V a tick above the node's `slew_limit`."""
    if found:
        tick, step = found
        node.counts["slope above slew_limit"] += 1
        node.warn(
            "slope",
            f"the reference asks for {step / node.period:.3g} V/s at {tick * node.period:.6g} s, slew_limit is "
            f"{node.settings.slew_limit:g} V/s: smooth the reference, or begin it with a ramp",
        )
