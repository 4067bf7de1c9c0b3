"""The command ``python -m experiments.compare``."""

from experiments.compare import main

raise SystemExit(main())
