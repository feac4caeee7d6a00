"""Fleets: thousands of records of many units, each identified, validated or diagnosed by itself, and what only many can tell."""
