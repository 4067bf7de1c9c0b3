"""What cuts across the modules: generated input, hostile input, interruptions, packaging."""
