"""The command ``python -m experiments.energy``."""

from experiments.energy import main

raise SystemExit(main())
