"""Results of a sweep, as experiments read them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cranedyn.errors import CraneError
from cranedyn.sweep import results


def columns_swept(folder: Path) -> dict[str, np.ndarray]:
    """Return the columns of a finished sweep by name, shape (cases,) each.

    Raises:
        CraneError: If no case of it went well.
    """
    table = results(folder)
    errors = table["error"]
    if errors.null_count == 0:
        raise CraneError(f"Each of {len(errors):,} cases is bad; the first: {errors[0].as_py()}")
    return {name: table[name].to_numpy() for name in table.column_names}
