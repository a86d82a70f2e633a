"""Cloth simulation: fabrics, energies as pure functions, contact and friction, implicit solver, dressing, sweeps."""
