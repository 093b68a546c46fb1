"""Speed as ratios from one run, and figures on real recordings. Not installed; run from the repository's root."""
