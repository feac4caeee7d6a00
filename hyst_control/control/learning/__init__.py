"""Learning from trial to trial and from the feedback."""
