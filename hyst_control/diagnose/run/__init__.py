"""A diagnosis from problem to report."""
