"""Feedforward compensators: inverse models of hysteresis and dynamics."""
