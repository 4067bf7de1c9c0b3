"""The command ``python -m experiments.margins``."""

import sys

from experiments.margins import main

if __name__ == "__main__":
    sys.exit(main())
