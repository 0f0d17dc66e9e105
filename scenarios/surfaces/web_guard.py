"""Who may talk to the teleop page's web server. The only doorway to websockets."""

from __future__ import annotations

import math
import socket
import time
from typing import Any
from urllib.parse import urlsplit

from websockets.asyncio.server import ServerConnection, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from scenarios.errors import UserError


class Guard:
    """Stands before Studio's web server: which requests get through, and when the driver's page last sent input."""

    def __init__(self, address: str) -> None:
        """For a server that listens on `address`."""
        self._loopback = address.startswith("127.") or address == "::1"
        self.last_input = -math.inf  # [s] time.monotonic

    def refuses(self, request: Request) -> Response | None:
        """403 for what no page of ours asks: uploads, other sites' scripts, and names rebound to this machine."""
        host = request.headers.get("Host", "")
        name = urlsplit(f"//{host}").hostname or ""
        origin = request.headers.get("Origin")
        foreign = origin is not None and urlsplit(origin).netloc != host
        rebound = self._loopback and not (name in ("localhost", "::1") or name.startswith("127."))
        if foreign or rebound or request.path.split("?")[0] == "/drop":
            return Response(403, "Forbidden", Headers({"Content-Length": "0"}), b"")
        return None

    def serve(self, handler: Any, *, process_request: Any, **options: Any) -> Any:
        """`websockets.serve` with the guard in front."""
        guard = self

        class Watched(ServerConnection):
            async def recv(self, *args: Any, **kwargs: Any) -> Any:
                driver = self.request is not None and self.request.path.startswith("/ui")
                try:
                    message = await super().recv(*args, **kwargs)
                except ConnectionClosed:
                    if driver:
                        guard.last_input = -math.inf  # at once, without waiting for silence
                    raise
                if driver:
                    guard.last_input = time.monotonic()
                return message

        def check(connection: ServerConnection, request: Request) -> Any:
            return guard.refuses(request) or process_request(connection, request)

        return serve(handler, process_request=check, create_connection=Watched, **options)


def listen(address: str, port: int) -> socket.socket:
    """A socket bound to one address."""
    listener = socket.socket(socket.AF_INET6 if ":" in address else socket.AF_INET, socket.SOCK_STREAM)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((address, port))
        listener.listen()  # whoever follows the URL at once waits a moment instead of being turned away
    except OSError as error:
        listener.close()
        reason = error.strerror or str(error)
        raise UserError(f"cannot listen on {address} port {port}: {reason}; try --port 0 for any free port") from None
    return listener
