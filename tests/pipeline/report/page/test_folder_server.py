"""The folder server serves only that folder and only to this machine, for every request."""

from __future__ import annotations

import contextlib
import gzip
import os
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest
from browsers import run_server

from scanloom.pipeline.report.page.folder_server import FolderServer
from scanloom.stages.diagnostics.errors import InputError, StageError

SECRET = b"secret of somebody else"


@pytest.fixture
def server(tmp_path: Path) -> Iterator[FolderServer]:
    """Start a server of a folder that has neighbours, links and special files."""
    folder = tmp_path / "shown"
    (folder / "tiles").mkdir(parents=True)
    (folder / "tileset.json").write_bytes(b'{"asset": {}}')
    (folder / "tiles" / "0.glb").write_bytes(b"glTF")
    (folder / "tiles" / "a b.glb").write_bytes(b"space")
    (folder / "notes").write_bytes(SECRET)
    (folder / "key.pem").write_bytes(SECRET)
    (tmp_path / "secret.json").write_bytes(SECRET)
    (tmp_path / "shown-too").mkdir()
    (tmp_path / "shown-too" / "secret.json").write_bytes(SECRET)
    (folder / "link.json").symlink_to(tmp_path / "secret.json")
    (folder / "out").symlink_to(tmp_path)
    (folder / "loop.json").symlink_to("loop.json")
    os.mkfifo(folder / "pipe.json")
    (folder / "folder.json").mkdir()
    with run_server(
        FolderServer(folder, extra_files={"index.html": b"<!doctype html>", "tileset.json": b"other"})
    ) as one:
        yield one


def send_request(server: FolderServer, request: bytes) -> tuple[int, dict[str, str], bytes]:
    """Send raw bytes; return status, headers and body of the first response."""
    with socket.create_connection(("127.0.0.1", server.server_port), timeout=20) as line:
        line.sendall(request)
        line.shutdown(socket.SHUT_WR)
        found = b""
        while part := line.recv(65536):
            found += part
    head, _, body = found.partition(b"\r\n\r\n")
    status, *lines = head.decode("latin-1").split("\r\n")
    words = status.split(" ")
    if not words[0].startswith("HTTP/"):
        return 0, {}, found
    return int(words[1]), {k.lower(): v for k, _, v in (line.partition(": ") for line in lines)}, body


def get_path(
    server: FolderServer, path: str | bytes, *more: str, method: str = "GET", host: str | None = None
) -> tuple[int, dict[str, str], bytes]:
    host = f"127.0.0.1:{server.server_port}" if host is None else host
    path = path.encode("latin-1") if isinstance(path, str) else path
    lines = [f"Host: {host}", *more, "Connection: close"]
    return send_request(
        server, b"%s %s HTTP/1.1\r\n" % (method.encode(), path) + "\r\n".join(lines).encode() + b"\r\n\r\n"
    )


@pytest.mark.parametrize(
    ("path", "kind", "content"),
    [
        ("/", "text/html; charset=utf-8", b"<!doctype html>"),
        ("/index.html?x=1", "text/html; charset=utf-8", b"<!doctype html>"),
        ("/tileset.json", "application/json", b'{"asset": {}}'),
        ("/tiles/0.glb", "model/gltf-binary", b"glTF"),
        ("/tiles/a%20b.glb", "model/gltf-binary", b"space"),
    ],
)
def test_files_of_the_folder_are_given(server: FolderServer, path: str, kind: str, content: bytes) -> None:
    status, headers, body = get_path(server, path)
    assert (status, headers["content-type"], body) == (200, kind, content)
    assert headers["x-content-type-options"] == "nosniff"
    status, headers, body = get_path(server, path, method="HEAD")
    assert (status, int(headers["content-length"]), body) == (200, len(content), b"")
    assert get_path(server, path, host=f"localhost:{server.server_port}")[0] == 200


def test_text_is_compressed_for_clients_that_accept_it(server: FolderServer) -> None:
    _, headers, body = get_path(server, "/tileset.json", "Accept-Encoding: gzip, br")
    assert headers["content-encoding"] == "gzip"
    assert gzip.decompress(body) == b'{"asset": {}}'
    assert "content-encoding" not in get_path(server, "/tiles/0.glb", "Accept-Encoding: gzip")[1]


@pytest.mark.parametrize(
    "path",
    [
        "/../secret.json",
        "/tiles/../../secret.json",
        "/%2e%2e/secret.json",
        "/%2e%2e%2fsecret.json",
        "/..%5csecret.json",
        "/..\\secret.json",
        "/%252e%252e/secret.json",
        "/..%c0%afsecret.json",
        "/.%00./secret.json",
        "/tiles/..;/../secret.json",
        "/../shown-too/secret.json",
        "//../secret.json",
        "/{root}/secret.json",
        "//{root}/secret.json",
        "/%2f{root}/secret.json",
        "/link.json",
        "/out/secret.json",
        "/out/shown/tileset.json",
        "/loop.json",
        "/pipe.json",
        "/folder.json",
        "/folder.json/",
        "/notes",
        "/key.pem",
        "/tiles/",
        "/tiles",
        "/tileset.json/",
        "/tileset.json/x.json",
        "/tileset.json%00.html",
        "/tiles//0.glb",
        "/./tileset.json",
        "/absent.json",
        "/%ff%fe.json",
        "/" + "a" * 5000 + ".json",
        "/" + "a/" * 5000 + "b.json",
    ],
)
def test_no_path_leaves_the_folder(server: FolderServer, path: str, tmp_path: Path) -> None:
    status, _, body = get_path(server, path.replace("{root}", str(tmp_path)))
    assert status == 404
    assert SECRET not in body


@pytest.mark.parametrize(
    "host",
    ["evil.example", "evil.example:{port}", "127.0.0.1", "127.0.0.1:1", "127.0.0.1.evil.example:{port}", ""],
)
def test_another_host_is_refused(server: FolderServer, host: str) -> None:
    status, _, body = get_path(server, "/tileset.json", host=host.replace("{port}", str(server.server_port)))
    assert status == 421
    assert b"asset" not in body


def test_no_host_two_hosts_and_other_addresses_are_refused(server: FolderServer) -> None:
    own = f"127.0.0.1:{server.server_port}".encode()
    for request in (
        b"GET /tileset.json HTTP/1.1\r\n\r\n",
        b"GET /tileset.json\r\n\r\n",
        b"GET /tileset.json HTTP/1.0\r\n\r\n",
        b"GET /tileset.json HTTP/1.1\r\nHost: %s\r\nHost: evil.example\r\n\r\n" % own,
        b"GET http://evil.example/tileset.json HTTP/1.1\r\nHost: %s\r\n\r\n" % own,
        b"GET tileset.json HTTP/1.1\r\nHost: %s\r\n\r\n" % own,
    ):
        status, _, body = send_request(server, request)
        assert status != 200
        assert b"asset" not in body


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "OPTIONS", "PATCH", "CONNECT", "TRACE", "get"])
def test_nothing_but_get_and_head_is_answered(server: FolderServer, method: str, tmp_path: Path) -> None:
    before = sorted(tmp_path.rglob("*"))
    assert get_path(server, "/tileset.json", method=method)[0] == 501
    assert sorted(tmp_path.rglob("*")) == before


def test_a_body_is_not_parsed_as_a_request(server: FolderServer) -> None:
    own = f"Host: 127.0.0.1:{server.server_port}"
    hidden = f"GET /tileset.json HTTP/1.1\r\n{own}\r\n\r\n".encode()
    head = f"GET /tiles/0.glb HTTP/1.1\r\n{own}\r\nContent-Length: {len(hidden)}\r\n\r\n"
    status, _, body = send_request(server, head.encode() + hidden)
    assert (status, body) == (200, b"glTF")


def test_invalid_requests_do_not_stop_the_server(server: FolderServer) -> None:
    for nonsense in (
        b"",
        b"\0" * 100,
        b"\xff" * 70_000,
        b"GET / HTTP/9.9\r\n\r\n",
        b"GET /\r\nHost: a\r\n\r\n",
    ):
        with contextlib.suppress(ConnectionError):
            assert send_request(server, nonsense)[0] != 200
    # A silent connection must not block others.
    with socket.create_connection(("127.0.0.1", server.server_port)):
        assert get_path(server, "/tiles/0.glb")[2] == b"glTF"


def test_only_this_machine_is_answered(server: FolderServer) -> None:
    assert server.server_address[0] == "127.0.0.1"
    assert server.address == f"http://127.0.0.1:{server.server_port}/"


def test_a_folder_that_cannot_be_served_is_an_error(server: FolderServer, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="there is no such folder"):
        FolderServer(tmp_path / "absent")
    with pytest.raises(StageError, match=f"cannot listen on port {server.server_port}: "):
        FolderServer(tmp_path, server.server_port)
