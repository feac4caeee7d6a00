# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The tutorial's laboratory: plays a drive on a simulated stage and writes a CSV file as a data logger would.

`python lab.py DRIVE.npy RECORDING.csv [seed=…] [effect=… parameter=…]`: columns drive (V) and position (nm), one row per sample at 20 kHz.
"""

from __future__ import annotations

import sys

import numpy as np

from hyst_plant_sim.physics import load_plant

RATE = 20_000.0


def main(drive: str, recording: str, *words: str) -> None:
    """Play and write."""
    given = dict(word.split("=") for word in words)
    seed, name = int(given.pop("seed", 5)), given.pop("effect", None)
    effects = [{"name": name, **{key: float(value) for key, value in given.items()}}] if name else []
    command = np.load(drive)
    stage = load_plant({"plant": "pea", "rating": [0.0, 150.0], "effects": effects}, seed=seed, sample_time=1.0 / RATE)
    # The sensor's sample is taken before the new voltage acts.
    position = np.concatenate([stage.reset(command[0])[None], stage.step(command)[:-1]])
    rows = np.column_stack([command[:, 0], 1e3 * position[:, 0]])
    np.savetxt(recording, rows, fmt="%.5f", delimiter=",", header="drive,position", comments="")


if __name__ == "__main__":
    main(*sys.argv[1:])
