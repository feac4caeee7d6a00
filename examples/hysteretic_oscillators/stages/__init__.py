"""Stages: Duhem hysteresis, and mechanics with a hysteretic force inside their feedback."""
