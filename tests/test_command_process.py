"""The process of the command: how it ends."""

import os
import subprocess
import sys

import pytest


_PROGRAM = """
import atexit

from jaxcslc.cli import _process, main

prepare_process = _process.prepare_process


def prepare():
    prepare_process()
    atexit.register(print, "at the end")


_process.prepare_process = prepare
main()
"""


@pytest.mark.parametrize(
    ("arguments", "status", "printed"),
    [(["--version"], 0, "0."), (["derive", "no such robot.toml"], 2, "jaxcslc: no such robot")],
)
def test_a_process_ends_with_the_status_of_its_command(
    arguments: list[str], status: int, printed: str
) -> None:
    command = [sys.executable, "-c", _PROGRAM, *arguments]
    done = subprocess.run(command, capture_output=True, text=True, env=dict(os.environ))
    assert done.returncode == status
    assert printed in done.stdout + done.stderr
    # What others have registered for the end is done, and what they print is not lost.
    assert done.stdout.endswith("at the end\n")


def test_python_runs_the_command() -> None:
    command = [sys.executable, "-m", "jaxcslc", "--version"]
    done = subprocess.run(command, capture_output=True, text=True, env=dict(os.environ))
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("0.")


def test_ctrl_c_in_a_command_is_said() -> None:
    """typer ends a command that Ctrl-C interrupts by a status alone."""
    program = """
import jaxcslc.cli._inputs as options
from jaxcslc.cli import main

def interrupted(*_, **__):
    raise KeyboardInterrupt

options.load_robot = interrupted
main()
"""
    command = [sys.executable, "-c", program, "derive", "arm.toml"]
    done = subprocess.run(command, capture_output=True, text=True, env=dict(os.environ))
    assert (done.returncode, done.stderr) == (130, "jaxcslc: interrupted\n")
