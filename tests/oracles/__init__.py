"""Independent computations against which tests compare."""
