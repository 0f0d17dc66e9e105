"""A user's mistake: one clear line, exit code 2."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


class UserError(Exception):
    """Says in one line what is wrong and what to type next."""


@contextmanager
def blame(subject: str = "") -> Iterator[None]:
    """Turn the ValueErrors and OSErrors of loaders and writers into a UserError that begins with `subject`."""
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        said = str(error.filename or "")  # a .part is what is renamed when it is complete; nobody asked for it
        name = f"{said}: " if said not in subject and not said.endswith(".part") else ""
        raise UserError(f"{subject}{': ' if subject else ''}{name}{reason}") from error
    except ValueError as error:
        raise UserError(f"{subject}{': ' if subject else ''}{error}") from error
