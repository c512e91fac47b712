"""The process of the command: how it ends."""

import os
import shlex
import subprocess
import sys
import time
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


_COMPILING = """
import time
from jaxcslc._processes import processes_beside
from jaxcslc.codegen._c_function import LONG, CFunction

with processes_beside():
    assert not CFunction("void nothing(long n) {}", "nothing", (LONG,)).is_kept
time.sleep(0.2)
"""


def test_a_compiler_that_hangs_ends_with_the_process(tmp_path: Path) -> None:
    """Whatever it started ends too, and nothing is left where compiled code is kept."""
    compiler = tmp_path / "cc"
    compiler.write_text(f"#!/bin/sh\nsleep 987 &\necho $! > {tmp_path}/child\nwait\n")
    compiler.chmod(0o755)
    environment = dict(os.environ, CC=str(compiler), XDG_CACHE_HOME=str(tmp_path / "cache"))
    start = time.monotonic()
    subprocess.run([sys.executable, "-c", _COMPILING], env=environment, check=True, timeout=60)
    assert time.monotonic() - start < 20.0  # mostly imports, on a busy machine; not the compiler
    child = Path("/proc", (tmp_path / "child").read_text().strip(), "status")
    assert not child.exists() or "zombie" in child.read_text()
    assert list((tmp_path / "cache" / "jaxcslc").iterdir()) == []


@pytest.mark.parametrize(
    ("redirection", "status", "error"),
    [
        (">/dev/full", 2, "jaxcslc: [Errno 28] No space left on device: 'standard output'"),
        (">&-", 0, ""),
        ("2>/dev/full >&2", 2, ""),
    ],
)
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
def test_a_full_or_closed_output_is_named(redirection: str, status: int, error: str) -> None:
    line = f"{shlex.quote(sys.executable)} -m jaxcslc --help {redirection}"
    done = subprocess.run(["sh", "-c", line], capture_output=True, text=True, env=dict(os.environ))
    assert done.returncode == status
    assert done.stderr.startswith(error) and "Traceback" not in done.stderr
    assert done.stderr.count("\n") == bool(error)


@pytest.mark.skipif(sys.platform != "linux", reason="MuJoCo is run beside the command on Linux")
def test_a_crash_of_mujoco_is_one_line(tmp_path: Path) -> None:
    """It is made to crash: the files that are known to do so are refused before."""
    program = """
import os, signal
from jaxcslc.cli import main
from jaxcslc.manipulator.files import _mujoco_reader

_mujoco_reader._read = lambda *_: os.kill(os.getpid(), signal.SIGSEGV)
main()
"""
    (tmp_path / "arm.xml").write_text("<mujoco/>")
    command = [sys.executable, "-c", program, "derive", "arm.xml"]
    done = subprocess.run(
        command, cwd=tmp_path, capture_output=True, text=True, env=dict(os.environ)
    )
    line = "jaxcslc: arm.xml: MuJoCo cannot read it: its process ended by SIGSEGV"
    assert (done.returncode, done.stderr) == (
        2,
        f"{line} ({Path(__file__).parents[1]}/docs/robots.md)\n",
    )
