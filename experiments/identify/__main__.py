"""The command ``python -m experiments.identify``."""

import sys

from experiments.identify import main

if __name__ == "__main__":
    sys.exit(main())
