"""Settings of all tests."""

from __future__ import annotations

from hypothesis import HealthCheck, settings

settings.register_profile(
    "cranedyn", deadline=None, derandomize=True, max_examples=25, database=None, suppress_health_check=[HealthCheck.differing_executors]
)
settings.load_profile("cranedyn")
