"""Many sets of parameters on one or several clouds, and the best of them from a few labels."""
