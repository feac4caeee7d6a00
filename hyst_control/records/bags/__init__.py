"""Bags: reading, writing, and fields of any message."""
