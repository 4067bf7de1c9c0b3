"""Each door against the real thing on its other side."""
