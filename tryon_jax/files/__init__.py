"""What is written to disk: in one step each, in formats that other programs read."""
