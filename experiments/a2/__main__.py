"""The command ``python -m experiments.a2``."""

import sys

from experiments.a2 import main

if __name__ == "__main__":
    sys.exit(main())
