class DescriptionError(ValueError):
    """A system that is described wrongly; the message is one line: where, what, what was expected.

    >>> from jaxcslc.systems import DescriptionError
    >>> issubclass(DescriptionError, ValueError)
    True
    """
