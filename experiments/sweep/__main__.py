"""The command ``python -m experiments.sweep``."""

from experiments.sweep import main

raise SystemExit(main())
