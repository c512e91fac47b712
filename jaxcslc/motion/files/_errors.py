def one_line(error: Exception) -> str:
    """An error's message on one line."""
    return " ".join(str(error).split())
