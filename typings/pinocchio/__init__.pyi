# Compiled, and installed where a type checker does not look: every name is there, nothing is known.
from typing import Any

def __getattr__(name: str) -> Any: ...
