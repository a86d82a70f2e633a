"""The try-on for users: one session from design, body and fabric to the fitted garment; poses, other bodies."""
