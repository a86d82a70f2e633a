"""What several experiments use: samples and predictions, baselines without learning, records, processes."""
