# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A page leaves the loop's cores to the loop: after a drawing it rests for some times as long as the drawing took."""

from __future__ import annotations

import pytest
from no_actions import NoActions

from hyst_control.dashboard.live_state import LiveState


def test_a_slow_drawing_is_followed_by_a_longer_rest(monkeypatch):
    pytest.importorskip("bokeh", reason="the extra dashboard, which make env installs")
    from bokeh.document import Document

    from hyst_control.dashboard import page

    now = [100.0]
    monkeypatch.setattr(page.time, "monotonic", lambda: now[0])
    document = Document()
    window = page._Window(document, LiveState(), NoActions())
    window._ready(None)

    def updates() -> bool:
        before = window._sent
        window.update()
        return window._sent > before

    assert updates()
    now[0] += 0.2
    assert not updates()  # the browser still draws
    window._confirmed("tags", None, [window._sent])
    now[0] += 0.99 * page.REST * 0.2
    assert not updates()
    now[0] += 0.02 * page.REST * 0.2
    assert updates()
