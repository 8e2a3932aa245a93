"""Headless Chromium, an HTTP server and Node for tests of pages."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

PAGE = Path(__file__).resolve().parents[2] / "pipeline" / "report" / "page"
# Software rendering gives the same pixels on every machine. The other flags prevent network access.
_CHROMIUM_FLAGS = (
    *("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-quic"),
    *("--no-first-run", "--disable-background-networking", "--disable-component-update", "--disable-sync"),
)


def skip_missing_tool(what: str) -> None:
    """Skip a test whose tool is missing; fail it on CI."""
    if os.environ.get("CI"):
        pytest.fail(what)
    pytest.skip(what)


@contextmanager
def launch_browser() -> Iterator[Any]:
    """Start headless Chromium through playwright."""
    # The headless shell starts in half the time of the full browser.
    program = shutil.which("chromium-headless-shell") or shutil.which("chromium")
    if program is None:
        skip_missing_tool("Chromium is missing; on Debian: apt-get install chromium-headless-shell")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        started = playwright.chromium.launch(executable_path=program, args=list(_CHROMIUM_FLAGS))
        try:
            yield started
        finally:
            started.close()


@contextmanager
def run_server(server: Any) -> Iterator[Any]:
    """Run a server in a thread while the block runs."""
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
    thread.start()
    try:
        yield server
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


def run_node(script: Path, *words: Path | str) -> Any:
    """Run a Node script with the packages of `make packages`, and parse its output as JSON."""
    program = shutil.which("node")
    if program is None or not (PAGE / "node_modules").is_dir():
        skip_missing_tool("Node or its packages are missing: make packages")
    ran = subprocess.run(
        [str(program), str(script), *map(str, words)],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert ran.returncode == 0, ran.stderr
    return json.loads(ran.stdout) if ran.stdout else None


def require_ktx2_packages(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let scanloom find the encoder of KTX2 images in the packages of `make packages`."""
    if shutil.which("node") is None or not (PAGE / "node_modules" / "ktx2-encoder").is_dir():
        skip_missing_tool("Node or its package ktx2-encoder is missing: make packages")
    monkeypatch.setenv("NODE_PATH", str(PAGE / "node_modules"))
