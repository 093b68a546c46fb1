"""What `doctor` examines: one family of checks a file, each a function from a case to findings and evidence."""
