"""The demonstration: excite, record, identify, track and diagnose a simulated actuator through the nodes."""
