"""Learned and library models, imported only when chosen."""
