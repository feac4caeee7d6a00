# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The configuration of the diagnosis."""

from __future__ import annotations

from dataclasses import fields, replace

from hyst_control.diagnose.configuration import CONFIGURATION


def test_every_value_is_in_the_hash():
    groups = {one.name: getattr(CONFIGURATION, one.name) for one in fields(CONFIGURATION)}
    seen = {CONFIGURATION.digest()}
    for name, group in groups.items():
        for one in fields(group):
            value = getattr(group, one.name)
            other = (*value[:-1], value[-1] + 1) if isinstance(value, tuple) else value + 1
            seen.add(replace(CONFIGURATION, **{name: replace(group, **{one.name: other})}).digest())
    assert len(seen) == 1 + sum(len(fields(group)) for group in groups.values())
