"""What is done with a drape on a body: its fit, poses, other bodies."""
