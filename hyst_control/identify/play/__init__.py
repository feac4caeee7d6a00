"""Families of play operators: Prandtl-Ishlinskii, HAPI, HAMPI, RDPI."""
