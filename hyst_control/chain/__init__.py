"""Stages and chains. Every module of this package is imported, so that a new stage is one new file."""

from importlib import import_module
from pkgutil import iter_modules

from hyst_control.chain.chain import Chain, Parallel
from hyst_control.chain.stage import STAGES, Filter, Sampling, Stage, register

for _module in iter_modules(__path__):
    import_module(f"{__name__}.{_module.name}")

__all__ = ["STAGES", "Chain", "Filter", "Parallel", "Sampling", "Stage", "register"]
