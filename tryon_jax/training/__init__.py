"""Learning the regressors: the protocol of shapes and splits, the simulated dataset, losses and training loops."""
