"""A run that goes on where an earlier one ended: what pairs showed, kept on disk."""
