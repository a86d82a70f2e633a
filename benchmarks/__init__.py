"""Speed and memory, measured and recorded with the hardware they were measured on. `python -m benchmarks NAME --help`.

A benchmark is a module here with a docstring, a dataclass `Config` and `main(config)`; `benchmarks.record` takes the
times and writes the results.
"""
