"""Signals in time: records, bags, foreign files, the signal message, excitations."""
