"""A crane identified from its records."""
