"""The reference of the command is that of the command."""

from scripts.tools.command_page import PAGE, command_page


def test_the_page_is_up_to_date() -> None:
    """Written anew by `python -m scripts.tools.command_page`."""
    assert PAGE.read_text("utf-8") == command_page()
