"""What the installed command runs first: Ctrl-C is in hand before the imports, which take a moment."""

from __future__ import annotations

from cli import interrupts


def main() -> None:
    """Run the command line and leave with its exit code."""
    interrupts.leave_at_once()
    from cli.app import main as run

    run()
