"""From a scan folder to artifacts: stage graph, config, cache."""

if __name__ == "pipeline":
    # Imported from the top of a checkout: use `scanloom.pipeline`, so that no module is loaded twice.
    from importlib import import_module

    import_module("scanloom").add_alias(__name__)
