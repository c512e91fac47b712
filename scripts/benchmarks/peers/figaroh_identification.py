"""FIGAROH's identification of a Panda beside `jaxcslc identify`, on the same file in the same run.

    python -m scripts.benchmarks.peers.figaroh_identification

Needs the package `figaroh` (it is not among this project's dependencies). Whole processes from URDF
and CSV to coefficients, each the second of its kind: 20,000 samples of seven joints with torque
noise of 0.05 N m. FIGAROH filters at a cutoff that its user sets, 20 Hz here, takes every tenth
sample as it does by default, and draws nothing; its torque error is of a further fit to every
sample, which is not timed. `jaxcslc` selects its settings, estimates errors and writes its page.
"""

import argparse
import json
import subprocess
import sys
from collections.abc import Iterator, Sequence
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import jaxcslc as jc
from scripts.benchmarks.first_answer import command
from scripts.benchmarks.metrics import Metric, report
from scripts.benchmarks.robot import published, recording_of


jc.enable_x64()

_JOINTS = [f"panda_joint{number}" for number in range(1, 8)]
# The fields that FIGAROH reads of a robot; JSON is YAML.
_CONFIGURATION = {
    "robot": {
        "name": "panda",
        "properties": {
            "joints": {"active_joints": _JOINTS},
            "mechanics": {
                "reduction_ratios": [1.0] * 7,
                "friction_coefficients": {"viscous": [0.0] * 7, "static": [0.0] * 7},
                "actuator_inertias": [0.0] * 7,
                "joint_offsets": [0.0] * 7,
            },
        },
    },
    "tasks": {
        "identification": {
            "enabled": True,
            "problem": {
                "include_external_forces": False,
                "use_joint_torques": True,
                "model_components": {
                    "friction": True,
                    "joint_offset": False,
                    "actuator_inertia": True,
                },
            },
            "signal_processing": {
                "sampling_frequency": 200.0,
                "cutoff_frequency": 20.0,
                "filter_type": "butterworth",
                "filter_order": 4,
            },
        }
    },
}
# Its workflow is a class that reads a recording.
_FIGAROH = """
import json, sys, time
import numpy as np
from figaroh.identification.base_identification import BaseIdentification
from figaroh.tools.load_robot import load_robot

robot_file, configuration, recording, meshes = sys.argv[1:]

class Panda(BaseIdentification):
    def load_trajectory_data(self, data_source=None):
        table = np.loadtxt(recording, delimiter=",", skiprows=1)
        return {
            "timestamps": table[:, :1],
            "positions": table[:, 1:8],
            "velocities": None,
            "accelerations": None,
            "torques": table[:, 8:],
        }

imports = time.process_time()
fit = Panda(load_robot(robot_file, package_dirs=meshes), configuration)
fit.identif_config["act_idxq"] = fit.identif_config["act_idxv"] = list(range(7))
fit.initialize()
fit.solve(plotting=False)
processor = time.process_time()
fit.solve(decimate=False, plotting=False)
print()
print(json.dumps([processor, processor - imports, float(fit.rms_error)]))
"""


def installed() -> bool:
    """Return whether the peer is."""
    return find_spec("figaroh") is not None


def metrics() -> Iterator[Metric]:
    """Processor time of both and torque errors over all samples; nothing without the peer."""
    if not installed():
        return
    robot = published("panda.urdf")
    with TemporaryDirectory() as name:
        folder = Path(name)
        recording = folder / "train.csv"
        jc.save_recording(recording_of(robot, "panda_hand"), recording)
        configuration = folder / "panda.yaml"
        configuration.write_text(json.dumps(_CONFIGURATION), encoding="utf-8")
        # The hand's fingers do not move.
        rigid = folder / "panda.urdf"
        text = robot.read_text(encoding="utf-8").replace('type="prismatic"', 'type="fixed"')
        rigid.write_text(text, encoding="utf-8")
        theirs = [_FIGAROH, str(rigid), str(configuration), str(recording), str(robot.parents[4])]
        out = folder / "out"
        ours = ("identify", str(robot), "--tip", "panda_hand", str(recording), "-o", str(out))
        for timed in (False, True):
            processor, fit, error = _figaroh(theirs)
            used, _ = command(folder, *ours)
            if timed:
                yield Metric("figaroh.processor", processor, "s", "lower", 0.5)
                yield Metric("figaroh.without_imports", fit, "s", "lower", 0.5)
                yield Metric("figaroh.torque_error", error, "N m", "lower")
                yield Metric("figaroh.jaxcslc.processor", used, "s", "lower", 0.5)
        document = json.loads((out / "identification.json").read_text(encoding="utf-8"))
        errors = np.array(document["torque_error_rms_all_samples"]["training"])
        error = float(np.sqrt(np.mean(errors**2)))
        yield Metric("figaroh.jaxcslc.torque_error", error, "N m", "lower")


def _figaroh(arguments: Sequence[str]) -> list[float]:
    """Processor time of the process and of all but its imports [s], torque error [N m].

    **Raises** `subprocess.CalledProcessError` if it fails.
    """
    program = [sys.executable, "-W", "ignore", "-c", *arguments]
    done = subprocess.run(program, check=True, capture_output=True, text=True)
    return json.loads(done.stdout.splitlines()[-1])


def main(argv: Sequence[str] | None = None) -> int:
    argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0]).parse_args(argv)
    if not installed():
        print("needs the package figaroh")
        return 1
    report(list(metrics()), {})
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
