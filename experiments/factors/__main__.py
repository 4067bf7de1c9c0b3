"""The command ``python -m experiments.factors``."""

from experiments.factors import main

raise SystemExit(main())
