"""Results of a sweep read lazily by DuckDB, as if all of them did not fit the memory; run it as
``python -m lazy_results``. Needs: duckdb.
"""

import duckdb
import numpy as np

from cranedyn.command import command
from cranedyn.sweep import grid, sweep
from cranedyn.theory import amplitude_factor, point_period

WORST = """
    SELECT round(l_m) AS length, max(T_s) AS longest, count(*) AS cases
    FROM 'swings/*.parquet' WHERE error IS NULL AND A_rad > 0.5
    GROUP BY length ORDER BY longest DESC LIMIT 3
"""


def swing_period(cases: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return periods of free swings [s] by cable length and amplitude."""
    return {"T_s": point_period(cases["l_m"], 9.80665) * amplitude_factor(cases["A_rad"])}


def main() -> int:
    """Sweep 40,000 cases, then ask for three lines: of each file DuckDB reads the columns that it
    needs, one part after another.
    """
    lengths = np.linspace(5.0, 25.0, 200).tolist()
    amplitudes = np.linspace(0.01, 1.0, 200).tolist()
    sweep(swing_period, grid(l_m=lengths, A_rad=amplitudes), "swings", chunk=5000, workers=1)
    for length, longest, cases in duckdb.sql(WORST).fetchall():
        print(f"{length:g} m: up to {longest:.3f} s in {cases} cases of wide swings")
    return 0


if __name__ == "__main__":
    raise SystemExit(command(main))
