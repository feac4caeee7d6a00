"""Families of hysteretic oscillators: Duhem and Bouc-Wen."""
