"""The command ``python -m experiments.identify``."""

from experiments.identify import main

raise SystemExit(main())
