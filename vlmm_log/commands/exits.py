"""What exit codes say beside 0, done."""

NOTHING = FOUND = FAILED = 1  # the answer is no
UNUSABLE = 2  # the call or its input cannot be used
INTERRUPTED = 130
UNHEARD = 141  # nobody read what was printed: as of a program that SIGPIPE ended
