"""Data sets: simulate them, describe them, print their patterns, check the simulator."""
