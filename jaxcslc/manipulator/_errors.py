"""Error class for robot descriptions that cannot be used."""


class RobotError(ValueError):
    """A robot description that cannot be read, is contradictory, or is incomplete.

    The message is one line: which file or argument, which joint or key, what it is and what
    was expected.
    """
