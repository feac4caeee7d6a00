"""Truth plants: physics against which simulators are judged. Imports nothing of the package under test and shares no code with it."""

from hyst_plant_sim.physics.effects import EFFECTS
from hyst_plant_sim.physics.plant_files import PLANTS, load_plant
from hyst_plant_sim.physics.signal_path import Plant, PlantError

__all__ = ["EFFECTS", "PLANTS", "Plant", "PlantError", "load_plant"]
