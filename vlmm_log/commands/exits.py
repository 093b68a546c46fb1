"""What exit codes say beside 0, done, and 2, cannot be used."""

NOTHING = FOUND = FAILED = 1  # the answer is no
INTERRUPTED = 130
