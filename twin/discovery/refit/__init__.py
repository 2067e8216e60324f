"""Joint fit of effects and tunables, with cross-validation on held-out folds."""
