"""Where results go. A sink watches a run and changes nothing."""
