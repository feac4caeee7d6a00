"""The gap between a simulator and a recorded system: where it lies, which effect causes it, how far it shrinks."""
