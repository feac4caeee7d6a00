"""Truth plants: physics to judge simulators by. Imports nothing of the package under test and shares no code with it."""

from hyst_plant_sim.physics.loading import PLANTS, load_plant
from hyst_plant_sim.physics.pea import PlantError

__all__ = ["PLANTS", "PlantError", "load_plant"]
