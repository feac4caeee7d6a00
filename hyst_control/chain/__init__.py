# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Stages and chains. Every module of this package and its sub-packages is imported, so that a new stage is one new file."""

from importlib import import_module
from pkgutil import walk_packages

from hyst_control.chain.chain import Chain, Parallel
from hyst_control.chain.stage import STAGES, Filter, Sampling, Stage, register

for _module in walk_packages(__path__, f"{__name__}."):
    import_module(_module.name)

__all__ = ["STAGES", "Chain", "Filter", "Parallel", "Sampling", "Stage", "register"]
