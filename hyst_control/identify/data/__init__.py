"""Records prepared for a fit: windows, rests, initial memory, drift, excited band."""
