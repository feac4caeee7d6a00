"""The base of every node: its signals, its parameters, its schedule, its diagnostics."""
