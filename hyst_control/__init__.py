"""Identification, feedforward control and sim-to-real diagnosis of piezoelectric actuators with hysteresis."""
