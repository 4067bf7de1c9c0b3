"""What acts on a crane from outside: wind and other forces."""
