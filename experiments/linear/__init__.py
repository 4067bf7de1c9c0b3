"""The paper's linear swing beside the plant: cranes and moves, models, runs, tables, figures."""
