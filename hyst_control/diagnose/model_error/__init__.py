"""Discrepancy of the model on healthy records, as baseline records show it."""
