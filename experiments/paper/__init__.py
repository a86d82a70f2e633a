"""What the paper claims, and this library's numbers beside each claim."""
