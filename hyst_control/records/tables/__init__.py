"""Recordings of other tools: text tables and the containers of other programs, with columns named by the user."""
