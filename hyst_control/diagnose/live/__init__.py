"""Diagnosis beside a running machine."""
