"""Method `certified`: bounds that are proven at every point of both surfaces."""
