"""One page on this machine's own address, for browsers of this machine alone."""

from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

from renderers.checks import UserError

HOST = "127.0.0.1"
HEADERS = {
    "Content-Type": "text/html; charset=utf-8",
    "Cache-Control": "no-store",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
}


def serve(content: str, port: int, ready: Callable[[str], None]) -> None:
    """Answer with one page until Ctrl-C.

    Only what is addressed to this machine by its own names is answered, so that no page of another site can have its
    address point here and read the answer.

    Args:
        port: to listen on at 127.0.0.1; 0 takes one that is free.
        ready: called once with the page's address, when it can be opened.

    Raises:
        UserError: the port is taken or not allowed.
    """
    try:
        server = ThreadingHTTPServer((HOST, port), handler(content.encode()))
    except OSError as error:
        problem = f"cannot listen on {HOST}:{port} ({error.strerror})"
        raise UserError("--port", problem, "give another, or 0 for one that is free") from error
    with server:
        try:
            ready(f"http://{HOST}:{server.server_port}/")
            server.serve_forever(poll_interval=0.2)
        except KeyboardInterrupt:
            pass


def handler(page: bytes) -> type[BaseHTTPRequestHandler]:
    """Answers GET and HEAD of ``/`` with the page, of anything else with 404, of other hosts with 403."""

    class Handler(BaseHTTPRequestHandler):
        timeout = 10  # seconds that a connection may be silent

        def do_GET(self) -> None:
            own = {f"{name}:{self.server.server_port}" for name in (HOST, "localhost")}
            if self.headers.get("Host", "") not in own:
                self.send_error(403)
            elif self.path.partition("?")[0] != "/":
                self.send_error(404)
            else:
                self.send_response(200)
                for name, value in {**HEADERS, "Content-Length": str(len(page))}.items():
                    self.send_header(name, value)
                self.end_headers()
                if self.command == "GET":
                    self.wfile.write(page)

        do_HEAD = do_GET

        def log_message(self, *_: object) -> None:
            """Say nothing of each request."""

    return Handler
