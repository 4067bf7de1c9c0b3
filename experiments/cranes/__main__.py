"""The command ``python -m experiments.cranes``."""

from experiments.cranes import main

raise SystemExit(main())
