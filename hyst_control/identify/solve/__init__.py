"""Solvers shared by the families: Gauss-Newton, simulation error, Gram sums, covariance."""
