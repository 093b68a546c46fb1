"""What can be fetched on request: from where, under which terms, and how it is known to be the right file."""
