"""Discrepancy of a fitted model on its own records: learned discrepancy and error spectrum."""
