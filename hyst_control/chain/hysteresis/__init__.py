"""Stages with memory: play operators, Prandtl-Ishlinskii, Madelung, Duhem, Bouc-Wen, and their inverses."""
