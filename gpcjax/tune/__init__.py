"""The search for hyperparameters: by grids, marginal likelihood or Optuna, and what it found on other seeds."""
