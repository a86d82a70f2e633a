"""Recipes: training runs, and one module for each table or figure. `python -m experiments NAME --help`.

An experiment is a module here with a docstring, a dataclass `Config` whose fields are commented defaults, and
`main(config)`. A module without `main` is no experiment.
"""
