"""Noise of a residual: white, 1/f, narrow-band."""
