"""The matrix of cranes and jobs: every crane through every job, in small instances."""
