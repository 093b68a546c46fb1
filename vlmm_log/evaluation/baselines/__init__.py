"""Other ways to the same questions: the documented mechanism on the same data, "-style", not the released system."""
