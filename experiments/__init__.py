"""Data sets, trainings, and one module for each table or figure. `python -m experiments NAME --help`.

An experiment is a module in one of the folders with a docstring, a dataclass `Config` whose fields are commented
defaults, and `main(config)`. Its name is the command; a module without `main` is no command. `data` makes data sets,
`train` trains networks, `paper` measures what the paper claims, `beyond` what it does not ask; `shared` holds what
several of them use. The folders do not import each other, `shared` excepted.
"""
