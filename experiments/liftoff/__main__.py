"""The command ``python -m experiments.liftoff``."""

from experiments.liftoff import main

raise SystemExit(main())
