"""Candidates of the catalogue, their fits, the search among them, and the null threshold."""
