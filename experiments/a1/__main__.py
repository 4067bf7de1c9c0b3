"""The command ``python -m experiments.a1``."""

import sys

from experiments.a1 import main

if __name__ == "__main__":
    sys.exit(main())
