"""A lift judged: what is asked of it, in tables, figures, and a page for a method statement."""
