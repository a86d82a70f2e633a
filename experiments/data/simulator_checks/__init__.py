"""Checks of the simulator, one file for each kind; `validate_simulator` runs them."""
