"""vlmm-log."""
