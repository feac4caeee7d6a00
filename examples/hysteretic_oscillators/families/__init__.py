"""Families that fit them to records."""
