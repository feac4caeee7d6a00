"""Feedback: PI controller, limits, watches and the safe loop."""
