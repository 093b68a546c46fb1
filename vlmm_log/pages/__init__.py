"""Pages that need nothing else: HTML with its charts and pictures inside."""
