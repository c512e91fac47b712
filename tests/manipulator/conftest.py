"""Fixtures of the robots' tests: mistakes as a user makes them."""

import json
import subprocess
import sys
from collections.abc import Callable, Sequence
from typing import Any

import pytest


Call = tuple[str, dict[str, Any]]
Outcome = tuple[str, str]

PROGRAM = """
import json, sys
from jaxcslc.manipulator import LinkInertia, Manipulator, load_robot

def tuples(value):
    return tuple(map(tuples, value)) if isinstance(value, list) else value

functions = {"load_robot": load_robot, "from_modified_dh": Manipulator.from_modified_dh,
             "LinkInertia": LinkInertia}
for line in sys.stdin:
    name, arguments = json.loads(line)
    try:
        functions[name](**{key: tuples(value) for key, value in arguments.items()})
        outcome = "no error", ""
    except Exception as error:
        outcome = type(error).__name__, str(error)
    print(json.dumps(outcome))
"""

# A robot file with every key but those of whole robots' defaults.
ARM = """
name = "arm"
about = "a turntable with a slide"
gravity = [0, 0, -9.81]
friction = ["viscous", "offset"]

[lengths]
a1 = 0.25

[links]
inertia = "principal"
motor_inertia = true

[[joint]]
d = 0.4
theta = 0.1
viscous = 1.5
[joint.link]
zero = ["rx", "ry"]
equal = [["Ixx", "Iyy"]]
mass = 2.0
centre_of_gravity = [0, 0, 0.1]
inertia_tensor = [0.2, 0.2, 0.1]
motor_inertia = 0.3

[[joint]]
kind = "P"
alpha = "-pi/2"
a = "a1"
viscous = 2.5
[joint.link]
inertia = "full"
motor = false
mass = 1.0
centre_of_gravity = [0.1, 0, 0]
inertia_tensor = [[0.1, 0.01, 0], [0.01, 0.2, 0], [0, 0, 0.3]]
"""


@pytest.fixture(scope="session")
def outcomes() -> Callable[[Sequence[Call]], list[Outcome]]:
    """Calls functions in a separate process: what they raise, and its message.

    In a test run annotations are checked, which would stop many a wrong value before the function
    sees it. Users run without, and must get the library's message.
    """

    def run(calls: Sequence[Call]) -> list[Outcome]:
        lines = "\n".join(json.dumps(call) for call in calls)
        done = subprocess.run(
            [sys.executable, "-c", PROGRAM],
            input=lines,
            capture_output=True,
            text=True,
            encoding="utf-8",
            check=True,
        )
        outcomes_of_calls = [tuple(json.loads(line)) for line in done.stdout.splitlines()]
        assert len(outcomes_of_calls) == len(calls)
        return outcomes_of_calls

    return run
