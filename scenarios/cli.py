"""The `appli` command. Heavy imports happen inside the commands, so that `appli --help` answers at once."""

from __future__ import annotations

import contextlib
import functools
import io
import re
import signal
import sys
from collections.abc import Callable
from importlib.metadata import version

import tyro

from scenarios.commands import COMMANDS
from scenarios.errors import UserError

DESCRIPTION = "A digital twin of the Clearpath Jackal under ROS's move_base, and APPLI on top of it."


def main(arguments: list[str] | None = None) -> None:
    """Entry point: parse, run, exit."""
    arguments = sys.argv[1:] if arguments is None else arguments
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # so that recordings are closed, as with Ctrl-C
    try:
        code = _dispatch(arguments)
        sys.stdout.flush()
        sys.exit(code)
    except UserError as error:
        print(f"appli: {error}", file=sys.stderr)
        sys.exit(2)
    except BrokenPipeError:  # the reader of our stdout went away (appli ... | head)
        sys.stderr.close()
        sys.exit(1)
    except OSError as error:  # a full disk under stdout
        print(f"appli: {error.strerror or error}", file=sys.stderr)
        sys.stdout = None  # type: ignore[assignment]  # nothing more can be written there
        sys.exit(2)
    except KeyboardInterrupt:
        print("appli: interrupted", file=sys.stderr)
        sys.exit(130)


def _dispatch(arguments: list[str]) -> int:
    """Parse, then run outside the parser."""
    if arguments == ["--version"]:
        print(f"appli-twin {version('appli-twin')}")
        return 0
    call = parse(arguments)
    return 0 if call is None else call()


def parse(arguments: list[str]) -> Callable[[], int] | None:
    """The call that a command line asks for, not yet made; None when it asked for help, which is then on stdout.

    A mistake becomes a UserError of one line.
    """
    commands = {name: _deferred(command) for name, command in COMMANDS.items()}
    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said):
            call: Callable[[], int] = tyro.extras.subcommand_cli_from_dict(
                commands, prog="appli", description=DESCRIPTION, args=arguments or ["--help"]
            )
    except SystemExit as stop:
        if stop.code in (0, None):
            return None
        raise UserError(_one_line(said.getvalue(), arguments[0])) from None
    return call


def _deferred(command: Callable[..., int]) -> Callable[..., Callable[[], int]]:
    """The same signature, but calling it only prepares the call."""

    @functools.wraps(command)
    def prepare(*args: object, **kwargs: object) -> Callable[[], int]:
        return functools.partial(command, *args, **kwargs)

    return prepare


def _one_line(framed: str, command: str) -> str:
    """tyro's framed error without its frame: the complaint, its suggestion, and where to read on."""
    see = f"see: appli {command} --help" if command in COMMANDS else "see: appli --help"
    lines = [re.sub(r"^[│╭╰][─ ]?|[│╮╯]$", "", line).strip() for line in framed.splitlines()]
    parts = [" ".join(part.split()) for part in re.split(r"(?m)^.*[─-]{3,}.*$", "\n".join(lines))]
    parts = [part for part in parts if part]
    if "╭" not in framed:  # a terminal without Unicode: the title is not part of a frame
        parts = parts[1:]
    if not parts:
        return f"cannot read the command line; {see}"
    complaint = re.sub(r"^Missing from (appli\S*(?: \S+)?): (?:STR )?", r"\1 needs: ", parts[0])
    options = re.findall(r"--[a-z][a-z-]+", " ".join(p for p in parts[1:] if p.startswith("Perhaps")))
    maybe = f"; did you mean {options[0]}?" if options else ""
    names = next((p for p in parts[1:] if p.startswith("Available")), "")
    return f"{complaint}{maybe}{'; ' + names if names else ''}; {see}"
