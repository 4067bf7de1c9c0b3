"""The command ``python -m experiments.site``."""

from experiments.site import main

raise SystemExit(main())
