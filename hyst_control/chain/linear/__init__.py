"""Linear stages: exact discretization, state-space kernels, transfer functions, delays."""
