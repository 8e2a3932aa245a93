"""What a scan holds and what is odd about it, before any work."""
