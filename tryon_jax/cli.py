"""The command line `tryon`, and the dispatcher that it shares with `python -m experiments` and `python -m benchmarks`.

Exit codes: 0 done, 1 the request could not be carried out, 2 the command line is wrong, 130 interrupted. What is wrong
with a request is said in one line; `TRYON_TRACEBACK=1` in the environment shows where it was found.
"""

import ast
import difflib
import importlib
import importlib.util
import io
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import tyro

import tryon_jax
from tryon_jax.files.compile_cache import keep_compiled_programs


def main(argv: Sequence[str] | None = None) -> int:
    """Run `tryon` with `argv` (the process's arguments by default) and return the exit code."""
    return dispatch("tryon", "tryon_jax.commands", argv, keep_compiled=True)


def dispatch(prog: str, package: str, argv: Sequence[str] | None = None, keep_compiled: bool = False) -> int:
    """Run the module of `package` that the first argument names, with its `Config` made from the others.

    Args:
        prog: what the program is called in messages.
        package: the package whose modules with a function `main(config)` are the commands, in folders or not.
        argv: arguments, by default the process's.
        keep_compiled: keep compiled programs for the next run.
    """
    arguments = list(sys.argv[1:] if argv is None else argv)
    commands = find_commands(package)
    for stream in (sys.stdout, sys.stderr):
        # A terminal that knows no "²" shows a question mark and no traceback.
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    if not arguments or arguments[0] in ("-h", "--help"):
        print(_overview(prog, commands))
        return 0 if arguments else 2
    name, *rest = arguments
    if name == "--version":
        print(f"tryon_jax {tryon_jax.__version__}")
        return 0
    name = name.replace("-", "_") if name.replace("-", "_") in commands else name
    if name not in commands:
        near = difflib.get_close_matches(name, [*commands, "--help", "--version"], n=3)
        hint = f" (did you mean {' or '.join(near)}?)" if near else ""
        kind = "option" if name.startswith("-") else "command"
        print(f"{prog}: error: unknown {kind} {name!r}{hint}; known: {', '.join(commands)}", file=sys.stderr)
        return 2
    return _run(f"{prog} {name}", commands[name].module, rest, keep_compiled)


@dataclass(frozen=True)
class Command:
    """One command of a program."""

    module: str
    """Full name of its module."""
    about: str
    """First line of the module's docstring."""


def find_commands(package: str) -> dict[str, Command]:
    """Commands of `package` and of the packages in it, by name; none of their modules is imported.

    Raises:
        ModuleNotFoundError: there is no such package.
        ImportError: two modules have one name, so that one of the commands could not be reached.
    """
    spec = importlib.util.find_spec(package)
    if spec is None or not spec.submodule_search_locations:
        raise ModuleNotFoundError(f"no package {package!r}")
    commands: dict[str, Command] = {}
    for folder in map(Path, spec.submodule_search_locations):
        # The package's own modules first, then folder by folder.
        for path in sorted(folder.rglob("*.py"), key=lambda path: (path.parent, path.name)):
            if path.stem.startswith("_"):
                continue
            tree = ast.parse(path.read_text(encoding="utf-8"))
            if any(isinstance(node, ast.FunctionDef) and node.name == "main" for node in tree.body):
                module = ".".join([package, *path.relative_to(folder).with_suffix("").parts])
                if path.stem in commands:
                    raise ImportError(f"command {path.stem!r} is in {commands[path.stem].module} and in {module}")
                doc = ast.get_docstring(tree) or ""
                commands[path.stem] = Command(module, doc.splitlines()[0] if doc else "")
    return commands


def _overview(prog: str, commands: dict[str, Command]) -> str:
    width = max((len(name) for name in commands), default=0) + 2
    lines = [f"usage: {prog} COMMAND [options]", "", "commands:"]
    lines += [f"  {name:<{width}}{command.about}" for name, command in commands.items()]
    lines += ["", f"{prog} COMMAND --help shows a command's options; --version shows the version."]
    return "\n".join(lines)


def _run(prog: str, module_name: str, arguments: list[str], keep_compiled: bool) -> int:
    try:
        if keep_compiled and not {"-h", "--help"} & set(arguments):
            keep_compiled_programs()
        module = importlib.import_module(module_name)
        # Options that may be left out are left out, and never given as "None".
        markers = (tyro.conf.DisallowNone, tyro.conf.OmitArgPrefixes)
        about = " ".join((module.__doc__ or "").split("\n\n")[0].split())
        config = tyro.cli(module.Config, prog=prog, description=about, args=arguments, config=markers)
        module.main(config)
    except SystemExit as stop:
        return stop.code if isinstance(stop.code, int) else 1 if stop.code else 0
    except KeyboardInterrupt:
        print(f"{prog}: interrupted", file=sys.stderr)
        return 130
    except BrokenPipeError:
        # Whoever read our output went away; Python would complain again when it flushes at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except (ValueError, TypeError, OSError, ImportError) as error:
        if os.environ.get("TRYON_TRACEBACK"):
            raise
        print(f"{prog}: error: {' '.join(str(error).split())}", file=sys.stderr)
        return 1
    return 0
