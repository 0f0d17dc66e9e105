"""A user's mistake: one clear line, exit code 2."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


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


@contextmanager
def one_line_errors() -> Iterator[None]:
    """For scripts such as those in examples/: a mistake ends them with one line and exit code 2, Ctrl-C with 130."""
    try:
        yield
    except (UserError, ValueError, OSError) as error:
        print(f"{Path(sys.argv[0]).stem}: {error}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        sys.exit(130)
