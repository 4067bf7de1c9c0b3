"""What a lift is judged by: loads on the crane, charts of rated loads, factors of the standards."""
