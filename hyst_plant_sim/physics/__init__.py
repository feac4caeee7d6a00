# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Reference simulations, by which simulators are judged; they import nothing of the package under test and share no code with it."""

from hyst_plant_sim.physics.effects import EFFECTS
from hyst_plant_sim.physics.plant_files import PLANTS, load_plant
from hyst_plant_sim.physics.signal_path import Plant, PlantError

__all__ = ["EFFECTS", "PLANTS", "Plant", "PlantError", "load_plant"]
