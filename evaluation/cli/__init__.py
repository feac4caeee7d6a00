"""Subcommands of `hyst` that exist in a checkout only."""
