"""The command ``python -m experiments.demo``."""

from experiments.demo import main

raise SystemExit(main())
