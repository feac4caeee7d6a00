"""Reports of a fit: errors, explained share, choice of family, consistency of records."""
