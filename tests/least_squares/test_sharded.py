"""Patterns spread over devices and processes: the fit is that of one device."""

import os
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose


PROGRAM = Path(__file__).with_name("sharded_fit.py")
# Of a factorisation of some 10^3 rows.
_ROUNDING = 1e-11


def free_port() -> str:
    with socket.socket() as probe:
        probe.bind(("localhost", 0))
        return str(probe.getsockname()[1])


@pytest.mark.parametrize("processes", [1, 2])
def test_fit_of_four_devices(tmp_path: Path, processes: int) -> None:
    out = tmp_path / "fits.npy"
    port = free_port()
    commands = [
        [sys.executable, str(PROGRAM), str(out), *([port, str(rank)] if processes > 1 else [])]
        for rank in range(processes)
    ]
    devices = f"--xla_force_host_platform_device_count={4 // processes}"
    flags = f"{os.environ.get('XLA_FLAGS', '')} {devices}".strip()
    environment = {**os.environ, "XLA_FLAGS": flags, "JAX_PLATFORMS": "cpu"}
    environment["PYTHONPATH"] = str(PROGRAM.parents[3])
    running = [
        subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=environment)
        for command in commands
    ]
    messages = [process.communicate(timeout=300)[1] for process in running]
    assert [process.returncode for process in running] == [0] * processes, messages
    sharded, whole = np.load(out)
    assert_allclose(sharded, whole, atol=_ROUNDING)
