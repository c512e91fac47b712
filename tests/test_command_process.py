"""The process of the command: how it ends."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import jaxcslc as jc


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


def test_no_result_is_lost_to_surroundings(tmp_path: Path) -> None:
    """A name that is no UTF-8, a terminal that has ASCII alone, a CC that is no command line, and
    JAX's debugging switches."""
    folder = tmp_path / os.fsdecode(b"arm\xff")
    folder.mkdir()
    arm = "gravity = [0, -9.81, 0]\n[[joint]]\n"
    (folder / "arm.toml").write_text(arm)
    network = jc.derive(jc.load_robot(folder / "arm.toml"))
    time = 0.01 * np.arange(600)
    q, qdd = np.sin(3.0 * time)[:, None], -9.0 * np.sin(3.0 * time)[:, None]
    torque = np.asarray(network.torque(np.linspace(0.5, 1.5, network.size), q, q, qdd))
    jc.save_recording(jc.Recording(time, q, torque), folder / "log.csv")
    command = [sys.executable, "-m", "jaxcslc", "identify", "arm.toml", "log.csv", "-o", "results"]
    environment = dict(os.environ, PYTHONIOENCODING="ascii", CC='"cc')
    environment |= {"JAX_TRANSFER_GUARD": "disallow", "JAX_DEBUG_INFS": "1", "JAX_DEBUG_NANS": "1"}
    done = subprocess.run(command, cwd=folder, capture_output=True, env=environment)
    assert done.returncode == 0, done.stderr
    assert b"\\u2713" in done.stdout  # a tick
    assert (folder / "results" / "index.html").exists()
