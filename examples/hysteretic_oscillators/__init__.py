"""Hysteretic oscillators as a plugin: Duhem and Bouc-Wen stages, and the families that identify them."""
