# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Actions of a page that none of its tests may take."""


class NoActions:
    recording = ""

    def ask(self, what):
        raise AssertionError(what)

    def record(self):
        raise AssertionError
