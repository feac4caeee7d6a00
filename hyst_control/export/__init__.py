"""A chain, a compensator or a whole controller as C."""
