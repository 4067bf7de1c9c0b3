"""The command ``python -m experiments.energy``."""

import sys

from experiments.energy import main

if __name__ == "__main__":
    sys.exit(main())
