"""How every experiment runs: arguments, setup, progress, outcome, files."""
