"""Linear families: modes, transfer functions, frequency responses."""
