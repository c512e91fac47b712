class MachineError(ValueError):
    """A machine, or a trajectory for one, that cannot exist.

    The message is one line: which field and joint, what was found and what was expected.
    """
