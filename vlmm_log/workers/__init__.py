"""One log by several processes: each looks at pairs by themselves, the caller learns from them in order."""
