"""How often `jaxcslc check` names the cause of a spoilt recording, and how often it errs."""
