"""The sub-commands of `tryon`, one module each.

A command is a module here with a docstring (its first line is the command's one-line help), a dataclass `Config` (its
fields are the options; the string or comment at each field is the option's help) and `main(config)`. A module without
`main` is no command. Nothing needs to be registered.
"""
