"""Run the experiment."""

import sys

from experiments.measured import main

if __name__ == "__main__":
    sys.exit(main())
