"""The command ``python -m experiments.compare``."""

import sys

from experiments.compare import main

if __name__ == "__main__":
    sys.exit(main())
