"""The command ``python -m experiments.a3``."""

import sys

from experiments.a3 import main

if __name__ == "__main__":
    sys.exit(main())
