"""Identification of robot dynamics with context-sensitive linear combiners (CSLC), in JAX.

A robot's inverse dynamics are derived exactly, as a network that is linear in its coefficients.
The coefficients are identified from recordings of motion and torque.

     robot file --> manipulator --> derivation --> network ----+
                                                               |
     log ---------> recordings (smoothing, masks) --> patterns +--> estimators --> report
                                                                                     |
          export, control, payload, excitation (the next motion) <-------------------+

A name of `__init__.pyi`, or a package, is loaded when it is first used: `import jaxcslc` alone is
quick.
Start with `load_robot`, `derive`, `load_recording` and `identify`.
"""

import lazy_loader


_attribute, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> object:
    """Load a public name, or read the version from the metadata."""
    if name == "__version__":
        from importlib.metadata import version  # takes 20 ms, and few ask for it

        return version(__name__)
    return _attribute(name)
