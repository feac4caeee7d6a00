"""Truth plants: physics to judge simulators by. Imports nothing of the package under test and shares no code with it."""

from hyst_plant_sim.physics.effects import EFFECTS
from hyst_plant_sim.physics.line import Plant, PlantError
from hyst_plant_sim.physics.loading import PLANTS, load_plant

__all__ = ["EFFECTS", "PLANTS", "Plant", "PlantError", "load_plant"]
