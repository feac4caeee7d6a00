"""Simulated plants: physics that shares nothing with the models, and the node that runs one."""
