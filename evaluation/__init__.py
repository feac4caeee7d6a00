"""Evaluation of the package in a checkout: published experiments, the blind test of the diagnosis, benchmarks."""
