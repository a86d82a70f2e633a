"""What the paper does not ask: body coverage, mesh density, inverse problems, garments too tight."""
