# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Ground of every room: errors, files, progress, processes, plugins, configuration files."""
