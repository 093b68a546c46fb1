"""A module a command: its options, its one call, its closing words."""
