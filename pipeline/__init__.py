"""From a scan folder to artifacts: stage graph, config, cache."""
