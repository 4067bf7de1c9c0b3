"""Results of a sweep under their old name."""

from experiments.harness.recorded import swept_columns as columns_swept

__all__ = ["columns_swept"]
