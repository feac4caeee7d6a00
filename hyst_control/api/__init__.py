# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The front door, `import hyst_control as hc`: records, models, tunings and gaps, over the functions that the commands use too."""
