"""Text that others wrote, made safe to print: a control character is shown, never obeyed.

Names of vehicles, topics and files, reasons of records and answers of stores may hold anything. A
terminal obeys some of it: it clears the screen, sets the clipboard, or reverses the order of text.
"""

from typing import Final

NEWLINES: Final = "\n"
"""To keep where a text has lines of its own, such as a traceback."""


def visible(text: str, *, keep: str = "") -> str:
    r"""Return the text with each character that does not print written as Python escapes it.

    Control characters, C1 among them, direction marks, separators of lines and halves of surrogate
    pairs do not print: ESC becomes `\x1b`, U+202E becomes `\u202e`. A space prints.

    Args:
        text: What somebody else may have written.
        keep: Characters that stay although they do not print.
    """
    if text.isprintable():
        return text
    return "".join(
        char if char.isprintable() or char in keep else char.encode("unicode_escape").decode()
        for char in text
    )
