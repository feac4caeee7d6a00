"""Findings in a record that need no fit: repeated values, quantization steps, spectral lines."""
