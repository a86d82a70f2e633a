"""The try-on as users meet it: one session from design, body and fabric to the fitted garment; poses, other bodies."""
