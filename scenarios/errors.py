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
        name = f"{error.filename}: " if error.filename and str(error.filename) not in subject else ""
        raise UserError(f"{subject}{': ' if subject else ''}{name}{reason}") from error
    except ValueError as error:
        raise UserError(f"{subject}{': ' if subject else ''}{error}") from error
