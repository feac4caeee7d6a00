"""Metric of a blind test: a proportion with its Wilson interval, or a value, beside its target."""

from __future__ import annotations

from dataclasses import dataclass

from scipy.stats import binomtest


@dataclass(frozen=True)
class Metric:
    """A proportion with its Wilson 95 % interval, or a plain value, beside its target."""

    name: str  # Name of the metric
    value: float  # Proportion or value
    n: int  # Number of cases
    ci95: tuple[float, float] | None  # Wilson 95 % interval of a proportion; None for a plain value
    target: float  # The target
    # True if the value should reach the target from below, False if it should not exceed it
    at_least: bool = True

    @property
    def met(self) -> bool:
        """True when the figure itself reaches its target."""
        return self.value >= self.target if self.at_least else self.value <= self.target


def proportion(name: str, k: int, n: int, target: float, at_least: bool = True) -> Metric:
    """Make the metric of k cases of n."""
    return Metric(name, k / n, n, wilson(k, n), target, at_least)


def wilson(k: int, n: int) -> tuple[float, float]:
    """Wilson's 95 % interval of a proportion k / n."""
    if not n:
        return 0.0, 1.0
    interval = binomtest(k, n).proportion_ci(0.95, "wilson")
    return float(interval.low), float(interval.high)
