# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Executor, timers, exchange within a process, signals of the operating system, and the ends of nodes."""
