"""Trainings of the networks: all stages, each stage alone, choice of network and optimiser."""
