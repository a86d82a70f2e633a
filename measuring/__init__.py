"""What experiments and benchmarks both need: times, records of the surroundings, tables, textile samples."""
