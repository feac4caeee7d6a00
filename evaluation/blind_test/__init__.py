"""The blind test of the diagnosis: cases, run, scores, page."""
