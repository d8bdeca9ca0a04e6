"""A web server of a folder that knows ranges, and fails when it is told to; and failures for another."""

from __future__ import annotations

import http.server
import socket
import threading
from pathlib import Path
from typing import Any


class RangeServer:
    """Serves a folder at ``url`` inside a ``with`` block.

    Attributes:
        requests: number of GET requests.
        failures: statuses to answer the next GET requests with; 0 stands for a connection that is cut half-way.
        knows_ranges: whether ranges are obeyed; else all is sent.
    """

    def __init__(self, folder: Path) -> None:
        self.folder, self.requests = folder, 0
        self.failures: list[int] = []
        self.knows_ranges = True
        self.lock = threading.Lock()

    def __enter__(self) -> RangeServer:
        self.server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), _handler(self))
        self.url = f"http://127.0.0.1:{self.server.server_port}"
        threading.Thread(target=self.server.serve_forever, daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self.server.shutdown()
        self.server.server_close()


class Faulty:
    """A WSGI application that fails when it is told to.

    Attributes:
        failures: statuses to answer the next PUT requests with whose path ends with ``suffix``; 0 stands for a connection that
            is cut.
    """

    def __init__(self, application: Any) -> None:
        self.application = application
        self.failures: list[int] = []
        self.suffix = ""

    def __call__(self, environ: Any, start_response: Any) -> Any:
        hit = environ["REQUEST_METHOD"] == "PUT" and environ["PATH_INFO"].endswith(self.suffix)
        if not self.failures or not hit:
            return self.application(environ, start_response)
        status = self.failures.pop(0)
        if status == 0:
            environ["werkzeug.socket"].shutdown(socket.SHUT_RDWR)
        start_response(f"{status or 500} Failure", [("Content-Length", "0")])
        return [b""]


def _handler(owner: RangeServer) -> type[http.server.BaseHTTPRequestHandler]:
    class Handler(http.server.BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def log_message(self, *_: Any) -> None:
            pass

        def do_HEAD(self) -> None:
            self.answer(False)

        def do_GET(self) -> None:
            self.answer(True)

        def answer(self, get: bool) -> None:
            path = owner.folder / self.path.lstrip("/")
            with owner.lock:
                failure = owner.failures.pop(0) if get and owner.failures else None
                owner.requests += get
            if failure or not path.is_file():
                self.send_response(failure or 404)
                self.send_header("Content-Length", "0")
                self.end_headers()
                return
            content, status = path.read_bytes(), 200
            tag = f'"{path.stat().st_mtime_ns:x}-{len(content):x}"'
            asked = self.headers.get("Range")
            if asked and owner.knows_ranges:
                first, _, last = asked.removeprefix("bytes=").partition("-")
                content, status = content[int(first) : int(last) + 1], 206
            self.send_response(status)
            self.send_header("Content-Length", str(len(content)))
            self.send_header("ETag", tag)
            if owner.knows_ranges:
                self.send_header("Accept-Ranges", "bytes")
            self.end_headers()
            if get:
                if failure == 0:
                    content = content[: len(content) // 2]
                    self.close_connection = True
                self.wfile.write(content)

    return Handler
