"""The command ``python -m experiments.measured``."""

from experiments.measured import main

raise SystemExit(main())
