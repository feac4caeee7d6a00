# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The published figures of the HAMPI paper, one place for all of them, by table and figure."""

from __future__ import annotations

TABLE_1 = {1.0: (0.0, 0.0), 50.0: (2.8, 2.25), 100.0: (6.3, 7.65), 300.0: (21.3, 27.5), 500.0: (39.0, 49.1)}
"""Phase lag in degrees by frequency (Hz): (LTI model, experiment with the hysteresis' own lag removed)."""
FIGURE_2 = 93.56
"""Fit of G(s) to the step response, %."""
FREQUENCIES = (50.0, 100.0, 200.0, 300.0, 400.0, 500.0)
TABLE_4 = {
    "HAPI": (3.83, 3.68, 4.71, 4.70, 5.22, 5.58),
    "RDPI": (1.47, 3.18, 4.75, 6.26, 8.18, 10.44),
    "HAMPI": (2.10, 1.60, 1.26, 1.40, 2.14, 3.07),
}
"""NRMSE in % at `FREQUENCIES`, 140 V."""
TABLE_4_RMSE = {
    "HAPI": (0.58, 0.55, 0.69, 0.69, 0.78, 0.85),
    "RDPI": (0.22, 0.48, 0.70, 0.92, 1.21, 1.60),
    "HAMPI": (0.32, 0.24, 0.19, 0.21, 0.32, 0.47),
}
"""RMSE in um."""
TABLE_5 = {
    "HAPI": {10.0: (0.16, 3.92), 50.0: (0.15, 3.86), 100.0: (0.25, 6.71), 150.0: (0.35, 8.75)},
    "HAMPI": {10.0: (0.06, 1.50), 50.0: (0.05, 1.28), 100.0: (0.06, 1.61), 150.0: (0.09, 2.25)},
}
"""Tracking of 4 um by frequency (Hz): (RMSE in um, NRMSE in %)."""
TABLE_2 = {"m1": 7.7e-7, "m2": 2.5e-7, "k": -6.4e-4, "b": 0.025}
"""Dynamic weights of §3.2 in s/V, s/V, 1/V and 1; m1, m2 and b are positive and k is negative (§3.1)."""
