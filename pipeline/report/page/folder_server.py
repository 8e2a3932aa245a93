"""HTTP server for a folder with a page, restricted to browsers on this machine.

Any local program or web page can send requests. Only GET and HEAD of regular files of known types inside the
folder are answered, and only for host names of this machine. The host check prevents DNS rebinding, where a
foreign page resolves its own name to 127.0.0.1.
"""

from __future__ import annotations

import gzip
from collections.abc import Mapping
from functools import lru_cache
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import unquote

from scanloom.pipeline.report.page.codes import MACHINE_PORT_TAKEN
from scanloom.stages.diagnostics.errors import InputError, StageError
from scanloom.stages.files.codes import FILE_PATH_INVALID
from scanloom.stages.files.input_files import read_input_bytes
from scanloom.stages.lod.tiles import PAGE_INDEX

HOST = "127.0.0.1"
# Content types of served files; files of other types are not found.
_CONTENT_TYPES = {
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".txt": "text/plain; charset=utf-8",
    ".json": "application/json",
    ".glb": "model/gltf-binary",
}
# Types sent with gzip; tiles hardly compress.
_COMPRESSED_SUFFIXES = (".html", ".js", ".txt", ".json")
# Seconds after which an idle connection is closed.
_IDLE_TIMEOUT = 30.0


class FolderServer(ThreadingHTTPServer):
    """HTTP server on 127.0.0.1 for the files of one folder and some in-memory files.

    Parameters
    ----------
    folder : served folder, never written to.
    port : port to listen on; 0 for any free port.
    extra_files : contents by path, served if the folder has no such file.

    Raises
    ------
    InputError
        If the folder does not exist.
    StageError
        If the port is in use or refused by the system.
    """

    daemon_threads = True

    def __init__(self, folder: Path, port: int = 0, extra_files: Mapping[str, bytes] | None = None) -> None:
        if not folder.is_dir():
            raise InputError(FILE_PATH_INVALID, "there is no such folder.", folder)
        self.folder = folder.resolve()
        self.extra_files = dict(extra_files or {})
        try:
            super().__init__((HOST, port), _Handler)
        except (OSError, OverflowError) as error:
            said = getattr(error, "strerror", None) or str(error)
            raise StageError(
                MACHINE_PORT_TAKEN, "cannot listen on port {port}: {said}.", port=port, said=said
            ) from error

    @property
    def address(self) -> str:
        """URL of the page."""
        return f"http://{HOST}:{self.server_port}/"

    def get_content(self, path: str) -> bytes | None:
        """Return the content at a path below the folder, or None.

        Links are not followed.
        """
        parts = path.split("/")
        if any(part in ("", ".", "..") or "\\" in part or "\0" in part for part in parts):
            return None
        file = self.folder.joinpath(*parts)
        try:
            if file.resolve(strict=True) == file:
                return read_input_bytes(file)
        except (OSError, ValueError, RuntimeError):
            pass
        return self.extra_files.get(path)

    def handle_error(self, request: object, client_address: object) -> None:
        """Ignore closed connections and malformed requests."""


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    server_version, sys_version = "scanloom", ""
    timeout = _IDLE_TIMEOUT
    server: FolderServer

    def do_GET(self) -> None:
        self._send_answer(with_body=True)

    def do_HEAD(self) -> None:
        self._send_answer(with_body=False)

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002
        """Suppress the request log."""

    def _send_answer(self, *, with_body: bool) -> None:
        hosts = self.headers.get_all("Host") or []
        if "Content-Length" in self.headers or "Transfer-Encoding" in self.headers:
            # The unread body would be parsed as the next request.
            self.close_connection = True
        if len(hosts) != 1 or hosts[0].strip().lower() not in self._list_host_names():
            self._refuse(HTTPStatus.MISDIRECTED_REQUEST)
            return
        if not self.path.startswith("/"):
            self._refuse(HTTPStatus.BAD_REQUEST)
            return
        asked = self.path.partition("#")[0].partition("?")[0]
        try:
            path = unquote(asked, errors="strict")[1:] or PAGE_INDEX
        except UnicodeDecodeError:
            self._refuse(HTTPStatus.NOT_FOUND)
            return
        suffix = Path(path).suffix
        content = self.server.get_content(path) if suffix in _CONTENT_TYPES else None
        if content is None:
            self._refuse(HTTPStatus.NOT_FOUND)
            return
        self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", _CONTENT_TYPES[suffix])
        if suffix in _COMPRESSED_SUFFIXES:
            self.send_header("Vary", "Accept-Encoding")
            if "gzip" in self.headers.get("Accept-Encoding", ""):
                self.send_header("Content-Encoding", "gzip")
                content = _compress(content)
        self._send_content(content, with_body=with_body)

    def _list_host_names(self) -> set[str]:
        port = self.server.server_port
        names = {f"{HOST}:{port}", f"localhost:{port}"}
        return names | {HOST, "localhost"} if port == 80 else names

    def _refuse(self, status: HTTPStatus) -> None:
        self.close_connection = True
        self.send_response(status)
        self.send_header("Content-Type", _CONTENT_TYPES[".txt"])
        self.send_header("Connection", "close")
        self._send_content(f"{status.phrase}\n".encode(), with_body=self.command != "HEAD")

    def _send_content(self, content: bytes, *, with_body: bool) -> None:
        self.send_header("Content-Length", str(len(content)))
        self.send_header("Cache-Control", "no-cache")
        self.send_header("X-Content-Type-Options", "nosniff")
        self.send_header("Cross-Origin-Resource-Policy", "same-origin")
        self.end_headers()
        if with_body:
            self.wfile.write(content)


@lru_cache(maxsize=32)
def _compress(content: bytes) -> bytes:
    return gzip.compress(content, 6, mtime=0)
