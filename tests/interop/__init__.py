"""Each interface against the program on its other side."""
