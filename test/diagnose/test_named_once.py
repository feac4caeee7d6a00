# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""An effect that is named on an axis is not named again as the session's."""

from __future__ import annotations

from types import SimpleNamespace

from hyst_control.diagnose.report import attribution
from hyst_control.diagnose.report.attribution import Named


def test_a_drift_is_named_once_on_an_axis(monkeypatch):
    drift, other = Named("offset_drift", ("x",), 0.93, {}), Named("gain", ("y",), 0.9, {})
    session = [Named("offset", ("x",), 1.0, {}), Named("offset_drift", ("x",), 1.0, {}), Named("offset_drift", ("y",), 1.0, {})]
    for name, value in (
        ("_waveforms", [drift, other]),
        ("_companions", session),
        ("_without_waveform", []),
        ("_candidates", ()),
        ("coefficient_changes", ()),
    ):
        monkeypatch.setattr(attribution, name, lambda *_, value=value: value)
    settings = SimpleNamespace(configuration=SimpleNamespace(attribution=SimpleNamespace(coefficient_deviations=3.0)))
    assert attribution.attribute(settings).effects == (drift, other, session[0], session[2])
