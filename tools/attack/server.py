"""HTTP servers on the loopback interface that cut, stall and lie."""

from __future__ import annotations

import threading
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pathlib import Path

# The ways in which an answer may lie; each answer may also end early.
LIES = (
    *("longer", "shorter", "no length", "no number", "missing", "broken", "gzip", "page"),
    *("circle", "elsewhere", "ranges", "drips", "no answer", "long head"),
)
CAMERA = "multipart/x-mixed-replace; boundary=frame"  # the type of images that a camera sends
_PAGE = b"<!doctype html><title>404</title><p>not here"


class Server(ThreadingHTTPServer):
    """Serves one file.

    The server sends a share of the file, 0 to 1. If it `stalls`, the connection then stays open,
    as if more would come. `lie` is one of `LIES`, or empty; `kind` is the type of the content.
    """

    daemon_threads = True

    def __init__(
        self, path: Path, share: float, *, stalls: bool = False, lie: str = "", kind: str = ""
    ) -> None:
        over = self._over = threading.Event()

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                data = path.read_bytes()
                with suppress(OSError):
                    if not _answer(self, data, lie, kind):
                        return
                    if lie == "drips":
                        size = 1 + len(data) // 2000
                        for start in range(0, int(share * len(data)), size):
                            self.wfile.write(data[start : start + size])
                            if over.wait(0.002):
                                return
                    else:
                        self.wfile.write(data[: int(share * len(data))])
                    if stalls:
                        over.wait(20)

            def log_message(self, *_: Any) -> None:
                """Print nothing."""

        super().__init__(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self.server_port}/{path.name}"

    def handle_error(self, *_: Any) -> None:
        """Print nothing if the client has closed the connection."""

    def __enter__(self) -> Server:
        threading.Thread(target=self.serve_forever, daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self.shutdown()
        self.server_close()


def _answer(handler: BaseHTTPRequestHandler, data: bytes, lie: str, kind: str) -> bool:
    """Send the head of an answer; return whether the content of the file follows."""
    if lie == "no answer":
        handler.close_connection = True
        return False
    if lie in {"circle", "elsewhere"}:
        handler.send_response(302)
        place = handler.path if lie == "circle" else "file:///etc/passwd"
        handler.send_header("Location", place)
        handler.end_headers()
        return False
    if lie in {"missing", "broken", "page"}:
        handler.send_response({"missing": 404, "broken": 500, "page": 200}[lie])
        handler.send_header("Content-Length", str(len(_PAGE)))
        handler.end_headers()
        handler.wfile.write(_PAGE)
        return False
    size = len(data)
    handler.send_response(206 if lie == "ranges" else 200)
    if lie == "ranges":
        handler.send_header("Content-Range", f"bytes {size}-{size * 9}/{size // 3}")
    if kind:
        handler.send_header("Content-Type", kind)
    if lie == "gzip":
        handler.send_header("Content-Encoding", "gzip")
    if lie == "long head":
        for number in range(500):
            handler.send_header(f"X-{number}", "x" * 200)
    length = {"longer": size * 7, "shorter": size // 2, "no number": "many"}.get(lie, size)
    if lie != "no length":
        handler.send_header("Content-Length", str(length))
    handler.end_headers()
    return True
