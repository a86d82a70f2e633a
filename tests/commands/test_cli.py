import os
import subprocess
import sys
import textwrap

import pytest

import tryon_jax
from tryon_jax.cli import Command, dispatch, find_commands, main


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A package `trials` of two commands and a helper, made for one test."""
    folder = tmp_path / "trials"
    folder.mkdir()
    (folder / "__init__.py").write_text("")
    (folder / "helper.py").write_text('"""No command: it has no main."""\nraise RuntimeError("imported")\n')
    (folder / "measure_cloth.py").write_text(
        textwrap.dedent(
            '''\
            """Measure cloth.

            With care.
            """

            from dataclasses import dataclass


            @dataclass(frozen=True)
            class Config:
                length: float = 1.0
                """Length in metres."""
                sleeve_width: float = 0.2
                """Width in metres."""


            def main(config):
                if config.length < 0:
                    raise ValueError(f"length = {config.length:g} m is outside\\nits range 0 to 3 m")
                print("length", config.length)
            '''
        )
    )
    header = "from dataclasses import dataclass\n@dataclass\nclass Config:\n    size: int = 1\n"
    (folder / "textiles").mkdir()
    (folder / "textiles" / "__init__.py").write_text("")
    (folder / "textiles" / "weigh.py").write_text(f'"""Weigh cloth."""\n{header}def main(config): print(config.size)\n')
    (folder / "broken.py").write_text(f'"""Broken."""\n{header}def main(config): return 1 / 0\n')
    monkeypatch.syspath_prepend(tmp_path)
    yield "trials"
    for name in [name for name in sys.modules if name.startswith("trials")]:
        del sys.modules[name]


def test_commands_are_the_modules_with_a_main(package):
    assert find_commands(package) == {
        "broken": Command("trials.broken", "Broken."),
        "measure_cloth": Command("trials.measure_cloth", "Measure cloth."),
        "weigh": Command("trials.textiles.weigh", "Weigh cloth."),
    }


def test_a_command_in_a_folder_runs_by_its_name(package, capsys):
    assert dispatch("try", package, ["weigh", "--size", "3"]) == 0
    assert capsys.readouterr().out == "3\n"


def test_two_commands_of_one_name_are_refused(package, tmp_path):
    (tmp_path / package / "textiles" / "broken.py").write_text("def main(config): pass\n")
    with pytest.raises(ImportError, match=r"'broken' is in trials\.broken and in trials\.textiles\.broken"):
        find_commands(package)


def test_a_command_runs_with_its_options(package, capsys):
    assert dispatch("try", package, ["measure-cloth", "--length", "2"]) == 0
    assert capsys.readouterr().out == "length 2.0\n"


def test_help_lists_commands_and_no_command_is_an_error(package, capsys):
    assert dispatch("try", package, ["--help"]) == 0
    assert "measure_cloth  Measure cloth." in capsys.readouterr().out
    assert dispatch("try", package, []) == 2


def test_help_of_a_command_explains_its_options(package, capsys):
    assert dispatch("try", package, ["measure_cloth", "--help"]) == 0
    out = capsys.readouterr().out
    assert "--sleeve-width" in out
    assert "Length in metres." in out


def test_an_unknown_command_names_near_ones(package, capsys):
    assert dispatch("try", package, ["measure_clth"]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert "unknown command 'measure_clth' (did you mean measure_cloth?); known: broken, measure_cloth" in err


def test_an_unknown_option_names_near_ones(package, capsys):
    assert dispatch("try", package, ["measure_cloth", "--sleeve-widht", "1"]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert "--sleeve-width" in captured.err


def test_what_is_wrong_is_said_in_one_line(package, capsys):
    assert dispatch("try", package, ["measure_cloth", "--length", "-1"]) == 1
    assert capsys.readouterr().err == ("try measure_cloth: error: length = -1 m is outside its range 0 to 3 m\n")


def test_a_bug_keeps_its_traceback(package):
    with pytest.raises(ZeroDivisionError):
        dispatch("try", package, ["broken"])


def test_the_traceback_of_a_bad_request_is_there_on_demand(package, monkeypatch):
    monkeypatch.setenv("TRYON_TRACEBACK", "1")
    with pytest.raises(ValueError, match="length = -1"):
        dispatch("try", package, ["measure_cloth", "--length", "-1"])


def test_version(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"tryon_jax {tryon_jax.__version__}\n"


@pytest.mark.parametrize("package", ["tryon_jax.commands", "experiments", "benchmarks"])
def test_every_command_of_ours_has_a_help_line(package):
    assert all(command.about for command in find_commands(package).values())


def test_an_unknown_experiment_fails(request):
    command = [sys.executable, "-m", "experiments", "no_such_experiment"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=request.config.rootpath)
    assert done.returncode == 2
    assert "unknown command 'no_such_experiment'" in done.stderr


def test_unknown_options_before_a_command_are_corrected(capsys):
    assert main(["--verison"]) == 2
    assert "unknown option '--verison' (did you mean --version?)" in capsys.readouterr().err


def test_lists_name_everything_that_can_be_asked_for(capsys):
    assert main(["list"]) == 0
    out = capsys.readouterr().out
    knit = "gray-interlock: medium (187 g/m²), stretchy, soft"
    for word in ("presets  ", "dress", "sleeve_length", knit, "neutral", "±3", "stature"):
        assert word in out


@pytest.mark.slow
@pytest.mark.parametrize("encoding", ["ascii"])
def test_an_ascii_terminal_shows_what_it_can(tmp_path, encoding):
    """With a reader that goes away at once the file is written all the same."""
    command = [sys.executable, "-m", "tryon_jax", "pattern", "--target-area", "0.002", "--out", str(tmp_path / "a.obj")]
    environment = os.environ | {"PYTHONIOENCODING": encoding, "JAX_PLATFORMS": "cpu"}
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "fabric" in done.stdout
    assert (tmp_path / "a.obj").exists()
