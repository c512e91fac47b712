"""How often recordings are said to disagree."""
