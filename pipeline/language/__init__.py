"""Queries in words: from a text to the filter tree, and what the tree holds for."""
