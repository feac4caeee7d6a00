"""Rows that arrive from other programs: checks, order, repetition, storage, and the signal message."""
