_LONGEST = 300


def one_line(error: Exception) -> str:
    """An error's message on one line, cut where it quotes a file's bytes at length."""
    text = " ".join(str(error).split())
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]} ..."
