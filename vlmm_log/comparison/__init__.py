"""What differs between two runs: matched values, how far they are apart, and where they part first."""
