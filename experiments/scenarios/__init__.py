"""What experiments share: moves, tours, strategies and perturbations."""
