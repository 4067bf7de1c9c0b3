"""The command ``python -m experiments.a1``."""

from experiments.a1 import main

raise SystemExit(main())
