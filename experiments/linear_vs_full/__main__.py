"""The command ``python -m experiments.linear_vs_full``."""

from experiments.linear_vs_full import main

raise SystemExit(main())
