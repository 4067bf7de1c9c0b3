"""External forces on a crane, such as wind."""
